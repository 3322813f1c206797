"""Invalid and hostile sensor values: nothing raises, all can be sent, one bad sample does no harm (6 s).

A vehicle without physics receives HIL messages made by the test.
"""

import dataclasses
import math

import numpy as np
import pytest
from estimation_fixtures import STEP_S, figure_eight, level_start, replay, rest, rms, simulate, step
from estimation_fixtures import errors as errors_of
from pymavlink.dialects.v20 import common
from vehicle_world import vehicle_config

from autopilot.estimation import kernels, yaw_gsf
from autopilot.estimation.estimator import Estimator
from autopilot.estimation.params import EstimatorParams
from autopilot.estimation.yaw_gsf import YawBank, update_model
from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.hil import HilSensor, pack
from autopilot.services.service import GROUND_STATION, Addressed, Partner
from autopilot.vehicle.vehicle import Vehicle
from foundation.types import ImuSample

ALL_FIELDS = 0x1FFF
I16, U16, I32 = (-(2**15), 2**15 - 1), (0, 2**16 - 1), (-(2**31), 2**31 - 1)
QUIET = {
    "xacc": 0.0, "yacc": 0.0, "zacc": -9.80665, "xgyro": 0.0, "ygyro": 0.0, "zgyro": 0.0,
    "xmag": 0.215, "ymag": 0.01, "zmag": 0.43, "abs_pressure": 957.2, "diff_pressure": 0.0,
    "pressure_alt": 488.0, "temperature": 12.0,
}  # fmt: skip
BAD = (math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e30, 2e5, -2e5, 1e-40, 0.0)
FIX = {
    "fix_type": 3, "lat": 473977418, "lon": 85455939, "alt": 488000, "eph": 100, "epv": 150, "vel": 0,
    "vn": 0, "ve": 0, "vd": 0, "cog": 0, "satellites_visible": 10,
}  # fmt: skip
FIX_RANGES = {
    "fix_type": (0, 8), "lat": I32, "lon": I32, "alt": I32, "eph": U16, "epv": U16, "vel": U16,
    "vn": I16, "ve": I16, "vd": I16, "cog": U16, "satellites_visible": (0, 255),
}  # fmt: skip


class Bench:
    """A vehicle, its messages, and all messages that it can be requested to send, in every step."""

    def __init__(self):
        self.vehicle = Vehicle(vehicle_config())
        self.encoder = Encoder(system=1, component=1)
        self.now_us = 0

    def step(self, *, after_us=4_000, fix=None, fields_updated=ALL_FIELDS, command=None, **changes):
        self.now_us += after_us
        messages = []
        if fix is not None:
            messages.append(common.MAVLink_hil_gps_message(self.now_us, **(FIX | fix)))
        messages.append(HilSensor(time_usec=self.now_us, fields_updated=fields_updated, **(QUIET | changes)))
        commands = [] if command is None else [Addressed(Partner(GROUND_STATION, 0), command)]
        output = self.vehicle.step(sim_messages=messages, link_messages=commands)
        for message in (*output.simulator, *(message for _, message in output.links)):
            self.encoder.encode(message)
        pack(output.actuators, sequence=0, system=1, component=1)
        assert np.isfinite(output.actuators.controls).all()
        for build in self.vehicle.messaging.telemetry.builders.values():
            message = build()
            if message is not None:
                self.encoder.encode(message)

    def get_ready(self):
        """Run at rest until the estimator has its origin."""
        rng = np.random.default_rng(0)
        for k in range(600):
            noise = dict(zip(("xacc", "yacc"), 0.05 * rng.standard_normal(2), strict=True))
            self.step(fix={} if k % 50 == 0 else None, **noise)
        assert self.vehicle.flight.state.position_valid
        return self

    def take_off(self):
        """Request a take-off to 8 m, so that the motors run; the vehicle does not move."""
        for command, *params in (
            (common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, *[0.0] * 6),
            (common.MAV_CMD_NAV_TAKEOFF, *[0.0] * 3, *[math.nan] * 3, 496.0),
        ):
            self.step(command=common.MAVLink_command_long_message(1, 1, command, 0, *params))
        assert self.vehicle.commander.armed
        return self


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("begin", ["unaligned", "ready", "flying"])
def test_nothing_raises_and_all_telemetry_packs_for_all_simulator_messages(seed, begin):
    """Every field sometimes arbitrary, groups missing, steps of no time and of a minute, full-range fixes."""
    rng = np.random.default_rng([seed, len(begin)])
    bench = Bench()
    if begin != "unaligned":
        bench.get_ready()
    if begin == "flying":
        bench.take_off()
    names = list(QUIET)
    for _ in range(1000):
        share = rng.choice((0.0, 0.02, 0.3))
        changes = {}
        for name in names:
            if rng.uniform() < share:
                magnitude = float(np.float32(rng.standard_normal() * 10.0 ** rng.uniform(-3.0, 37.0)))
                changes[name] = float(rng.choice((*BAD, magnitude, magnitude)))
        fix = None
        if rng.uniform() < 0.1:
            fix = {
                name: int(rng.integers(low, high, endpoint=True))
                for name, (low, high) in FIX_RANGES.items()
                if rng.uniform() < share
            }
        bench.step(
            after_us=int(rng.choice((4_000, 0, 1, 1_000_000, 60_000_000), p=(0.95, 0.02, 0.01, 0.01, 0.01))),
            fix=fix,
            fields_updated=int(rng.integers(2**32)) if rng.uniform() < 0.1 else ALL_FIELDS,
            **changes,
        )


