"""Encoding of beacons: round trip, documented sizes, and rejection of invalid bytes.

Run time: 3 s.
"""

import struct

import pytest
from beacons import Beacon, decode, encode
from hypothesis import given
from hypothesis import strategies as st
from msgspec import ValidationError, convert
from msgspec.structs import replace

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.radio import beacon as wire
from autopilot.parameters.onboard_config import OnboardConfig
from netsim.wire.messages import MAX_PAYLOAD_BYTES

single = st.floats(-1e4, 1e4, width=32)
vectors = st.tuples(single, single, single)
speed = st.floats(-17.0, 17.0, width=32)  # the limit is 30 m/s: 17 sqrt(3) = 29.4
stds = st.integers(0, 65_535).map(lambda std_mm: std_mm * 1e-3)
stated = st.none() | st.integers(1, 65_535).map(lambda std_mm: std_mm * 1e-3)
milliseconds = st.integers(0, 2**32 - 1)
fixes = st.builds(Fix, milliseconds, vectors, stated, stated)
STATION = 7
decode(b"")  # compiles the decoder before Hypothesis measures its deadline


@st.composite
def beacons_(draw):
    station = draw(st.integers(0, 255))
    peers = draw(st.lists(st.integers(0, 255).filter(lambda peer: peer != station), max_size=20, unique=True))
    return Beacon(
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
    """Return a beacon with all fields."""
    return Beacon(
        station=STATION, seq=3, time_us=5_000_000, phase=FlightPhase.ON_STATION,
        odometry_ned_m=(1.0, 2.0, 3.0), vel_ned_m_s=(4.0, 5.0, 6.0), motion_start_ms=9_000,
        fix=Fix(4_900, (7.0, 8.0, 9.0), 1.5, 2.5), gps_error=wire.GpsError((0.5, -0.5, 1.0), 0.25),
        distances=tuple(wire.Distance(peer, 4_800, 8.5, 0.125) for peer in peers),
    )  # fmt: skip


@given(beacons)
def test_a_decoded_beacon_equals_the_encoded_one(beacon):
    assert decode(encode(beacon)) == beacon


@pytest.mark.parametrize(
    ("stations", "distances", "size"), [(8, 7, 156), (16, 15, 244), (8, 4, 123), (16, 8, 167)]
)
def test_beacons_have_the_documented_size(stations, distances, size):
    # All others, or N / 2 of them where each pair is measured by one of its ends.
    assert distances in {stations - 1, stations // 2}
    assert len(encode(full_beacon(range(100, 100 + distances)))) == size
    assert (wire.HEADER_BYTES, wire.RANGE_BYTES) == (79, 11)


def test_the_largest_beacon_fits_a_datagram_and_one_distance_more_does_not():
    size = len(encode(full_beacon(range(100, 100 + wire.MAX_RANGES))))
    assert size <= MAX_PAYLOAD_BYTES < size + wire.RANGE_BYTES
    with pytest.raises(ValueError, match="127 distances"):
        encode(full_beacon(range(100, 101 + wire.MAX_RANGES)))


@given(st.binary(max_size=300))
def test_the_decoder_raises_for_no_bytes(buffer):
    decode(buffer)
    decode(bytes((wire.VERSION,)) + buffer)


@given(beacons, st.data())
def test_a_corrupted_beacon_that_decodes_is_a_valid_beacon(beacon, data):
    # Any bytes that decode do so to a beacon that survives encoding and decoding.
    buffer = bytearray(encode(beacon))
    for _ in range(data.draw(st.integers(1, 3))):
        buffer[data.draw(st.integers(0, len(buffer) - 1))] = data.draw(st.integers(0, 255))
    decoded = decode(bytes(buffer))
    if decoded is not None:
        assert decode(encode(decoded)) == decoded


@given(beacons, st.data())
def test_a_beacon_of_wrong_length_is_rejected(beacon, data):
    buffer = encode(beacon)
    assert decode(buffer[: data.draw(st.integers(0, len(buffer) - 1))]) is None
    assert decode(buffer + b"\0") is None


# Header: u8 x 5, u32, u64, then f32 of odometry and velocity (17), start, fix_ms, fix (49), stds, error (65).
FLOATS = [17, 21, 25, 29, 33, 37, 49, 53, 57, 65, 69, 73, 79 + 5]


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf"), 1e30])
@pytest.mark.parametrize("offset", FLOATS)
def test_a_beacon_with_impossible_numbers_is_rejected(number, offset):
    buffer = bytearray(encode(full_beacon()))
    assert decode(bytes(buffer)) is not None
    struct.pack_into("<f", buffer, offset, number)
    assert decode(bytes(buffer)) is None


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -0.6, 0.8), (0.48, 0.6, -0.64)])
def test_a_speed_above_30_m_s_is_rejected(direction):
    for speed_m_s, accepted in ((29.9, True), (30.1, False), (3e5, False)):
        beacon = replace(full_beacon(), vel_ned_m_s=tuple(speed_m_s * part for part in direction))
        assert (decode(encode(beacon)) is not None) is accepted


def test_the_beacon_period_is_at_most_one_second():
    """Localisation waits so long for odometry, and avoidance for a neighbour."""
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
def test_undefined_or_contradictory_fields_are_rejected(offset, value):
    buffer = bytearray(encode(full_beacon(peers=(1, 2))))
    assert decode(bytes(buffer)) is not None
    buffer[offset] = value
    assert decode(bytes(buffer)) is None


def test_standard_deviations_saturate_and_a_stated_one_is_at_least_1_mm():
    beacon = replace(
        full_beacon(),
        fix=Fix(4_900, (7.0, 8.0, 9.0), float("inf"), 1e-6),
        gps_error=wire.GpsError((0.0, 0.0, 0.0), 100.0),
    )
    decoded = decode(encode(beacon))
    assert decoded.fix.std_h_m == decoded.gps_error.std_m == 65.535
    assert decoded.fix.std_v_m == 0.001


def test_an_invalid_standard_deviation_is_not_encoded():
    for std_m, error in ((float("nan"), ValueError), (-0.1, struct.error)):
        with pytest.raises(error):
            encode(replace(full_beacon(), gps_error=wire.GpsError((0.0, 0.0, 0.0), std_m)))
