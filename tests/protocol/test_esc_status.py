"""ESC_STATUS against MAVLink's own rules, since no generated code stands behind it."""

import pytest
from pymavlink.dialects.v20 import common
from pymavlink.generator.mavcrc import x25crc

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.esc_status import ESC_STATUS, EscStatus

FIELDS = [
    ("uint64_t", "time_usec", 0),
    ("int32_t", "rpm", 4),
    ("float", "voltage", 4),
    ("float", "current", 4),
    ("uint8_t", "index", 0),
]
"""In the order of the wire: by size, largest first"""


def test_the_extra_byte_of_the_checksum_follows_from_name_and_fields():
    crc = x25crc()
    crc.accumulate_str("ESC_STATUS ")
    for kind, name, count in FIELDS:
        crc.accumulate_str(f"{kind} {name} ")
        if count:
            crc.accumulate(bytes([count]))
    assert EscStatus.crc_extra == (crc.crc & 0xFF) ^ (crc.crc >> 8)


def test_the_layout_is_that_of_the_fields():
    assert EscStatus.unpacker.size == 8 + 3 * 4 * 4 + 1
    assert [name for _, name, _ in FIELDS] == EscStatus.ordered_fieldnames
    assert [EscStatus.ordered_fieldnames[i] for i in EscStatus.orders] == EscStatus.fieldnames
    assert common.mavlink_map[ESC_STATUS] is EscStatus


def test_there_and_back():
    sent = EscStatus(0, 123_456_789, [7703, 1, -2, 0], [0.0, 11.1, 0.0, 0.0], [4.0, 0.5, 0.0, 10.25])
    (got,) = Parser().push(Encoder(system=0, component=1).encode(sent))
    assert (got.get_msgId(), got.get_type()) == (291, "ESC_STATUS")
    assert (got.index, got.time_usec, got.rpm) == (0, 123_456_789, [7703, 1, -2, 0])
    assert got.voltage == pytest.approx([0.0, 11.1, 0.0, 0.0])
    assert got.current == [4.0, 0.5, 0.0, 10.25]
