"""Messages between the radio's users, the emulator and the time master.

Versioned, typed, MessagePack on the wire.

Decoding never raises: bytes that are no message of this version give None, and the caller counts them.
Times are simulated: integer microseconds (``_us``) at the host's side, nanoseconds (``_ns``) on the air.
"""

from typing import Annotated, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

VERSION = 5
"""First field of every message; a change of any message's fields raises it."""
MAX_PAYLOAD_BYTES = 1472
"""Largest UDP payload that fits one 1500-byte IP packet."""
_FLOAT64_BYTES = 8

MAX_STATION = 65_535
Station = Annotated[int, Meta(ge=0, le=MAX_STATION)]
TimeUs = Annotated[int, Meta(ge=0, le=2**53)]
"""Some 285 years: what is later is no time, and its nanoseconds would not fit the logs."""
TimeNs = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Seq = Annotated[int, Meta(ge=0, le=2**63 - 1)]
RangeOffset = Annotated[float, Meta(ge=-1e6, le=1e6)]
Rows = bytes
"""A matrix of little-endian float64, row after row, one row per station: `pack_rows`, `unpack_rows`."""


class Broadcast(Struct, frozen=True, kw_only=True, array_like=True, tag="b"):
    """One UDP datagram to every station in range."""

    seq: Seq
    """Rises by one with each item that a station hands over, whatever its kind."""
    at_us: TimeUs
    """When the application hands it to its host stack; not before the batch's ``now_us``."""
    payload: Annotated[bytes, Meta(max_length=MAX_PAYLOAD_BYTES)]


class FtmRequest(Struct, frozen=True, kw_only=True, array_like=True, tag="f"):
    """Ask the driver to range to a peer; exactly one `FtmResult` with this ``seq`` comes back."""

    seq: Seq
    at_us: TimeUs
    peer: Station


class Unicast(Struct, frozen=True, kw_only=True, array_like=True, tag="u"):
    """One UDP datagram to one station; exactly one `Sent` with this ``seq`` comes back."""

    seq: Seq
    at_us: TimeUs
    destination: Station
    payload: Annotated[bytes, Meta(max_length=MAX_PAYLOAD_BYTES)]


TxItem = Broadcast | FtmRequest | Unicast


class TxBatch(Struct, frozen=True, kw_only=True, array_like=True):
    """All that one station hands to its radio in one step. Answered by `Ack`."""

    version: int = VERSION
    station: Station
    now_us: TimeUs
    items: tuple[TxItem, ...]


class Delivery(Struct, frozen=True, kw_only=True, array_like=True, tag="d"):
    """A datagram that reached this station."""

    source: Station
    seq: Seq
    """The sender's sequence number."""
    received_ns: TimeNs
    """End of the frame at this antenna."""
    rssi_dbm: float
    payload: bytes


class FtmResult(Struct, frozen=True, kw_only=True, array_like=True, tag="r"):
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


class Sent(Struct, frozen=True, kw_only=True, array_like=True, tag="s"):
    """What became of a `Unicast`, at its sender."""

    destination: Station
    seq: Seq
    ended_ns: TimeNs
    status: str
    """``acknowledged``, ``retry_limit``, ``expired`` (in the queue), ``overflow`` (of the queue) or
    ``rejected`` (no other station has that number)."""
    attempts: int
    """Transmissions of the frame, RTS not counted."""


class Survey(Struct, frozen=True, kw_only=True, array_like=True, tag="v"):
    """How occupied this station has found the channel, as the busy-time counter of a driver tells it."""

    ended_ns: TimeNs
    """Up to when it counted."""
    busy_ns: TimeNs
    """Time since the start for which this station sensed energy on the medium or was itself sending; what NAV
    alone reserves is not busy."""


RxItem = Delivery | FtmResult | Sent | Survey


class RxBatch(Struct, frozen=True, kw_only=True, array_like=True):
    """All that one station gets from one interval of the air. Answered by `Ack`.

    Items are in order of (time, source, seq), and a vehicle's last is a `Survey`; for that alone there is no
    batch. The application may see them at ``release_us`` and not before.
    """

    version: int = VERSION
    station: Station
    release_us: TimeUs
    items: tuple[RxItem, ...]


class Ack(Struct, frozen=True, kw_only=True, array_like=True):
    """The batch has been received whole."""

    version: int = VERSION


class Advance(Struct, frozen=True, kw_only=True, array_like=True):
    """From the time master: simulate the air up to ``to_us``. Answered by `Advanced`.

    Repeated for the same ``to_us``, it only delivers once more to stations that have not acknowledged, less
    those that it calls silent.
    """

    version: int = VERSION
    to_us: TimeUs
    release_us: TimeUs
    """When the hosts may see what arrives in this interval."""
    at_us: TimeUs
    """Beginning of the interval, for which the positions hold; the stations go on at these velocities."""
    pos_ned_m: Rows
    """(stations, 3)"""
    vel_ned_m_s: Rows
    """(stations, 3)"""
    q_ned_frd: Rows
    """(stations, 4), Hamilton wxyz: attitude, from which the antennas' directions follow."""
    silent: tuple[Station, ...] = ()
    """Stations that are gone: their radios send and answer nothing."""
    extra_attenuation_db: Annotated[float, Meta(ge=0.0, le=1_000.0)] | None = None
    """From now on, this attenuation on every link instead of the scenario's."""
    range_offsets_m: tuple[tuple[Station, RangeOffset], ...] = ()
    """From now on, by how much stations' radios measure too far, each in the sessions that it began; none is
    in force that is not named."""


class Advanced(Struct, frozen=True, kw_only=True, array_like=True):
    """The air has been simulated up to ``to_us``, and all but the unresponsive have its deliveries."""

    version: int = VERSION
    to_us: TimeUs
    quiet_until_us: TimeUs
    """Unless a station hands over something new, nothing happens on the air before this time."""
    busy_ns: TimeNs = 0
    """Time since the start for which the medium carried at least one transmission."""
    unresponsive: tuple[Station, ...] = ()
    """Stations that have not acknowledged their deliveries; whether to wait is the time master's choice."""


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


Message = TxBatch | RxBatch | Ack | Advance | Advanced | DirectoryRequest | Directory
M = TypeVar("M", TxBatch, RxBatch, Ack, Advance, Advanced, DirectoryRequest, Directory)
_encoder = msgspec.msgpack.Encoder()
_decoders = {
    kind: msgspec.msgpack.Decoder(kind)
    for kind in (TxBatch, RxBatch, Ack, Advance, Advanced, DirectoryRequest, Directory)
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


def pack_rows(matrix: NDArray[np.float64]) -> Rows:
    """Bytes of a matrix with one row per station."""
    return matrix.astype("<f8", copy=False).tobytes()


def unpack_rows(rows: Rows, *, stations: int, columns: int) -> NDArray[np.float64] | None:
    """Matrix (stations, columns), or None if the bytes are not of that many numbers."""
    if len(rows) != _FLOAT64_BYTES * stations * columns:
        return None
    return np.frombuffer(rows, "<f8").astype(np.float64).reshape(stations, columns)
