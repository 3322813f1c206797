"""Wind observer: its estimate, and its effect with the autopilot's cascade. Run time: 5 s once compiled."""

import math
from collections import deque

import numpy as np
import pytest
from control_fixtures import DT_S, Gusts, Iris, fly
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control import ControlParams, FlightController
from autopilot.control.params import DisturbanceParams
from autopilot.onboard.formation.wind_observer import (
    ACC_MAX_M_S2,
    GAP_MAX_S,
    GRAVITY_M_S2,
    RATE_MAX_M_S3,
    SAMPLE_MAX_M_S2,
    TIME_CONSTANT_S,
    WindObserver,
)
from foundation.geometry.rotations import quat_from_euler, quat_rotate
from foundation.types import TrajectorySetpoint

PERIOD_US = 33_000
LEVEL = (1.0, 0.0, 0.0, 0.0)
WITHOUT_OBSERVER = ControlParams(disturbance=DisturbanceParams(enabled=False))
PLACE_NED_M = np.array((0.0, 0.0, -5.0))


def watch(observer, attitude, acc_ned_m_s2, seconds, *, vel_ned_m_s=(0.0, 0.0, 0.0), flying=True, start_us=0):
    """Feed a constant attitude and acceleration for a time; returns time and velocity at the end."""
    vel = np.array(vel_ned_m_s)
    for k in range(round(seconds * 1e6 / PERIOD_US)):
        observer.on_attitude(attitude)
        observer.on_velocity(start_us + k * PERIOD_US, tuple(vel), flying=flying)
        vel = vel + np.array(acc_ned_m_s2) * PERIOD_US * 1e-6
    return start_us + (k + 1) * PERIOD_US, tuple(vel)


@settings(deadline=None, max_examples=60)
@given(
    st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-math.pi, math.pi), st.floats(5.0, 15.0),
    st.floats(-3.0, 3.0), st.floats(-3.0, 3.0),
)  # fmt: skip
def test_a_horizontal_wind_is_the_acceleration_minus_thrust_and_weight(roll, pitch, yaw, thrust, north, east):
    """At any attitude and vertical speed, a = g + T (-z of the body) + w."""
    attitude = quat_from_euler(roll, pitch, yaw)
    acc = quat_rotate(attitude, np.array((0.0, 0.0, -thrust))) + np.array((north, east, GRAVITY_M_S2))
    observer = WindObserver()
    watch(observer, tuple(attitude.tolist()), acc, 12.0 * TIME_CONSTANT_S)
    assert observer.acc_ne_m_s2 == pytest.approx((north, east), abs=1e-3)


def test_the_low_pass_has_its_time_constant():
    """After n samples a fraction exp(-n dt / tau) is missing, to the sample."""
    observer = WindObserver()
    attitude = tuple(quat_from_euler(0.0, -math.atan(2.0 / GRAVITY_M_S2), 0.0).tolist())
    steps = 9
    for k in range(steps + 1):  # tilted to the north without moving: 2 m/s^2 from the north
        observer.on_attitude(attitude)
        observer.on_velocity(k * PERIOD_US, (0.0, 0.0, 0.0), flying=True)
    missing = math.exp(-steps * PERIOD_US * 1e-6 / TIME_CONSTANT_S)
    assert observer.acc_ne_m_s2 == pytest.approx((-2.0 * (1.0 - missing), 0.0), abs=1e-9)


def test_the_feed_forward_opposes_the_wind_and_is_limited():
    observer = WindObserver()
    before = np.zeros(2)
    vel = np.zeros(3)
    for k in range(200):
        observer.on_attitude(LEVEL)
        observer.on_velocity(k * PERIOD_US, tuple(vel), flying=True)
        vel = vel + np.array((6.0, -6.0, 0.0)) * PERIOD_US * 1e-6
        feed = np.array(observer.feed_forward_ne_m_s2)
        assert np.linalg.norm(feed - before) <= RATE_MAX_M_S3 * PERIOD_US * 1e-6 + 1e-9
        before = feed
    # limited to the largest sample, and the feed-forward to its own limit
    assert np.linalg.norm(observer.acc_ne_m_s2) == pytest.approx(SAMPLE_MAX_M_S2, abs=1e-6)
    assert before == pytest.approx(np.array((-1.0, 1.0)) * ACC_MAX_M_S2 / math.sqrt(2.0), abs=1e-6)


def test_the_estimate_is_reset_on_the_ground():
    observer = WindObserver()
    end_us, vel = watch(observer, LEVEL, (2.0, 0.0, 0.0), 2.0)
    assert observer.acc_ne_m_s2[0] > 1.9
    watch(observer, LEVEL, (2.0, 0.0, 0.0), 1.0, vel_ned_m_s=vel, flying=False, start_us=end_us)
    assert np.array_equal(observer.acc_ne_m_s2, (0.0, 0.0))
    assert np.array_equal(observer.feed_forward_ne_m_s2, (0.0, 0.0))


