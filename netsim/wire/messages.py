"""Messages between the radio's hosts and the emulator.

They are versioned, typed and encoded as MessagePack.

`decode` does not raise for invalid bytes: it returns None, and the caller counts them. Times are simulated:
integer microseconds (``_us``) at the host, nanoseconds (``_ns``) on the channel.

Items are not tracked by Python's garbage collector (``gc=False``): they contain numbers, strings and bytes.
"""

from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta, Struct

VERSION = 7
"""First field of every message; incremented with every change of a message's fields."""
MAX_PAYLOAD_BYTES = 1472
"""Largest UDP payload that fits one 1500-byte IP packet."""
DEFAULT_PORT = 50_802
"""UDP port of datagrams whose sender names none, from the dynamic range.

Wireshark has no protocol for it and guesses from the payload: it decodes some beacons as Thrift. A dissector
registered for the port prevents that, as does ``tshark -d udp.port==50802,data`` ("Decode As").
"""

MAX_STATION = 65_535
MOST_GUEST_ITEMS = 1_024
"""Most items of a guest that the emulator takes between two intervals of simulated time.

An interval of 40 ms has room for about 400 frames at the highest rate; a radio's queue has 64 by default.
"""
Station = Annotated[int, Meta(ge=0, le=MAX_STATION)]
TimeUs = Annotated[int, Meta(ge=0, le=2**53)]
"""At most 285 years, so that nanoseconds fit the logs."""
TimeNs = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Seq = Annotated[int, Meta(ge=0, le=2**63 - 1)]


class Broadcast(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="b"):
    """One UDP datagram to every station in range."""

    seq: Seq
    """Incremented with each item that a station submits, of any kind."""
    at_us: TimeUs
    """Time at which the application passes it to its host stack; not before the batch's ``now_us``."""
    payload: Annotated[bytes, Meta(max_length=MAX_PAYLOAD_BYTES)]
    port: Annotated[int, Meta(ge=1, le=65_535)] = DEFAULT_PORT


class FtmRequest(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="f"):
    """Request to range to a peer; exactly one `FtmResult` with this ``seq`` is returned."""

    seq: Seq
    at_us: TimeUs
    peer: Station


class Unicast(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="u"):
    """One UDP datagram to one station; exactly one `Sent` with this ``seq`` is returned."""

    seq: Seq
    at_us: TimeUs
    destination: Station
    payload: Annotated[bytes, Meta(max_length=MAX_PAYLOAD_BYTES)]
    port: Annotated[int, Meta(ge=1, le=65_535)] = DEFAULT_PORT


class SerialBytes(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="m"):
    """Bytes that a station's host writes to one of its serial modems; there is no reply."""

    seq: Seq
    at_us: TimeUs
    peer: Station
    """Station of the pair's other modem."""
    payload: Annotated[bytes, Meta(max_length=MAX_PAYLOAD_BYTES)]


TxItem = Broadcast | FtmRequest | Unicast | SerialBytes


class TxBatch(Struct, frozen=True, kw_only=True, array_like=True):
    """All items that one station submits to its radio in one step.

    Vehicles publish it and announce it in lockstep (`netsim.wire.lockstep`). Guests send it as a query, and
    the reply is an `Ack`.
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
    port: int = DEFAULT_PORT


class FtmResult(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="r"):
    """Result of one ranging session, at the initiator."""

    peer: Station
    seq: Seq
    """Sequence number of the `FtmRequest`."""
    status: str
    """``ok``, ``timeout``, ``no_response``, ``rejected``, ``incapable`` or ``dropped``: see
    `netsim.ftm.session`; or ``lost`` if the host has lost the radio's result."""
    measured_ns: TimeNs
    """Mean time of the used round trips; without any, the end of the session."""
    ended_ns: TimeNs
    """End of the session, when the driver reports."""
    distance_m: float
    """c/2 times the mean round trip; 0.0 unless ``status`` is ``ok``."""
    distance_std_m: float
    """Sample standard deviation of a single round trip's distance; 0.0 with fewer than two."""
    rssi_dbm: float
    """Mean over the used measurement frames; 0.0 unless ``status`` is ``ok``."""
    round_trips: int
    """Number of averaged round trips."""
    measurements: int
    """Number of received measurement frames."""
    retry_after_s: int = 0
    """If rejected by a responder: time after which a new request may be sent."""


