"""Ethernet II frames as bytes, and the EDCA access category of a packet; pure.

Sources: IEEE 802.3-2018, 3.1 and 3.2.6 (frame, EtherType); IEEE 802.1Q-2018, 9.6 (tag); IEEE 802.11-2016,
table 10-1 (categories of user priorities); Linux, net/wireless/util.c, cfg80211_classify8021d (user priority
of a packet: the upper three bits of its DSCP; Linux 6.8 added the exceptions of RFC 8325, 4, which are not
applied here).
"""

from struct import Struct as Layout
from typing import Literal, NamedTuple

Category = Literal["vo", "vi", "be", "bk"]

HEADER_BYTES = 14
LOWEST_ETHER_TYPE = 0x0600
"""Smaller values are the length of an IEEE 802.3 frame."""
IPV4, IPV6, VLAN = 0x0800, 0x86DD, 0x8100
_HEADER = Layout(">6s6sH")
_TAG = Layout(">HH")
_PRIORITY_SHIFT = 13
"""Of the tag control information: 3 bits of priority, 1 of drop eligibility, 12 of the VLAN's number."""
_CATEGORIES: tuple[Category, ...] = ("be", "bk", "bk", "be", "vi", "vi", "vo", "vo")
"""By user priority."""


class EthernetFrame(NamedTuple):
    """A frame without its check sequence."""

    destination: bytes
    source: bytes
    ether_type: int
    payload: bytes


def parse(frame: bytes) -> EthernetFrame | None:
    """Return the parts of a frame, None if it is shorter than its header or has no EtherType."""
    if len(frame) < HEADER_BYTES:
        return None
    destination, source, ether_type = _HEADER.unpack_from(frame)
    if ether_type < LOWEST_ETHER_TYPE:
        return None
    return EthernetFrame(destination, source, ether_type, frame[HEADER_BYTES:])


def build(destination: bytes, source: bytes, ether_type: int, payload: bytes) -> bytes:
    """Return the bytes of a frame; shorter ones than an Ethernet's 60 bytes are not padded."""
    return _HEADER.pack(destination, source, ether_type) + payload


def tagged(frame: bytes, tag_ether_type: int, control: int) -> bytes:
    """Return a frame with a VLAN tag inserted, which a packet socket reports apart from the frame."""
    return frame[:12] + _TAG.pack(tag_ether_type, control) + frame[12:]


def access_category(ether_type: int, payload: bytes) -> Category:
    """Return the category of a packet: best effort if it is too short, or no IPv4, IPv6 or tagged one."""
    return _CATEGORIES[_user_priority(ether_type, payload)]


def _user_priority(ether_type: int, payload: bytes) -> int:
    if ether_type == VLAN and len(payload) >= _TAG.size:
        control, ether_type = _TAG.unpack_from(payload)
        priority: int = control >> _PRIORITY_SHIFT
        if priority:
            return priority
        payload = payload[_TAG.size :]
    if ether_type == IPV4 and len(payload) > 1:
        return payload[1] >> 5  # type of service: 6 bits of DSCP, 2 of ECN
    if ether_type == IPV6 and len(payload) > 1:
        return payload[0] >> 1 & 0b111  # 4 bits of version, then the traffic class
    return 0
