"""The beacon's bytes: what goes in comes out, its size is what is documented, and wrong bytes are None.

Costs 3 s.
"""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import ValidationError, convert
from msgspec.structs import replace

from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.radio import beacon as wire
from autopilot.parameters.config import OnboardConfig
from netsim.wire.messages import MAX_PAYLOAD_BYTES

single = st.floats(-1e4, 1e4, width=32)
vectors = st.tuples(single, single, single)
speed = st.floats(-17.0, 17.0, width=32)  # 30 m/s is the most in all: 17 sqrt(3) = 29.4
stds = st.integers(0, 65_535).map(lambda std_mm: std_mm * 1e-3)
stated = st.none() | st.integers(1, 65_535).map(lambda std_mm: std_mm * 1e-3)
milliseconds = st.integers(0, 2**32 - 1)
fixes = st.builds(wire.Fix, milliseconds, vectors, stated, stated)
STATION = 7
wire.decode(b"")  # compiles what reads it, for which Hypothesis has no patience


@st.composite
def beacons_(draw):
    station = draw(st.integers(0, 255))
    peers = draw(st.lists(st.integers(0, 255).filter(lambda peer: peer != station), max_size=20, unique=True))
    return wire.Beacon(
        station=station,
        seq=draw(st.integers(0, wire.SEQ_MODULUS - 1)),
        time_us=draw(st.integers(0, 2**63 - 1)),
        phase=draw(st.sampled_from(FlightPhase)),
        odometry_ned_m=draw(vectors),
        vel_ned_m_s=draw(st.tuples(speed, speed, speed)),
        motion_start_ms=draw(st.none() | milliseconds),
        fix=draw(st.none() | fixes),
        gps_error=draw(st.none() | st.builds(wire.GpsError, vectors, stds)),
        distances=tuple(wire.Distance(peer, draw(milliseconds), draw(single), draw(stds)) for peer in peers),
    )


beacons = beacons_()


def full_beacon(peers=(1,)):
    """Give a beacon that leaves nothing out."""
    return wire.Beacon(
        station=STATION, seq=3, time_us=5_000_000, phase=FlightPhase.ON_STATION,
        odometry_ned_m=(1.0, 2.0, 3.0), vel_ned_m_s=(4.0, 5.0, 6.0), motion_start_ms=9_000,
        fix=wire.Fix(4_900, (7.0, 8.0, 9.0), 1.5, 2.5), gps_error=wire.GpsError((0.5, -0.5, 1.0), 0.25),
        distances=tuple(wire.Distance(peer, 4_800, 8.5, 0.125) for peer in peers),
    )  # fmt: skip


@given(beacons)
def test_a_beacon_survives_the_wire(beacon):
    assert wire.decode(wire.encode(beacon)) == beacon