def test_telemetry_is_limited_to_the_range_of_its_fields_and_zero_if_not_finite():
    bench = Bench().get_ready()
    telemetry, state = bench.vehicle.messaging.telemetry, bench.vehicle.flight.state
    state.vel_ned_m_s[:] = (710.0, -710.0, math.nan)
    state.pos_ned_m[:] = (0.0, 0.0, -1e12)
    sent = telemetry.motion.global_position_int()
    assert (sent.vx, sent.vy, sent.vz) == (32_767, -32_768, 0)
    assert sent.relative_alt == 2**31 - 1
    state.pos_ned_m[:] = (1e300, -math.inf, math.nan)
    sent = telemetry.motion.local_position_ned()
    assert (sent.x, sent.y) == (pytest.approx(3.4e38, rel=1e-2), -math.inf)
    assert math.isnan(sent.z)
    bench.encoder.encode(sent)
    state.pos_ned_m[:] = state.vel_ned_m_s[:] = 0.0
    for temperature, centidegrees in ((math.nan, 0), (math.inf, 32_767), (-1e30, -32_768), (12.34, 1_234)):
        bench.step(temperature=temperature)
        assert telemetry.sensors.scaled_pressure().temperature == centidegrees


# ---- the estimator


def with_sample(flight, k, accel=None, gyro=None):
    """Replace one inertial sample, all axes or x only."""
    accels, gyros = flight.accel_m_s2.copy(), flight.gyro_rad_s.copy()
    if accel is not None:
        accels[k, 0] = accel
    if gyro is not None:
        gyros[k, 0] = gyro
    return dataclasses.replace(flight, accel_m_s2=accels, gyro_rad_s=gyros)


@pytest.mark.parametrize(
    "broken",
    [
        {"accel": 2e5},
        {"accel": -1e30},
        {"accel": 3.4e38},
        {"accel": math.nan},
        {"gyro": 101.0},
        {"gyro": -1e30},
    ],
    ids=str,
)
def test_an_implausible_sample_is_bridged_by_the_next(broken):
    """The state is constant for 4 ms, in which up to 5 m/s^2 change the velocity by 0.02 m/s.

    If accepted, 2e5 m/s^2 would be 800 m/s, and 101 rad/s 23 degrees.
    """
    flight = simulate(figure_eight, 20.0, np.random.default_rng(5))
    clean = replay(Estimator(EstimatorParams()), flight)
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, with_sample(flight, step(15.0), **broken))
    apart_m_s = max(
        np.abs(a.vel_ned_m_s - b.vel_ned_m_s).max()
        for a, b in zip(clean, states, strict=True)
        if b.velocity_valid
    )
    assert apart_m_s < 0.02
    assert np.abs(states[-1].q_ned_frd - clean[-1].q_ned_frd).max() < 1e-3
    assert not estimator.numerical_failure
    assert states[-1].reset_counter == clean[-1].reset_counter


def test_the_readings_of_a_hard_touch_down_are_accepted():
    """3 m/s that end within 4 ms are 750 m/s^2 upwards, (0, 0, -760) with gravity; and up to the limits."""
    assert kernels.is_plausible(np.zeros(3), np.array([0.0, 0.0, -760.0]))
    for sign in (1.0, -1.0):
        for axis in range(3):
            unit = sign * np.eye(3)[axis]
            accel, gyro = kernels.ACCEL_MAX_M_S2 * unit, kernels.GYRO_MAX_RAD_S * unit
            assert kernels.is_plausible(gyro, accel)
            assert not kernels.is_plausible(1.001 * gyro, accel)
            assert not kernels.is_plausible(gyro, 1.001 * accel)
            assert not kernels.is_plausible(math.nan * unit, accel)


