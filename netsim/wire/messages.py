"""Messages between the radio's users and the emulator.

Versioned, typed, MessagePack on the wire.

Decoding never raises: bytes that are no message of this version give None, and the caller counts them.
Times are simulated: integer microseconds (``_us``) at the host's side, nanoseconds (``_ns``) on the air.

Items are nothing to Python's collector of cycles (``gc=False``): they hold numbers, texts and bytes.
"""

from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta, Struct

VERSION = 5
"""First field of every message; a change of any message's fields raises it."""
MAX_PAYLOAD_BYTES = 1472
"""Largest UDP payload that fits one 1500-byte IP packet."""

MAX_STATION = 65_535
Station = Annotated[int, Meta(ge=0, le=MAX_STATION)]
TimeUs = Annotated[int, Meta(ge=0, le=2**53)]
"""Some 285 years: what is later is no time, and its nanoseconds would not fit the logs."""
TimeNs = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Seq = Annotated[int, Meta(ge=0, le=2**63 - 1)]


class Broadcast(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="b"):
    """One UDP datagram to every station in range."""

    seq: Seq
    """Rises by one with each item that a station hands over, whatever its kind."""
    at_us: TimeUs
    """When the application hands it to its host stack; not before the batch's ``now_us``."""
    payload: Annotated[bytes, Meta(max_length=MAX_PAYLOAD_BYTES)]


class FtmRequest(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="f"):
    """Ask the driver to range to a peer; exactly one `FtmResult` with this ``seq`` comes back."""

    seq: Seq
    at_us: TimeUs
    peer: Station


class Unicast(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="u"):
    """One UDP datagram to one station; exactly one `Sent` with this ``seq`` comes back."""

    seq: Seq
    at_us: TimeUs
    destination: Station
    payload: Annotated[bytes, Meta(max_length=MAX_PAYLOAD_BYTES)]


TxItem = Broadcast | FtmRequest | Unicast


class TxBatch(Struct, frozen=True, kw_only=True, array_like=True):
    """All that one station hands to its radio in one step.

    Vehicles put it and say in lockstep that they did (`netsim.wire.lockstep`); who is in none asks, and has
    an `Ack`.
    """

    version: int = VERSION
    station: Station
    now_us: TimeUs
    items: tuple[TxItem, ...]
    more: bool = False
    """Another batch of the same step follows."""


class Delivery(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="d"):
    """A datagram that reached this station."""

    source: Station
    seq: Seq
    """The sender's sequence number."""
    received_ns: TimeNs
    """End of the frame at this antenna."""
    rssi_dbm: float
    payload: bytes


class FtmResult(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="r"):
    """What the driver reports of one ranging session, at the initiator."""

    peer: Station
    seq: Seq
    """That of the `FtmRequest`."""
    status: str
    """``ok``, ``timeout``, ``no_response``, ``rejected``, ``incapable`` or ``dropped``: see
    `netsim.ftm.session`; or ``lost``, if the radio has measured and the host lost what it said."""
    measured_ns: TimeNs
    """Mean time of the round trips that were used; when the session ended if there were none."""
    ended_ns: TimeNs
    """When the session ended and the driver reported."""
    distance_m: float
    """c/2 times the mean round trip; 0.0 unless ``status`` is ``ok``."""
    distance_std_m: float
    """Sample standard deviation of a single round trip's distance; 0.0 with fewer than two."""
    rssi_dbm: float
    """Mean of the measurement frames that were used; 0.0 unless ``status`` is ``ok``."""
    round_trips: int
    """Round trips that were averaged."""
    measurements: int
    """Measurement frames that arrived."""
    retry_after_s: int = 0
    """If rejected: for how long the responder does not want to be asked again."""


class Sent(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="s"):
    """What became of a `Unicast`, at its sender."""

    destination: Station
    seq: Seq
    ended_ns: TimeNs
    status: str
    """``acknowledged``, ``retry_limit``, ``expired`` (in the queue), ``overflow`` (of the queue) or
    ``rejected`` (no other station has that number)."""
    attempts: int
    """Transmissions of the frame, RTS not counted."""


class Survey(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="v"):
    """How occupied this station has found the channel, as the busy-time counter of a driver tells it."""

    ended_ns: TimeNs
    """Up to when it counted."""
    busy_ns: TimeNs
    """Time since the start for which this station sensed energy on the medium or was itself sending; what NAV
    alone reserves is not busy."""


RxItem = Delivery | FtmResult | Sent | Survey


class RxBatch(Struct, frozen=True, kw_only=True, array_like=True):
    """All that one station gets from one interval of the air.

    Items are in order of (time, source, seq), and a vehicle's last is a `Survey`; for that alone there is no
    batch. The application may see them at ``release_us`` and not before. A vehicle is told of it in that
    step's sensors; others are asked to take it, answer with an `Ack`, and are not waited for.
    """

    version: int = VERSION
    station: Station
    release_us: TimeUs
    items: tuple[RxItem, ...]
    more: bool = False
    """Another batch of the same interval follows."""


class Ack(Struct, frozen=True, kw_only=True, array_like=True):
    """The batch has been received whole."""

    version: int = VERSION


class DirectoryRequest(Struct, frozen=True, kw_only=True, array_like=True):
    """Which stations are there? Answered by `Directory`."""

    version: int = VERSION


class Directory(Struct, frozen=True, kw_only=True, array_like=True):
    """A run and its stations."""

    version: int = VERSION
    run_id: str
    vehicles: int
    """Stations 0 to this less one are vehicles."""
    guests: tuple[str, ...]
    """Names of the stations that follow; other programs are their hosts."""


Message = TxBatch | RxBatch | Ack | DirectoryRequest | Directory
M = TypeVar("M", TxBatch, RxBatch, Ack, DirectoryRequest, Directory)
_encoder = msgspec.msgpack.Encoder()
_decoders = {
    kind: msgspec.msgpack.Decoder(kind) for kind in (TxBatch, RxBatch, Ack, DirectoryRequest, Directory)
}


def encode(message: Message) -> bytes:
    """Bytes of a message."""
    return _encoder.encode(message)


def decode(kind: type[M], buffer: bytes) -> M | None:
    """Message of that kind, or None if the bytes are not one of this version."""
    decoder: msgspec.msgpack.Decoder[M] = _decoders[kind]  # type: ignore[assignment]  # each under its own kind
    try:
        message = decoder.decode(buffer)
    except (msgspec.DecodeError, ValueError, OverflowError, RecursionError):
        return None
    return message if message.version == VERSION else None
