"""Messages between the emulator and the host of network interfaces: packets of unmodified programs.

A packet is the payload of one Ethernet frame of an interface ``wlan0``, and one frame of the channel.
Programs run in wall time: the messages have times of the machine's monotonic clock
(`time.monotonic_ns`), which both processes share. As in `netsim.wire.messages`, messages are versioned, typed
and encoded as MessagePack.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from netsim.wire.messages import VERSION, Station

MAX_PACKET_BYTES = 2_296
"""Longest packet: a frame body of 2304 bytes (IEEE 802.11-2016, 9.2.4.7) less 8 of LLC/SNAP."""
MacAddress = Annotated[bytes, Meta(min_length=6, max_length=6)]
EtherType = Annotated[int, Meta(ge=0x0600, le=0xFFFF)]
WallNs = Annotated[int, Meta(ge=0, le=2**63 - 1)]
PacketCounts = tuple[tuple[Station, int], ...]
"""Numbers of packets by station."""


class SentPacket(Struct, frozen=True, kw_only=True, array_like=True, gc=False):
    """A packet that a vehicle's programs or kernel have sent."""

    station: Station
    """The sender"""
    destination: MacAddress
    """A station's address, or a group address (least significant bit of the first byte set)"""
    ether_type: EtherType
    category: Literal["vo", "vi", "be", "bk"]
    """EDCA access category"""
    read_ns: WallNs
    """Wall time at which it was read from the interface"""
    payload: Annotated[bytes, Meta(max_length=MAX_PACKET_BYTES)]


class SentPackets(Struct, frozen=True, kw_only=True, array_like=True):
    """Packets in the order in which they were read, from the host of interfaces to the emulator."""

    version: int = VERSION
    packets: tuple[SentPacket, ...]


class ReceivedPacket(Struct, frozen=True, kw_only=True, array_like=True, gc=False):
    """A packet that has reached stations."""

    stations: tuple[Station, ...]
    """The receivers"""
    source: Station
    destination: MacAddress
    ether_type: EtherType
    due_ns: WallNs
    """Wall time of its reception; 0 without a pace"""
    payload: Annotated[bytes, Meta(max_length=MAX_PACKET_BYTES)]


class ReceivedPackets(Struct, frozen=True, kw_only=True, array_like=True):
    """Packets in the order of their reception, from the emulator to the host of interfaces."""

    version: int = VERSION
    packets: tuple[ReceivedPacket, ...]
    ended: PacketCounts = ()
    """Numbers of packets that have left the radios' queues, sent or dropped, by sender"""


_sent = msgspec.msgpack.Decoder(SentPackets)
_received = msgspec.msgpack.Decoder(ReceivedPackets)
_encoder = msgspec.msgpack.Encoder()
_INVALID = (msgspec.DecodeError, ValueError, OverflowError, RecursionError)


def encode_packets(message: SentPackets | ReceivedPackets) -> bytes:
    """Return the bytes of a message."""
    return _encoder.encode(message)


def decode_sent(buffer: bytes) -> SentPackets | None:
    """Return the message, or None if the bytes are not one of this version."""
    try:
        message = _sent.decode(buffer)
    except _INVALID:
        return None
    return message if message.version == VERSION else None


def decode_received(buffer: bytes) -> ReceivedPackets | None:
    """Return the message, or None if the bytes are not one of this version."""
    try:
        message = _received.decode(buffer)
    except _INVALID:
        return None
    return message if message.version == VERSION else None