@pytest.mark.parametrize(
    ("stations", "distances", "size"), [(8, 7, 156), (16, 15, 244), (8, 4, 123), (16, 8, 167)]
)
def test_beacons_have_the_documented_size(stations, distances, size):
    # All others, or N / 2 of them where each pair is measured by one of its ends.
    assert distances in {stations - 1, stations // 2}
    assert len(wire.encode(full_beacon(range(100, 100 + distances)))) == size
    assert (wire.HEADER_BYTES, wire.RANGE_BYTES) == (79, 11)


def test_the_largest_beacon_fits_a_datagram_and_one_distance_more_does_not():
    size = len(wire.encode(full_beacon(range(100, 100 + wire.MAX_RANGES))))
    assert size <= MAX_PAYLOAD_BYTES < size + wire.RANGE_BYTES
    with pytest.raises(ValueError, match="127 distances"):
        wire.encode(full_beacon(range(100, 101 + wire.MAX_RANGES)))


@given(st.binary(max_size=300))
def test_no_bytes_make_the_decoder_raise(buffer):
    wire.decode(buffer)
    wire.decode(bytes((wire.VERSION,)) + buffer)


@given(beacons, st.data())
def test_what_is_believed_of_a_spoilt_beacon_could_have_been_sent(beacon, data):
    # Any bytes that decode at all decode to a beacon whose own bytes say the same.
    buffer = bytearray(wire.encode(beacon))
    for _ in range(data.draw(st.integers(1, 3))):
        buffer[data.draw(st.integers(0, len(buffer) - 1))] = data.draw(st.integers(0, 255))
    heard = wire.decode(bytes(buffer))
    if heard is not None:
        assert wire.decode(wire.encode(heard)) == heard


@given(beacons, st.data())
def test_a_beacon_cut_short_or_drawn_out_is_none(beacon, data):
    buffer = wire.encode(beacon)
    assert wire.decode(buffer[: data.draw(st.integers(0, len(buffer) - 1))]) is None
    assert wire.decode(buffer + b"\0") is None


# Header: u8 x 5, u32, u64, then f32 of odometry and velocity (17), start, fix_ms, fix (49), stds, error (65).
FLOATS = [17, 21, 25, 29, 33, 37, 49, 53, 57, 65, 69, 73, 79 + 5]


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf"), 1e30])
@pytest.mark.parametrize("offset", FLOATS)
def test_numbers_that_cannot_be_make_it_none(number, offset):
    buffer = bytearray(wire.encode(full_beacon()))
    assert wire.decode(bytes(buffer)) is not None
    struct.pack_into("<f", buffer, offset, number)
    assert wire.decode(bytes(buffer)) is None


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -0.6, 0.8), (0.48, 0.6, -0.64)])
def test_nobody_flies_at_more_than_30_m_s(direction):
    for speed_m_s, believed in ((29.9, True), (30.1, False), (3e5, False)):
        beacon = replace(full_beacon(), vel_ned_m_s=tuple(speed_m_s * part for part in direction))
        assert (wire.decode(wire.encode(beacon)) is not None) is believed


def test_a_beacon_comes_once_a_second_at_least():
    """So many are heard within what localisation waits for odometry, and avoidance for a neighbour."""
    assert convert({"beacon_period_ms": 1_000}, OnboardConfig).beacon_period_ms == 1_000
    with pytest.raises(ValidationError):
        convert({"beacon_period_ms": 1_001}, OnboardConfig)


@pytest.mark.parametrize(
    ("offset", "value"),
    [
        (0, wire.VERSION - 1),
        (0, wire.VERSION + 1),
        (2, max(FlightPhase) + 1),
        (2, 255),
        (3, 8),
        (3, 128),
        (16, 0x80),  # the time's sign bit
        (79, STATION),  # a distance to itself
        (90, 1),  # a second distance to the peer of the first
    ],
)
def test_bytes_that_no_sender_would_send_make_it_none(offset, value):
    buffer = bytearray(wire.encode(full_beacon(peers=(1, 2))))
    assert wire.decode(bytes(buffer)) is not None
    buffer[offset] = value
    assert wire.decode(bytes(buffer)) is None


def test_standard_deviations_saturate_and_a_stated_one_is_never_unstated():
    beacon = replace(
        full_beacon(),
        fix=wire.Fix(4_900, (7.0, 8.0, 9.0), float("inf"), 1e-6),
        gps_error=wire.GpsError((0.0, 0.0, 0.0), 100.0),
    )
    heard = wire.decode(wire.encode(beacon))
    assert heard.fix.std_h_m == heard.gps_error.std_m == 65.535
    assert heard.fix.std_v_m == 0.001


def test_a_standard_deviation_that_is_none_does_not_leave_the_house():
    for std_m, error in ((float("nan"), ValueError), (-0.1, struct.error)):
        with pytest.raises(error):
            wire.encode(replace(full_beacon(), gps_error=wire.GpsError((0.0, 0.0, 0.0), std_m)))
