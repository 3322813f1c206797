"""Offboard setpoints: decoding of masks and frames, and the selection among several sources."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.commander import Commander
from autopilot.commander.params import CommanderParams
from autopilot.control import ControlParams, FlightController
from autopilot.estimation.estimator import Estimator
from autopilot.estimation.params import EstimatorParams
from autopilot.mavlink import dialect
from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.mode_registry import mode_table
from autopilot.services.flight_data import FlightData, Home
from autopilot.services.offboard import OffboardService
from autopilot.services.service import APPLICATION_PARTNER, COMPANION, GROUND_STATION, Partner
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.geometry.rotations import quat_from_euler
from foundation.types import AttitudeSetpoint, RateSetpoint, TrajectorySetpoint

NAN = math.nan
STATION, PROGRAM = Partner(GROUND_STATION, 0), Partner(COMPANION, 1)
ALL = sum(Condition)
LOSS_US = 1_000_000
"""COM_OF_LOSS_T"""
ORIGIN = {"origin_lat_deg": 47.0, "origin_lon_deg": 8.0, "origin_alt_m": 488.0}
HERE_NED_M, YAW_RAD = (10.0, -20.0, -5.0), 0.5 * math.pi
POSITION, VELOCITY, ACCELERATION = 0b1101_1111_1000, 0b1101_1100_0111, 0b1100_0011_1111
YAW_IGNORED, YAW_RATE_IGNORED, FORCE = 1 << 10, 1 << 11, 1 << 9
LOCAL_FRAMES = (
    common.MAV_FRAME_LOCAL_NED, common.MAV_FRAME_LOCAL_OFFSET_NED, common.MAV_FRAME_BODY_NED,
    common.MAV_FRAME_BODY_OFFSET_NED,
)  # fmt: skip
GLOBAL_FRAMES = (0, 3, 5, 6)
EVERY_MASK = range(1 << 12)


def make_flight(*, commander=None):
    """In the air, heading east."""
    estimator = Estimator(EstimatorParams())
    state = estimator.state
    state.pos_ned_m, state.q_ned_frd = np.array(HERE_NED_M), quat_from_euler(0.0, 0.0, YAW_RAD)
    state.attitude_valid = state.velocity_valid = state.position_valid = state.height_valid = True
    state.origin_lat_deg, state.origin_lon_deg, state.origin_alt_m = ORIGIN.values()
    home = Home(lat_deg=47.0, lon_deg=8.0, alt_m=485.0, pos_ned_m=(0, 0, 3.0), q_ned_frd=(1, 0, 0, 0))
    return FlightData(
        estimator=estimator,
        commander=commander or Commander(CommanderParams(), mode_table()),
        state=state,
        home=home,
    )


def local(mask, *, frame=common.MAV_FRAME_LOCAL_NED, **values):
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    return common.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, **dict.fromkeys(names, NAN) | values
    )


def global_(mask, *, frame=common.MAV_FRAME_GLOBAL_INT, lat=47.0, lon=8.0, **values):
    names = ("alt", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    return common.MAVLink_set_position_target_global_int_message(
        0, 1, 1, frame, mask, round(lat * 1e7), round(lon * 1e7), **dict.fromkeys(names, NAN) | values
    )


def attitude(mask, *, q=(1.0, 0.0, 0.0, 0.0), rates=(NAN, NAN, NAN), thrust=0.5, thrust_body=(0, 0, 0)):
    return dialect.SetAttitudeTarget(0, 1, 1, mask, list(q), *rates, thrust, list(thrust_body))


def decode(message, flight=None):
    service = OffboardService(flight or make_flight())
    assert service.on_message(message, 5, STATION) == ()
    assert service.rejected == (service.setpoint is None)
    assert service.received_us == (None if service.setpoint is None else 5)
    return service.setpoint


# ---- positions, velocities, accelerations


def test_groups_and_axes_match_the_mask():
    got = decode(local(POSITION, x=1.0, y=2.0, z=-3.0))
    assert got.pos_ned_m == (1.0, 2.0, -3.0)
    assert (got.vel_ned_m_s, got.acc_ned_m_s2, got.yaw_rad, got.yaw_rate_rad_s) == (None, None, None, 0.0)
    # north and east position, down velocity, and yaw
    got = decode(local(0b1001_1101_1100, x=1.0, y=2.0, vz=0.5, yaw=0.1))
    assert (got.pos_axes, got.vel_axes) == ((True, True, False), (False, False, True))
    assert (got.vel_ned_m_s[2], got.yaw_rad) == (0.5, 0.1)


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (common.MAV_FRAME_LOCAL_NED, (1.0, 2.0, -3.0)),
        (common.MAV_FRAME_LOCAL_OFFSET_NED, (11.0, -18.0, -8.0)),
        (common.MAV_FRAME_BODY_OFFSET_NED, (8.0, -19.0, -8.0)),  # forward is east, right is south
    ],
)
def test_positions_by_frame(frame, expected):
    got = decode(local(POSITION, frame=frame, x=1.0, y=2.0, z=-3.0))
    assert np.allclose(got.pos_ned_m, expected)


@pytest.mark.parametrize("frame", LOCAL_FRAMES)
@pytest.mark.parametrize(
    ("mask", "names"), [(VELOCITY, ("vx", "vy", "vz")), (ACCELERATION, ("afx", "afy", "afz"))]
)
def test_velocities_and_accelerations_by_frame(frame, mask, names):
    got = decode(local(mask, frame=frame, **dict(zip(names, (2.0, 1.0, 0.5), strict=True))))
    vector = got.vel_ned_m_s if mask == VELOCITY else got.acc_ned_m_s2
    turned = frame in {common.MAV_FRAME_BODY_NED, common.MAV_FRAME_BODY_OFFSET_NED}
    assert np.allclose(vector, (-1.0, 2.0, 0.5) if turned else (2.0, 1.0, 0.5))


@pytest.mark.parametrize("frame", GLOBAL_FRAMES)
def test_a_global_position_is_converted_to_the_local_frame(frame):
    lat, lon, _ = ned_to_geodetic([30.0, 40.0, 0.0], **ORIGIN)
    above = 485.0 if frame in {3, 6} else 0.0
    got = decode(global_(POSITION & ~YAW_IGNORED, frame=frame, lat=lat, lon=lon, alt=500.0 - above, yaw=1.0))
    # 1e-8 degrees are 1 mm; the altitude is not curved
    assert np.allclose(got.pos_ned_m, (30.0, 40.0, 488.0 - 500.0), atol=0.01)
    assert got.yaw_rad == 1.0


def test_a_height_above_home_requires_a_home():
    flight = make_flight()
    flight.home = None
    assert decode(global_(POSITION, frame=6, alt=5.0), flight) is None
    assert decode(global_(POSITION, frame=5, alt=500.0), flight) is not None


@pytest.mark.parametrize(
    "message",
    [
        local(0b1101_1111_1111),
        local(POSITION, x=1.0, y=NAN, z=0.0),
        local(POSITION, x=1.0, y=0.0, z=1e30),
        local(POSITION & ~YAW_IGNORED, x=0.0, y=0.0, z=0.0),
        local(POSITION, frame=common.MAV_FRAME_BODY_NED, x=0.0, y=0.0, z=0.0),
        local(POSITION | 0b10, frame=common.MAV_FRAME_BODY_OFFSET_NED, x=0.0, z=0.0),
        local(VELOCITY | 1 << 4, frame=common.MAV_FRAME_BODY_NED, vx=0.0, vz=0.0),
        local(POSITION, frame=common.MAV_FRAME_LOCAL_ENU, x=0.0, y=0.0, z=0.0),
        local(ACCELERATION | FORCE, afx=0.0, afy=0.0, afz=0.0),
        global_(POSITION, frame=11, alt=5.0),
        global_(POSITION, frame=1, alt=5.0),
        global_(POSITION, lon=214.7483647, alt=5.0),
        global_(POSITION | 0b01, alt=5.0),
        attitude(0b111, q=(NAN, 0.0, 0.0, 0.0)),
        attitude(0b111, q=(0.0, 0.0, 0.0, 0.0)),
        attitude(0b111, thrust=NAN),
        attitude(0b111 | 1 << 6),
        attitude(1 << 7, rates=(0.0, NAN, 0.0)),
        attitude(1 << 7 | 0b001, rates=(0.0, 0.0, 0.0)),
    ],
)
def test_an_invalid_setpoint_is_dropped_and_counted(message):
    assert decode(message) is None


# ---- attitudes and rates


def test_an_attitude_is_normalised_and_has_the_yaw_rate():
    got = decode(attitude(0b011, q=(0.72, 0.0, 0.0, 0.72), rates=(NAN, NAN, 0.3), thrust=0.4))
    assert isinstance(got, AttitudeSetpoint)
    assert np.allclose(got.q_ned_frd, quat_from_euler(0.0, 0.0, YAW_RAD))
    assert (got.yaw_rate_rad_s, got.thrust) == (0.3, 0.4)
    assert decode(attitude(0b111, rates=(0.0, 0.0, 0.3))).yaw_rate_rad_s == 0.0


def test_rates_are_used_if_the_attitude_is_ignored():
    got = decode(attitude(1 << 7, q=(NAN,) * 4, rates=(0.1, -0.2, 0.3), thrust=1.5))
    assert isinstance(got, RateSetpoint)
    assert (got.rate_frd_rad_s.tolist(), got.thrust) == ([0.1, -0.2, 0.3], 1.0)
    assert isinstance(decode(attitude(0, rates=(0.1, -0.2, 0.3))), AttitudeSetpoint)


def test_only_the_component_of_a_thrust_vector_along_the_rotors_is_used():
    wire = Encoder(system=255, component=190).encode(attitude(0b111 | 1 << 5, thrust_body=(0.5, 0.0, -0.25)))
    (message,) = Parser().push(wire)
    assert decode(message).thrust == 0.25


# ---- arbitrary values


def is_flown(setpoint):
    """Whether the controller computes valid controls from it."""
    flight = make_flight()
    controller = FlightController(ControlParams())
    controls = np.array(controller.update(flight.state, setpoint, dt_s=0.004, landed=False))
    return np.isfinite(controls).all() and (controls >= 0.0).all() and (controls <= 1.0).all()


@pytest.mark.parametrize("frame", [*LOCAL_FRAMES, *GLOBAL_FRAMES])
def test_every_mask_gives_a_setpoint_of_the_values_not_ignored_or_is_rejected(frame):
    names = ("vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    rest = {name: 0.1 + 0.1 * i for i, name in enumerate(names)}
    service = OffboardService(make_flight())
    by_heading = frame in {common.MAV_FRAME_BODY_NED, common.MAV_FRAME_BODY_OFFSET_NED}
    for count, mask in enumerate(EVERY_MASK, 1):
        if frame in GLOBAL_FRAMES:
            message = global_(mask, frame=frame, alt=3.0, **rest)
        else:
            message = local(mask, frame=frame, x=1.0, y=2.0, z=3.0, **rest)
        rejected = service.rejected
        service.on_message(message, count, STATION)
        groups = [tuple(not mask >> 3 * group & 1 << axis for axis in range(3)) for group in range(3)]
        cannot = not any(itertools.chain(*groups)) or (mask & FORCE and any(groups[2]))
        cannot |= frame == common.MAV_FRAME_BODY_NED and any(groups[0])
        if by_heading:
            cannot |= any(group[0] is not group[1] for group in groups)
        if frame in GLOBAL_FRAMES:
            cannot |= groups[0][0] is not groups[0][1]
        assert (service.rejected > rejected) == bool(cannot)
        if cannot:
            continue
        got = service.setpoint
        assert isinstance(got, TrajectorySetpoint)
        assert service.received_us == count
        vectors = (got.pos_ned_m, got.vel_ned_m_s, got.acc_ned_m_s2)
        axes = (got.pos_axes, got.vel_axes, got.acc_axes)
        for group, vector, used in zip(groups, vectors, axes, strict=True):
            assert (vector is not None) == any(group)
            assert vector is None or (used == group and not np.array(vector)[~np.array(group)].any())
        assert (got.yaw_rad is None) == bool(mask & YAW_IGNORED)
        assert (got.yaw_rate_rad_s == 0.0) == bool(mask & YAW_RATE_IGNORED)
        if mask % 7 == 0:
            assert is_flown(got)


@pytest.mark.parametrize("mask", range(256))
def test_every_mask_of_attitudes_gives_a_setpoint_or_is_rejected(mask):
    got = decode(attitude(mask, rates=(0.1, 0.2, 0.3), thrust_body=(0.0, 0.0, -0.5)))
    rates_alone = bool(mask & 1 << 7)
    cannot = (mask & 1 << 6 and not mask & 1 << 5) or (rates_alone and mask & 0b011)
    assert (got is None) == bool(cannot)
    assert got is None or (isinstance(got, RateSetpoint) == rates_alone and is_flown(got))


ANY = st.floats(width=32) | st.sampled_from([0.0, NAN, math.inf, 1e30, -1e9])


@given(mask=st.integers(0, 65_535), frame=st.integers(0, 255), values=st.lists(ANY, min_size=11, max_size=11))
def test_no_values_of_a_local_target_raise(mask, frame, values):
    message = common.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *values)
    got = decode(message)
    assert got is None or is_flown(got)


@given(
    mask=st.integers(0, 65_535), frame=st.sampled_from([0, 3, 5, 6, 11, 99]),
    place=st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 2), values=st.lists(ANY, min_size=9, max_size=9),
)  # fmt: skip
def test_no_values_of_a_global_target_raise(mask, frame, place, values):
    message = common.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, mask, *place, *values)
    got = decode(message)
    assert got is None or is_flown(got)


@given(mask=st.integers(0, 255), q=st.lists(ANY, min_size=4, max_size=4),
       values=st.lists(ANY, min_size=4, max_size=4), body=st.lists(ANY, min_size=3, max_size=3))  # fmt: skip
def test_no_values_of_an_attitude_target_raise(mask, q, values, body):
    got = decode(dialect.SetAttitudeTarget(0, 1, 1, mask, q, *values, body))
    assert got is None or is_flown(got)


def test_nothing_raises_before_the_estimate_is_valid():
    flight = make_flight()
    state = flight.state
    state.attitude_valid = state.velocity_valid = state.position_valid = state.height_valid = False
    flight.home = None
    zeros = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0.0)
    got = [decode(local(0, frame=frame, **zeros), flight) for frame in LOCAL_FRAMES]
    assert [setpoint is None for setpoint in got] == [False, True, True, True]
    zeros.pop("x"), zeros.pop("y"), zeros.pop("z")
    assert all(decode(global_(0, frame=frame, alt=0.0, **zeros), flight) is None for frame in GLOBAL_FRAMES)


# ---- selection of the source


class Sources:
    """An offboard service with sources, each of which sends its own east."""

    def __init__(self):
        self.commander = Commander(CommanderParams(), mode_table())
        self.service = OffboardService(make_flight(commander=self.commander))

    def send(self, now_us, partner, east_m):
        self.service.on_message(local(POSITION, x=0.0, y=east_m, z=-5.0), now_us, partner)

    def fly(self):
        """Arm and enter Offboard, as seen by the service."""
        self.commander.update(0, conditions=ALL, landed=True)
        assert self.commander.arm(0) is None
        assert self.commander.set_mode(FlightMode.OFFBOARD) is None

    @property
    def flown(self):
        return self.service.setpoint.pos_ned_m[1]


def test_freshness_ends_with_the_timeout():
    sources = Sources()
    assert not sources.service.is_fresh(0, LOSS_US)
    sources.send(1_000, STATION, 0.0)
    assert sources.service.is_fresh(501_000, 500_000)
    assert not sources.service.is_fresh(501_001, 500_000)


def test_before_any_request_the_newest_source_is_selected():
    sources = Sources()
    sources.send(0, APPLICATION_PARTNER, 1.0)
    sources.send(4_000, STATION, 2.0)
    assert sources.flown == 2.0
    sources.send(8_000, APPLICATION_PARTNER, 3.0)
    assert sources.flown == 3.0


def test_a_requester_is_selected_over_newer_sources():
    sources = Sources()
    sources.send(0, STATION, 1.0)
    sources.send(4_000, APPLICATION_PARTNER, 2.0)
    sources.service.ask(STATION, 8_000)
    sources.fly()
    sources.send(12_000, APPLICATION_PARTNER, 3.0)
    assert (sources.flown, sources.service.source) == (1.0, STATION)
    sources.send(16_000, STATION, 4.0)
    assert sources.flown == 4.0
    sources.service.ask(APPLICATION_PARTNER, 20_000)
    assert sources.flown == 3.0


def test_one_sources_stream_does_not_keep_another_alive():
    # the station's stream stops at 0 s and is lost at 1 s, although the application still sends
    sources = Sources()
    sources.send(0, STATION, 1.0)
    sources.service.ask(STATION, 0)
    sources.fly()
    for now_us in range(0, LOSS_US + 1, 100_000):
        sources.send(now_us, APPLICATION_PARTNER, 2.0)
        assert sources.service.is_fresh(now_us, LOSS_US)
    assert not sources.service.is_fresh(LOSS_US + 1, LOSS_US)
    assert sources.flown == 1.0
    # in another mode Offboard may be requested with any fresh source
    assert sources.commander.set_mode(FlightMode.HOLD) is None
    assert sources.service.is_fresh(LOSS_US + 4_000, LOSS_US)
    assert sources.flown == 2.0


def test_a_request_from_a_station_without_a_stream_keeps_the_companions_program():
    sources = Sources()
    sources.send(0, PROGRAM, 1.0)
    sources.service.ask(STATION, 4_000)
    assert sources.service.source == PROGRAM
    sources.fly()
    sources.send(8_000, APPLICATION_PARTNER, 2.0)
    sources.service.ask(STATION, 12_000)  # the selected source is fresh, and stays
    assert sources.service.source == PROGRAM
    sources.service.ask(STATION, 8_000 + LOSS_US)  # the program has timed out
    assert sources.service.source == APPLICATION_PARTNER


def test_a_disarmed_vehicle_in_offboard_selects_any_fresh_source():
    sources = Sources()
    sources.send(0, PROGRAM, 1.0)
    sources.service.ask(PROGRAM, 0)
    sources.commander.update(0, conditions=ALL, landed=True)
    assert sources.commander.set_mode(FlightMode.OFFBOARD) is None
    sources.send(5 * LOSS_US, STATION, 2.0)
    assert sources.service.is_fresh(5 * LOSS_US, LOSS_US)
    assert sources.flown == 2.0


def test_many_sources_neither_replace_the_selected_one_nor_accumulate():
    sources = Sources()
    sources.send(0, PROGRAM, 1.0)
    sources.service.ask(PROGRAM, 0)
    sources.fly()
    for number in range(1_000):
        sources.send(4_000 + number, Partner(GROUND_STATION, number), 2.0)
    assert sources.flown == 1.0
    assert len(sources.service._received) == 8
    assert sources.service._received.keys() >= {PROGRAM, Partner(GROUND_STATION, 999)}
