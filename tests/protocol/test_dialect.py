"""Declared messages against MAVLink's rules, since they are not generated."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from pymavlink.generator.mavcrc import x25crc

from autopilot.mavlink import dialect
from autopilot.mavlink.codec import Encoder, Parser

EXTENSIONS = {"MISSION_COUNT": 2, "MISSION_ACK": 2, "MISSION_CURRENT": 6, "SET_ATTITUDE_TARGET": 1}
"""Number of extension fields, which are not part of the checksum."""
DECLARED = [kind for kind in common.mavlink_map.values() if hasattr(kind, "fields")]
GENERATED = {
    "MISSION_COUNT": common.MAVLink_mission_count_message,
    "MISSION_ACK": common.MAVLink_mission_ack_message,
    "MISSION_CURRENT": common.MAVLink_mission_current_message,
    "SET_ATTITUDE_TARGET": common.MAVLink_set_attitude_target_message,
}
SIZES = {
    "double": 8, "uint64_t": 8, "int64_t": 8, "float": 4, "uint32_t": 4, "int32_t": 4,
    "uint16_t": 2, "int16_t": 2,
}  # fmt: skip


def name_of(kind):
    return kind.msgname


def some(field, rng):
    if field.kind == "char":
        return "a" * field.length
    if field.length:
        return [n + rng for n in range(field.length)]
    return 3 + rng


def test_there_are_some():
    assert {"ESC_STATUS", "PROTOCOL_VERSION", "COMPONENT_METADATA", "AVAILABLE_MODES"} <= {
        kind.msgname for kind in DECLARED
    }
    assert EXTENSIONS.keys() <= {kind.msgname for kind in DECLARED}


@pytest.mark.parametrize("kind", DECLARED, ids=name_of)
def test_crc_extra_follows_from_name_and_fields(kind):
    crc = x25crc()
    crc.accumulate_str(kind.msgname + " ")
    for field in kind.fields[: len(kind.fields) - EXTENSIONS.get(kind.msgname, 0)]:
        crc.accumulate_str(f"{field.kind} {field.name} ")
        if field.length:
            crc.accumulate(bytes([field.length]))
    assert kind.crc_extra == (crc.crc & 0xFF) ^ (crc.crc >> 8)


@pytest.mark.parametrize("kind", DECLARED, ids=name_of)
def test_the_fields_are_in_wire_order_by_size(kind):
    base = kind.fields[: len(kind.fields) - EXTENSIONS.get(kind.msgname, 0)]
    sizes = [SIZES.get(field.kind, 1) for field in base]
    assert sizes == sorted(sizes, reverse=True)
    assert sorted(kind.fieldnames) == sorted(kind.ordered_fieldnames)
    assert [kind.ordered_fieldnames[i] for i in kind.orders] == kind.fieldnames


@pytest.mark.parametrize("kind", DECLARED, ids=name_of)
def test_packing_and_parsing_preserve_the_fields(kind):
    values = {field.name: some(field, i) for i, field in enumerate(kind.fields)}
    (got,) = Parser().push(Encoder(system=7, component=1).encode(kind(**values)))
    assert type(got) is kind
    assert (got.get_msgId(), got.get_type(), got.get_srcSystem()) == (kind.id, kind.msgname, 7)
    assert {name: getattr(got, name) for name in kind.fieldnames} == values
    assert got.to_dict() == {"mavpackettype": kind.msgname, **values}
    again = kind(*(values[name] for name in kind.fieldnames))
    assert {name: getattr(again, name) for name in kind.fieldnames} == values


@pytest.mark.parametrize("name", EXTENSIONS)
def test_extensions_are_compatible_with_programs_without_them(name):
    """Frames without extensions are read with zeros; ours with zero extensions are equal byte for byte."""
    old = GENERATED[name]
    lengths = dict(zip(old.ordered_fieldnames, old.array_lengths, strict=True))
    values = {
        field: [5 + i] * lengths[field] if lengths[field] else 5 + i for i, field in enumerate(old.fieldnames)
    }
    encoder, parser = Encoder(system=1, component=1), Parser()
    theirs = old(**values).pack(common.MAVLink(None, srcSystem=1, srcComponent=1))
    (got,) = parser.push(theirs)
    kind = common.mavlink_map[old.id]
    assert {field: getattr(got, field) for field in old.fieldnames} == values
    assert not any(np.any(getattr(got, field)) for field in set(kind.fieldnames) - set(old.fieldnames))
    assert encoder.encode(kind(**values)) == theirs
    first_version = old(**values).pack(common.MAVLink(None, srcSystem=1, srcComponent=1), force_mavlink1=True)
    (got,) = parser.push(first_version)
    assert isinstance(got, kind)


def test_an_unknown_field_is_refused():
    with pytest.raises(TypeError, match=r"^PROTOCOL_VERSION has the fields version, min_version"):
        dialect.ProtocolVersion(versions=1)