class Sent(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="s"):
    """Outcome of a `Unicast`, at its sender."""

    destination: Station
    seq: Seq
    ended_ns: TimeNs
    status: str
    """``acknowledged``, ``retry_limit``, ``expired`` (in the queue), ``overflow`` (of the queue) or
    ``rejected`` (no other station has that number)."""
    attempts: int
    """Transmissions of the frame, RTS not counted."""


class Survey(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="v"):
    """Channel busy time at this station, as a driver's survey counter."""

    ended_ns: TimeNs
    """End of the counted time."""
    busy_ns: TimeNs
    """Time since the start for which this station sensed the medium busy or was sending; the NAV alone does
    not count."""


class SerialReceived(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="m"):
    """Bytes that a station's serial modem has passed to its host: a MAVLink frame, or what else arrived."""

    peer: Station
    """Station of the pair's other modem."""
    seq: Seq
    """Incremented with each item of this modem."""
    received_ns: TimeNs
    """Time of the last byte."""
    payload: bytes


Octet = Annotated[int, Meta(ge=0, le=255)]


class SerialReport(Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="o"):
    """Fields of a RADIO_STATUS that a station's serial modem has sent to its host.

    They are those of `netsim.serial_radio.modem.RadioStatus`.
    """

    peer: Station
    seq: Seq
    received_ns: TimeNs
    """Time of its last byte."""
    rssi: Octet
    remrssi: Octet
    txbuf: Octet
    noise: Octet
    remnoise: Octet
    rxerrors: Annotated[int, Meta(ge=0, le=65_535)]
    fixed: Annotated[int, Meta(ge=0, le=65_535)]


RxItem = Delivery | FtmResult | Sent | Survey | SerialReceived | SerialReport


class RxBatch(Struct, frozen=True, kw_only=True, array_like=True):
    """All items that one station receives in one interval.

    Items are in order of (time, source, seq), and a vehicle's last is a `Survey`; no batch has only a
    `Survey`. The application may process them from ``release_us`` on. The sensor message of that step
    announces the batch to a vehicle. To other stations it is sent as a query, which they reply to with an
    `Ack`; the emulator does not wait for it.
    """

    version: int = VERSION
    station: Station
    release_us: TimeUs
    items: tuple[RxItem, ...]
    more: bool = False
    """Another batch of the same interval follows."""


class Ack(Struct, frozen=True, kw_only=True, array_like=True):
    """The batch has been received completely."""

    version: int = VERSION
    full: bool = False
    """The batch is dropped: it would exceed `MOST_GUEST_ITEMS`."""


class DirectoryRequest(Struct, frozen=True, kw_only=True, array_like=True):
    """Request for the list of stations; the reply is `Directory`."""

    version: int = VERSION


class Directory(Struct, frozen=True, kw_only=True, array_like=True):
    """Identifier of a run and its stations."""

    version: int = VERSION
    run_id: str
    vehicles: int
    """Number of vehicles, the first stations."""
    guests: tuple[str, ...]
    """Names of the following stations, whose hosts are external programs."""


Message = TxBatch | RxBatch | Ack | DirectoryRequest | Directory
M = TypeVar("M", TxBatch, RxBatch, Ack, DirectoryRequest, Directory)
_encoder = msgspec.msgpack.Encoder()
_decoders = {
    kind: msgspec.msgpack.Decoder(kind) for kind in (TxBatch, RxBatch, Ack, DirectoryRequest, Directory)
}


def encode(message: Message) -> bytes:
    """Return the bytes of a message."""
    return _encoder.encode(message)


def decode(kind: type[M], buffer: bytes) -> M | None:
    """Return the message, or None if the bytes are not a message of that kind and version."""
    decoder: msgspec.msgpack.Decoder[M] = _decoders[kind]  # type: ignore[assignment]  # each under its own kind
    try:
        message = decoder.decode(buffer)
    except (msgspec.DecodeError, ValueError, OverflowError, RecursionError):
        return None
    return message if message.version == VERSION else None