def test_alignment_skips_implausible_samples():
    flight = simulate(rest, 3.0, np.random.default_rng(6))
    for k in (10, 100, 200):
        flight = with_sample(flight, k, accel=3e38)
    states = replay(Estimator(EstimatorParams()), flight)
    assert states[step(1.1)].attitude_valid
    assert rms(errors_of(flight, states).attitude_ned_rad[step(2.0) :, :2]) < math.radians(1.5)


@pytest.mark.parametrize("jump_us", [10**9, 10**15, 2**62, 2**64 - 1])
def test_a_clock_that_jumps_raises_nothing(jump_us):
    """From a quarter of an hour to the greatest value of HIL_SENSOR; then the flight continues from there."""
    flight = simulate(figure_eight, 12.0, np.random.default_rng(7))
    estimator = Estimator(EstimatorParams())
    at = step(11.0)

    def feed_from(first, offset_us):
        for k in range(first, len(flight.time_us)):
            time_us = min(int(flight.time_us[k]) + offset_us, 2**64 - 1)
            if k in flight.fixes:
                estimator.on_gps(dataclasses.replace(flight.fixes[k], time_us=time_us))
            estimator.on_baro(time_us, flight.pressure_pa[k] * 0.01, 15.0)
            estimator.on_mag(time_us, flight.field_gauss[k])
            estimator.on_imu(
                ImuSample(
                    time_us=time_us, accel_frd_m_s2=flight.accel_m_s2[k], gyro_frd_rad_s=flight.gyro_rad_s[k]
                )
            )
            if k == at and first == 0:
                return

    feed_from(0, 0)
    before_us = estimator.clock.estimate_us
    feed_from(at + 1, jump_us)
    state = estimator.state
    assert np.isfinite(state.q_ned_frd).all()
    assert np.isfinite(state.pos_ned_m).all()
    if jump_us >= 2**62:  # not a valid time: all of it is ignored
        assert estimator.clock.estimate_us == before_us


# ---- the second heading estimate


@pytest.mark.parametrize(
    ("variance", "covariance"), [(1e30, 1e30), (1e300, 1e300), (math.inf,) * 2, (math.nan,) * 2, (1.0, 2.0)]
)
def test_a_model_with_an_invalid_covariance_fuses_nothing(variance, covariance):
    """The innovation's determinant is only rounding error, or the covariance is impossible (1 and 2)."""
    model, cov = np.array([1.0, 2.0, 0.5]), np.full((3, 3), covariance)
    np.fill_diagonal(cov, variance)
    assert update_model(model, cov, np.array([5.0, -5.0]), 0.04) == 0.0
    np.testing.assert_array_equal(model, (1.0, 2.0, 0.5))


def test_the_bank_estimates_the_heading_again_after_an_endless_gap():
    """A gap has no information about the heading, and its variance is bounded.

    Unbounded it would grow by 1e-4 rad^2/s to 1e8 in 30000 years, without precision left for the first
    motion.
    """
    tilt = level_start(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
    bank = YawBank(tilt)
    vel_m_s = np.zeros(2)
    bank.fuse(vel_m_s, 0.2)
    tilt.elapsed_s = 1e12
    bank.fuse(vel_m_s, 0.2)
    assert bank.std_rad <= math.sqrt(2.0) * math.pi
    rng = np.random.default_rng(8)
    heading_rad = 2.0  # azimuth of the level frame's x axis: the direction of flight
    for k in range(60):
        forward_m_s2 = 3.0 * math.sin(0.3 * k)
        for _ in range(50):
            yaw_gsf.carry_level(tilt, np.zeros(3), np.array([forward_m_s2, 0.0, -9.80665]), STEP_S)
        vel_m_s = vel_m_s + 0.2 * forward_m_s2 * np.array([math.cos(heading_rad), math.sin(heading_rad)])
        bank.fuse(vel_m_s + 0.05 * rng.standard_normal(2), 0.2)
    assert math.isfinite(bank.std_rad)
    assert abs(math.remainder(bank.turn_rad(tilt.q_level_frd) - heading_rad, math.tau)) < math.radians(10.0)
