"""Orbit mode by its reference: bounds, limits of the motion, and its start."""

import math

import numpy as np
import pytest
from control_fixtures import DT_S
from navigation_fixtures import CONTROL, Ideal

from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.orbit import Circle, YawBehaviour

LIMITS = CONTROL.trajectory


def circle(radius_m=5.0, speed_m_s=2.0, *, north_m=0.0, east_m=0.0, yaw=YawBehaviour.TO_CENTRE):
    return Circle(
        north_m=north_m, east_m=east_m, down_m=-5.0, radius_m=radius_m, speed_m_s=speed_m_s, yaw=yaw
    )


def circling(requested, pos_ned_m=(20.0, 0.0, -5.0), **details):
    """Return a vehicle that tracks exactly, at the time of its arrival at the circle."""
    loop = Ideal(pos_ned_m, **details)
    loop.enter(FlightMode.ORBIT)
    loop.navigator.orbit.start(loop.state, requested)
    assert loop.run(60.0, until=lambda: not loop.navigator.orbit.approaching)
    return loop


def setpoints(loop, seconds):
    """Return positions, velocities and accelerations of the setpoints, (n, 3) each."""
    rows = []
    loop.run(
        seconds,
        until=lambda: rows.append(
            (loop.setpoint.pos_ned_m, loop.setpoint.vel_ned_m_s, loop.setpoint.acc_ned_m_s2)
        ),
    )
    return np.array(rows).transpose(1, 0, 2)


@pytest.mark.parametrize(
    ("radius_m", "speed_m_s", "expected"),
    [
        (5.0, 2.0, (5.0, 2.0)),
        (0.2, 0.5, (1.0, 0.5)),
        (1e30, 3.0, (1_000.0, 3.0)),
        (8.0, 9.0, (8.0, 4.0)),  # 2 m/s^2 at 8 m
        (8.0, -9.0, (8.0, -4.0)),
        (500.0, 1e30, (500.0, 10.0)),
    ],
)
def test_a_circle_is_limited_to_px4s_bounds(radius_m, speed_m_s, expected):
    bounded = circle(radius_m, speed_m_s).bounded()
    assert (bounded.radius_m, bounded.speed_m_s) == pytest.approx(expected)


@pytest.mark.parametrize("speed_m_s", [3.0, -3.0])
def test_an_orbit_starts_at_the_nearest_point_and_accelerates_within_the_limits(speed_m_s):
    loop = circling(circle(6.0, speed_m_s, north_m=3.0, east_m=4.0), (3.0, 24.0, -5.0))
    assert np.allclose(loop.state.pos_ned_m, (3.0, 10.0, -5.0), atol=1e-6)
    pos, vel, acc = setpoints(loop, 20.0)
    assert np.allclose(np.hypot(pos[:, 0] - 3.0, pos[:, 1] - 4.0), 6.0)
    # positions, velocities and accelerations are consistent; the acceleration leads
    assert np.allclose(np.diff(pos, axis=0) / DT_S, 0.5 * (vel[1:] + vel[:-1]), atol=0.01)
    speed = np.linalg.norm(vel, axis=1)
    along = np.diff(speed) / DT_S
    assert along.max() <= LIMITS.acc_xy_m_s2 + 1e-6
    assert np.abs(np.diff(along) / DT_S).max() <= LIMITS.jerk_m_s3 * 1.01
    assert speed[-1] == pytest.approx(3.0)
    assert speed.max() <= 3.0 + LIMITS.jerk_m_s3 * DT_S**2
    assert np.linalg.norm(acc[-1]) == pytest.approx(3.0**2 / 6.0, rel=0.02)
    north, east = pos[-1, 0] - 3.0, pos[-1, 1] - 4.0
    clockwise = north * vel[-1, 1] - east * vel[-1, 0]
    assert math.copysign(1.0, clockwise) == math.copysign(1.0, speed_m_s)


def test_from_the_centre_it_flies_straight_ahead():
    loop = circling(circle(4.0), (0.0, 0.0, -5.0), yaw_rad=2.0)
    assert np.allclose(loop.state.pos_ned_m[:2], (4.0 * math.cos(2.0), 4.0 * math.sin(2.0)), atol=1e-6)


@pytest.mark.parametrize("yaw", [YawBehaviour.INITIAL, YawBehaviour.UNCONTROLLED])
def test_the_heading_is_kept(yaw):
    loop = circling(circle(yaw=yaw), yaw_rad=1.2)
    loop.run(10.0)
    assert loop.setpoint.yaw_rad == pytest.approx(1.2, abs=1e-6)
    assert loop.setpoint.yaw_rate_rad_s == 0.0


@pytest.mark.parametrize("speed_m_s", [2.0, -2.0])
def test_the_heading_is_tangential(speed_m_s):
    loop = circling(circle(speed_m_s=speed_m_s, yaw=YawBehaviour.TANGENT))
    loop.run(10.0)
    north_m_s, east_m_s, _ = loop.setpoint.vel_ned_m_s
    off_rad = math.remainder(loop.setpoint.yaw_rad - math.atan2(east_m_s, north_m_s), math.tau)
    assert off_rad == pytest.approx(0.0, abs=0.01)
    assert loop.setpoint.yaw_rate_rad_s == pytest.approx(speed_m_s / 5.0, rel=0.01)


def test_the_yaw_rate_is_limited():
    loop = circling(circle(1.0, 1.4))  # the tangent turns by 1.4 rad/s
    most = LIMITS.yaw_rate_max_rad_s
    yaw = []
    loop.run(10.0, until=lambda: yaw.append(loop.setpoint.yaw_rad))
    assert np.abs(np.diff(np.unwrap(yaw))).max() <= most * DT_S * (1.0 + 1e-9)


def test_a_request_is_discarded_with_the_mode_and_kept_over_a_reset():
    requested = circle(6.0)
    loop = circling(requested)
    loop.enter(FlightMode.ORBIT)  # as after a reset of the estimate
    assert loop.navigator.orbit.circle.radius_m == 6.0
    loop.enter(FlightMode.HOLD)
    loop.enter(FlightMode.ORBIT)
    assert loop.navigator.orbit.circle.radius_m == 1.0  # PX4's, for a mode without a request
