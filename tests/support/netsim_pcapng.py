"""Datagrams to capture, and an independent reader of captures: blocks, options, radiotap fields."""

import struct

import numpy as np

from netsim.phy.frames import GROUP, Datagram, Frame, FrameKind, Transmission
from netsim.phy.modes import phy_mode
from netsim.wire.messages import DEFAULT_PORT

OFDM24 = phy_mode("ofdm24", 20)
RADIOTAP_FIELDS = {
    0: ("tsft", 8, "<Q"), 1: ("flags", 1, "<B"), 2: ("rate", 1, "<B"), 3: ("channel", 2, "<HH"),
    4: ("fhss", 1, "<BB"), 5: ("signal", 1, "<b"), 6: ("noise", 1, "<b"), 10: ("tx_power", 1, "<b"),
    19: ("mcs", 1, "<BBB"), 20: ("ampdu", 4, "<IHBB"), 21: ("vht", 2, "<HBB4sBBH"),
    22: ("timestamp", 8, "<QHBB"),
}  # fmt: skip
"""By bit of the presence word: name, alignment, layout (radiotap.org)."""


def transmission(frame, start_ns=0):
    return Transmission(frame, start_ns, np.array([0.0]), np.array([0]), 0)


def datagram(payload=b"hello", *, source=0, sequence=1, seq=0, destination=GROUP, mode=OFDM24):
    return Frame(
        kind=FrameKind.DATA,
        source=source,
        destination=destination,
        mode=mode,
        frame_bytes=len(payload) + 64,
        seq=seq,
        sequence=sequence,
        body=Datagram(DEFAULT_PORT, payload),
    )


def blocks(content):
    """Return all blocks of a pcapng file as (type, body); checks both lengths and the 32-bit alignment."""
    found, at = [], 0
    while at < len(content):
        kind, length = struct.unpack_from("<II", content, at)
        assert length % 4 == 0
        assert struct.unpack_from("<I", content, at + length - 4) == (length,)
        found.append((kind, content[at + 8 : at + length - 4]))
        at += length
    assert at == len(content)
    return found


def options(content):
    """Return options as {code: value}; checks the end of the list."""
    found, at = {}, 0
    while at < len(content):
        code, length = struct.unpack_from("<HH", content, at)
        found[code] = content[at + 4 : at + 4 + length]
        at += 4 + length + -length % 4
    if found:
        assert found.pop(0) == b""
    return found


def packets(content):
    """Return (time_ns, bytes, comment or None) of every packet of a file with one interface."""
    names, found = interfaces(content)
    assert len(names) == 1
    return [packet for _, *packet in found]


def interfaces(content):
    """Return the interfaces' names and (interface, time_ns, bytes, comment or None) of every packet."""
    names, found = [], []
    for kind, body in blocks(content)[1:]:
        if kind == 1:
            assert not found
            names.append(options(body[8:])[2].decode())
            continue
        assert kind == 6
        interface, high, low, size, original = struct.unpack_from("<5I", body)
        assert size == original
        assert interface < len(names)
        rest = options(body[20 + size + -size % 4 :])
        found.append((interface, high << 32 | low, body[20 : 20 + size], rest.get(1)))
    return names, found


def radiotap(packet):
    """Return the fields of a radiotap header by name, and the bytes after it."""
    version, _, length, present = struct.unpack_from("<BBHI", packet)
    assert version == 0
    assert not present >> 23
    fields, at = {}, 8
    for bit in range(23):
        if present >> bit & 1:
            name, alignment, layout = RADIOTAP_FIELDS[bit]
            at += -at % alignment
            fields[name] = struct.unpack_from(layout, packet, at)
            at += struct.calcsize(layout)
    assert at == length
    return fields, packet[length:]