@pytest.mark.parametrize(
    ("attitude", "time_us", "vel_ned_m_s"),
    [
        ((math.nan, 0.0, 0.0, 0.0), 33_000, (0.1, 0.0, 0.0)),  # invalid attitude
        (tuple(quat_from_euler(1.2, 0.0, 0.0).tolist()), 33_000, (0.1, 0.0, 0.0)),  # beyond 60 degrees
        (LEVEL, round(GAP_MAX_S * 1e6) + 1, (0.1, 0.0, 0.0)),  # too long after the last
        (LEVEL, 0, (0.1, 0.0, 0.0)),  # not after the last
        (LEVEL, 33_000, (math.nan, 0.0, 0.0)),
        (LEVEL, 33_000, (0.0, math.inf, 0.0)),
        (LEVEL, 33_000, (0.0, 0.0, math.inf)),
    ],
)
def test_invalid_samples_change_nothing(attitude, time_us, vel_ned_m_s):
    observer = WindObserver()
    observer.on_velocity(0, (0.0, 0.0, 0.0), flying=True)
    observer.on_attitude(attitude)
    observer.on_velocity(time_us, vel_ned_m_s, flying=True)
    assert np.array_equal(observer.acc_ne_m_s2, (0.0, 0.0))


class Leaning:
    """Wind feed-forward with the application's telemetry rates, and setpoints at 20 Hz, 12 ms late.

    ``skew_steps`` of 4 ms: delay of velocities relative to attitudes; negative: attitudes are delayed.
    """

    def __init__(self, *, skew_steps=0, velocity_std_m_s=0.0, seed=0):
        self.setpoint = TrajectorySetpoint(pos_ned_m=PLACE_NED_M, yaw_rad=0.0)
        self._observer = WindObserver()
        self._rng = np.random.default_rng(seed)
        self._std, self._error = velocity_std_m_s, np.zeros(3)
        self._attitudes = deque(maxlen=max(-skew_steps, 0) + 1)
        self._velocities = deque(maxlen=max(skew_steps, 0) + 1)
        self._on_the_way = deque()

    def step(self, k, iris):
        keep = math.exp(-DT_S / 1.0)
        noise = self._rng.standard_normal(3)
        self._error = keep * self._error + math.sqrt(1.0 - keep**2) * self._std * noise
        self._attitudes.append(tuple(iris.q_ned_frd.tolist()))
        self._velocities.append(tuple((iris.vel_ned_m_s + self._error).tolist()))
        if k % 5 == 0:
            self._observer.on_attitude(self._attitudes[0])
        if k % 8 == 0:
            self._observer.on_velocity(k * 4_000, self._velocities[0], flying=True)
        if k % 12 == 0:
            self._on_the_way.append((k + 3, self._observer.feed_forward_ne_m_s2))
        while self._on_the_way and self._on_the_way[0][0] <= k:
            acc_ned_m_s2 = np.array((*self._on_the_way.popleft()[1], 0.0))
            self.setpoint = TrajectorySetpoint(
                pos_ned_m=PLACE_NED_M, vel_ned_m_s=np.zeros(3), acc_ned_m_s2=acc_ned_m_s2, yaw_rad=0.0
            )
        return self.setpoint


HOLDING = TrajectorySetpoint(pos_ned_m=PLACE_NED_M, yaw_rad=0.0)


def hover(force_ned_n, leaning, *, seconds, seed=None):
    """Return (n, 2) horizontal errors of the autopilot's cascade in wind, without its own observer."""
    iris = Iris(height_m=5.0, noise_seed=seed)
    controller = FlightController(WITHOUT_OBSERVER)
    errors = []
    for k in range(round(seconds / DT_S)):
        setpoint = HOLDING if leaning is None else leaning.step(k, iris)
        iris.step(fly(controller, iris, setpoint), force_ned_n(k))
        errors.append(iris.pos_ned_m[:2].copy())
    return np.array(errors)


def rms_m(errors):
    return math.sqrt((errors**2).sum(axis=1).mean())


def test_gusts_move_the_vehicle_half_as_far():
    """5 N with gusts of 1 N and 2 s, velocity errors of 0.06 m/s and 1 s: 0.40 m without, 0.17 m with."""
    without, leaning = [], []
    for seed in (0, 1):
        for found, app in ((without, None), (leaning, Leaning(velocity_std_m_s=0.06, seed=seed + 77))):
            gusts = Gusts(mean_n=5.0, gust_rms_n=1.0, seed=seed)
            errors = hover(lambda _, gusts=gusts: gusts.force_ned_n(), app, seconds=50.0, seed=seed + 1000)
            found.append(rms_m(errors[round(10.0 / DT_S) :]))
    assert np.mean(leaning) < 0.5 * np.mean(without)
    assert np.mean(leaning) < 0.2


@pytest.mark.parametrize("skew_steps", [0, 12, -12])
def test_the_feed_forward_loop_does_not_oscillate(skew_steps):
    """After a wind step of 5 N, with attitude and velocity up to 48 ms apart, a single overshoot decays.

    It is due to the cascade's integrator. Without the observer the vehicle is displaced by 1.48 m; with it by
    a third of that.
    """
    onset = round(5.0 / DT_S)

    def force_ned_n(k):
        return np.array((5.0 if k >= onset else 0.0, 0.0, 0.0))

    pushed_m = hover(force_ned_n, None, seconds=9.0)[onset:, 0].max()
    errors = hover(force_ned_n, Leaning(skew_steps=skew_steps), seconds=20.0)[onset:, 0]
    assert errors.max() < 0.4 * pushed_m
    assert errors.min() > -0.4 * pushed_m
    clear = errors[np.abs(errors) > 0.005]
    assert np.count_nonzero(np.diff(np.sign(clear))) == 1
    lowest = int(errors.argmin())
    assert (np.diff(errors[lowest:]) > -1e-4).all()
    assert abs(errors[-1]) < 0.1
