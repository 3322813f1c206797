"""The Lua script has the layout of a beacon; multiprocess/test_beacon_dissector.py runs it in tshark."""

import re

import pytest

from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.radio import beacon as wire
from autopilot.onboard.radio.beacon_dissector import FLAGS, dissector
from netsim.wire.messages import DEFAULT_PORT

LINE = re.compile(
    r"\{at = (\d+), size = (\d+), field = ProtoField\.(\w+)\(\"coflight_beacon\.([\w.]+)\"(.*)\},"
)
KINDS = {"uint8": "u1", "uint16": "<u2", "uint32": "<u4", "uint64": "<u8", "float": "<f4"}


@pytest.mark.parametrize(("layout", "prefix"), [(wire.HEADER, ""), (wire.RANGE, "range.")])
def test_every_field_of_the_layout_is_in_the_script_once(layout, prefix):
    fields = [found.groups() for found in LINE.finditer(dissector(DEFAULT_PORT))]
    part = [field for field in fields if field[3].startswith("range.") == bool(prefix)]
    assert [(name, KINDS[kind], int(at)) for at, _, kind, name, _ in part] == [
        (f"{prefix}{name}", layout[name].str.replace("|", ""), layout.fields[name][1])
        for name in layout.names
    ]
    assert sum(int(size) for _, size, *_ in part) == layout.itemsize


def test_every_quantity_has_the_unit_of_its_name():
    units = {"m": "m", "s": "m/s", "mm": "mm", "ms": "ms", "us": "us"}
    for *_, name, rest in (found.groups() for found in LINE.finditer(dissector(DEFAULT_PORT))):
        unit = re.search(r'unit = "([^"]+)"', rest)
        assert (unit and unit[1]) == units.get(name.rpartition("_")[2]), name


def test_constants_are_those_of_the_beacon():
    script = dissector(DEFAULT_PORT)
    assert f"local PORT = {DEFAULT_PORT}\n" in script
    assert f"HEADER_BYTES, RANGE_BYTES = {wire.HEADER_BYTES}, {wire.RANGE_BYTES}\n" in script
    assert f"{{at = 0, least = {wire.VERSION}, most = {wire.VERSION}}},  -- version\n" in script
    assert f"least = 0, most = {max(FlightPhase):d}}},  -- phase\n" in script
    assert f"least = 0, most = {wire.MAX_RANGES}}},  -- count\n" in script
    assert set(FLAGS.values()) == {wire.HAS_START, wire.HAS_FIX, wire.HAS_GPS_ERROR}
