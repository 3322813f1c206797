"""Encode frames of the emulated channel as IEEE 802.11 MPDUs, FCS included.

All stations belong to one ad-hoc network (IBSS). A datagram is an 802.11 data frame without QoS control that
carries LLC/SNAP, IPv4 and UDP. That of a network interface's packet carries LLC/SNAP and the
packet. Fine Time Measurement uses action frames, whose bodies have `encode`.

Sources: IEEE 802.11-2016 clause 9 (formats), 9.2.4.8 (FCS); RFC 1042, RFC 791, RFC 768, RFC 1071
(checksums). 802.11 integers are little-endian, IP integers big-endian.
"""

from struct import Struct as Layout
from typing import Protocol, runtime_checkable
from zlib import crc32

from netsim.phy.frames import (
    DATA_OVERHEAD_BYTES,
    GROUP,
    UDP_OVERHEAD_BYTES,
    Datagram,
    Frame,
    FrameKind,
    Packet,
)
from netsim.wire.addresses import GROUP_ADDRESS, GROUP_IPV4_ADDRESS, ipv4_address, mac_address
from netsim.wire.messages import DEFAULT_PORT

NETWORK_ADDRESS = bytes.fromhex("020000010000")
"""BSSID, locally administered; no station has this address."""
_FRAME_CONTROL = {
    FrameKind.DATA: 0x08,
    FrameKind.RTS: 0xB4,
    FrameKind.CTS: 0xC4,
    FrameKind.ACK: 0xD4,
    FrameKind.FTM_REQUEST: 0xD0,
    FrameKind.FTM: 0xD0,
}
"""Subtype, type and protocol version (9.2.4.1); both FTM frames are action frames."""
_RETRY = 0x0800
_DURATION_MAX_US = 32_767
_SEQUENCE_NUMBERS = 4096
_FCS_BYTES = 4
_CONTROL = Layout("<HH6s")
_RTS = Layout("<HH6s6s")
_HEADER = Layout("<HH6s6s6sH")
_SNAP = bytes.fromhex("aaaa03000000")
"""LLC and the organisation code of RFC 1042; the EtherType follows."""
_ETHER_TYPE_IPV4 = bytes.fromhex("0800")
_IPV4 = Layout(">BBHHHBBH4s4s")
_UDP = Layout(">HHHH")
_IPV4_BYTES, _UDP_BYTES = 20, 8
_DO_NOT_FRAGMENT = 0x4000
_TIME_TO_LIVE = 64
_PROTOCOL_UDP = 17


@runtime_checkable
class ActionBody(Protocol):
    """Body of an action frame."""

    def encode(self) -> bytes:
        """Return the bytes of the body, from the category field on."""


def address(station: int) -> bytes:
    """Return the MAC address of a frame's station; `GROUP` is the broadcast address."""
    return GROUP_ADDRESS if station == GROUP else mac_address(station)


def mpdu(frame: Frame, *, retry: bool = False) -> bytes:
    """Return the bytes of a frame, from frame control to FCS.

    ``retry`` sets the Retry bit of a data or action frame. Address 1 of a `Packet` is its own destination,
    which may be a multicast address. The payload of a data frame without a body is zeros. Raises ValueError
    if the body's length does not match the frame, and TypeError if an action frame's body has no `encode`.
    """
    kind, body = frame.kind, frame.body
    control = _FRAME_CONTROL[kind]
    duration_us = min(-(-frame.nav_ns // 1_000), _DURATION_MAX_US)
    to = address(frame.destination)
    if kind is FrameKind.CTS or kind is FrameKind.ACK:
        content = _CONTROL.pack(control, duration_us, to)
    elif kind is FrameKind.RTS:
        content = _RTS.pack(control, duration_us, to, address(frame.source))
    else:
        content = _HEADER.pack(
            control | _RETRY if retry else control,
            duration_us,
            body.destination if isinstance(body, Packet) else to,
            address(frame.source),
            NETWORK_ADDRESS,
            frame.sequence % _SEQUENCE_NUMBERS << 4,
        )
        if isinstance(body, Packet):
            content += _SNAP + body.ether_type.to_bytes(2, "big") + body.payload
        elif kind is FrameKind.DATA:
            content += _datagram(frame)
        else:
            content += _action(frame)
    size = len(content) + _FCS_BYTES
    if size != frame.frame_bytes:
        raise ValueError(f"{kind} frame: encoded {size} bytes, expected {frame.frame_bytes}")
    return content + crc32(content).to_bytes(_FCS_BYTES, "little")


def _action(frame: Frame) -> bytes:
    if not isinstance(frame.body, ActionBody):
        raise TypeError(f"the body of a {frame.kind} frame has no method encode()")
    return frame.body.encode()


def _datagram(frame: Frame) -> bytes:
    """Return LLC/SNAP, IPv4 and UDP headers and the payload; the IPv4 identification is ``frame.seq``."""
    datagram = frame.body
    if not isinstance(datagram, Datagram):
        payload_bytes = max(0, frame.frame_bytes - DATA_OVERHEAD_BYTES - UDP_OVERHEAD_BYTES)
        datagram = Datagram(DEFAULT_PORT, bytes(payload_bytes))
    port, payload = datagram
    to = frame.destination
    source, destination = ipv4_address(frame.source), GROUP_IPV4_ADDRESS if to == GROUP else ipv4_address(to)
    udp_bytes = _UDP_BYTES + len(payload)
    header = (
        0x45, 0, _IPV4_BYTES + udp_bytes, frame.seq & 0xFFFF, _DO_NOT_FRAGMENT, _TIME_TO_LIVE, _PROTOCOL_UDP,
    )  # fmt: skip
    checksum = _checksum(_IPV4.pack(*header, 0, source, destination))
    pseudo_header = source + destination + _PROTOCOL_UDP.to_bytes(2, "big") + udp_bytes.to_bytes(2, "big")
    udp = _UDP.pack(port, port, udp_bytes, 0) + payload
    udp_checksum = _checksum(pseudo_header + udp) or 0xFFFF  # 0 means "no checksum"
    ipv4 = _IPV4.pack(*header, checksum, source, destination)
    return _SNAP + _ETHER_TYPE_IPV4 + ipv4 + udp[:6] + udp_checksum.to_bytes(2, "big") + payload


def _checksum(data: bytes) -> int:
    """Return the Internet checksum (RFC 1071); data of odd length are padded with a zero byte.

    The ones' complement sum of 16-bit words equals the whole number modulo 65535, since 65536 = 1 mod 65535.
    """
    if len(data) % 2:
        data += b"\x00"
    return -int.from_bytes(data, "big") % 0xFFFF
