"""The beacon's bytes: what goes in comes out, its size is what is documented, and wrong bytes are None."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.onboard import beacon as wire

single = st.floats(-1e4, 1e4, width=32)
vectors = st.tuples(single, single, single)
fixes = st.builds(wire.Fix, st.integers(0, 2**32 - 2), vectors)
distances = st.builds(
    wire.Distance,
    st.integers(0, 255),
    st.integers(0, 2**32 - 1),
    single,
    st.integers(0, 65_535).map(lambda std_mm: std_mm * 1e-3),
)
beacons = st.builds(
    wire.Beacon,
    st.integers(0, 255),
    st.integers(0, 2**63 - 1),
    vectors,
    vectors,
    st.none() | fixes,
    st.lists(distances, max_size=20).map(tuple),
)


@given(beacons)
def test_a_beacon_survives_the_wire(beacon):
    assert wire.decode(wire.encode(beacon)) == beacon


def test_a_formation_of_eight_has_beacons_of_128_bytes():
    distance = wire.Distance(1, 5_000, 8.5, 0.1)
    beacon = wire.Beacon(0, 3, (0.0,) * 3, (0.0,) * 3, None, (distance,) * 7)
    assert len(wire.encode(beacon)) == 128
    assert (wire.HEADER_BYTES, wire.RANGE_BYTES) == (51, 11)


@given(st.binary(max_size=200))
def test_no_bytes_make_the_decoder_raise(buffer):
    wire.decode(buffer)
    wire.decode(bytes((wire.VERSION,)) + buffer)


@given(beacons, st.data())
def test_a_beacon_cut_short_or_drawn_out_is_none(beacon, data):
    buffer = wire.encode(beacon)
    assert wire.decode(buffer[: data.draw(st.integers(0, len(buffer) - 1))]) is None
    assert wire.decode(buffer + b"\0") is None


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf"), 1e30])
@pytest.mark.parametrize("offset", [11, 15, 19, 23, 27, 31, 39, 43, 47, 51 + 5])
def test_numbers_that_cannot_be_make_it_none(number, offset):
    fix = wire.Fix(1, (1.0, 2.0, 3.0))
    beacon = wire.Beacon(0, 3, (0.0,) * 3, (0.0,) * 3, fix, (wire.Distance(1, 5, 8.5, 0.1),))
    buffer = bytearray(wire.encode(beacon))
    assert wire.decode(bytes(buffer)) is not None
    struct.pack_into("<f", buffer, offset, number)
    assert wire.decode(bytes(buffer)) is None


def test_another_version_is_none():
    buffer = wire.encode(wire.Beacon(0, 3, (0.0,) * 3, (0.0,) * 3, None, ()))
    assert wire.decode(bytes((wire.VERSION + 1,)) + buffer[1:]) is None
