"""Jerk-limited trajectories: minimum time, limits at every step, rest exactly at the target."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.params import TrajectoryParams
from autopilot.control.trajectory import PositionTrajectory, stopping_distance

DT_S = 0.004
P = TrajectoryParams(
    xy_cruise_m_s=5.0, z_vel_up_m_s=3.0, z_vel_dn_m_s=1.5, acc_xy_m_s2=3.0, acc_up_m_s2=4.0, acc_dn_m_s2=3.0,
    jerk_m_s3=4.0,
)  # fmt: skip


def at(pos, **kwargs):
    trajectory = PositionTrajectory(P)
    trajectory.reset(np.array(pos, dtype=float), yaw_rad=0.0, **kwargs)
    return trajectory


def move(trajectory, target, limit_s=60.0):
    """Return setpoints until the reference is at rest at the target."""
    target = np.array(target, dtype=float)
    setpoints = []
    while len(setpoints) * DT_S < limit_s:
        setpoints.append(trajectory.update(target, DT_S))
        if np.array_equal(setpoints[-1].pos_ned_m, target) and not setpoints[-1].vel_ned_m_s.any():
            return setpoints
    pytest.fail("did not come to rest")


@pytest.mark.parametrize(
    ("target", "time_s"),
    [
        # only the jerk is limited: four phases of (d / 2 J)^(1/3)
        ((1.0, 0.0, 0.0), 4.0 * (1.0 / 8.0) ** (1.0 / 3.0)),
        # acceleration limit reached, speed limit not: t = A/2J + sqrt((A/2J)^2 + d/A), twice
        ((5.0, 0.0, 0.0), 2.0 * (3.0 / 8.0 + math.sqrt((3.0 / 8.0) ** 2 + 5.0 / 3.0))),
        # both reached: d/V + V/A + A/J
        ((0.0, 20.0, 0.0), 20.0 / 5.0 + 5.0 / 3.0 + 3.0 / 4.0),
        # down: accelerates at 3, brakes at 4 m/s^2, to 1.5 m/s; each change of speed takes 2 sqrt(V / J)
        ((0.0, 0.0, 20.0), 20.0 / 1.5 + 2.0 * math.sqrt(1.5 / 4.0)),
    ],
)
def test_minimum_time_without_overshoot(target, time_s):
    setpoints = move(at((0.0, 0.0, 0.0)), target)
    assert len(setpoints) * DT_S == pytest.approx(time_s, abs=2.0 * DT_S)
    direction = np.array(target) / np.linalg.norm(target)
    progress = np.array([s.pos_ned_m @ direction for s in setpoints])
    assert np.all(np.diff(progress) >= -1e-6)
    assert progress.max() <= np.linalg.norm(target) + 1e-6


def test_moves_along_the_line():
    target = np.array((3.0, -4.0, -2.0))
    for s in move(at((0.0, 0.0, 0.0)), target):
        assert np.linalg.norm(np.cross(s.pos_ned_m, target)) / np.linalg.norm(target) < 1e-9


def test_every_component_of_a_slanted_move_respects_its_limits():
    params = TrajectoryParams(acc_lead_s=0.0)
    trajectory = PositionTrajectory(params)
    trajectory.reset(np.zeros(3), yaw_rad=0.0)
    last_acc = np.zeros(3)
    for _ in range(3000):
        s = trajectory.update(np.array((20.0, 10.0, -8.0)), DT_S)
        assert math.hypot(*s.vel_ned_m_s[:2]) <= 5.0 + 1e-6
        assert -3.0 - 1e-6 <= s.vel_ned_m_s[2] <= 1.5
        assert math.hypot(*s.acc_ned_m_s2[:2]) <= 3.0 + 1e-6
        assert -4.0 - 1e-6 <= s.acc_ned_m_s2[2] <= 3.0 + 1e-6
        assert np.linalg.norm(s.acc_ned_m_s2 - last_acc) <= 2.0 * 4.0 * DT_S  # twice in the last step
        last_acc = s.acc_ned_m_s2
    np.testing.assert_array_equal(s.pos_ned_m, (20.0, 10.0, -8.0))


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(*[st.floats(-8.0, 8.0)] * 3),
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(*[st.floats(-2.0, 2.0)] * 3),
)
def test_comes_to_rest_from_any_motion(target, vel, acc):
    trajectory = at((0.0, 0.0, 0.0), vel_ned_m_s=np.array(vel), acc_ned_m_s2=np.array(acc))
    setpoints = move(trajectory, target)
    positions = np.array([s.pos_ned_m for s in setpoints])
    velocities = np.array([s.vel_ned_m_s for s in setpoints])
    # position is the integral of the velocity setpoint
    trapezoid = np.cumsum(0.5 * DT_S * (velocities[1:] + velocities[:-1]), axis=0)
    np.testing.assert_allclose(positions[1:] - positions[0], trapezoid, atol=1e-3)


def test_target_may_change_under_way():
    trajectory = at((0.0, 0.0, 0.0))
    jumps = []
    last = np.zeros(3)
    for k in range(4000):
        target = np.array((10.0, 0.0, 0.0)) if k < 500 else np.array((0.0, 6.0, 0.0))
        s = trajectory.update(target, DT_S)
        jumps.append(np.linalg.norm(s.vel_ned_m_s - last))
        last = s.vel_ned_m_s
    np.testing.assert_array_equal(s.pos_ned_m, (0.0, 6.0, 0.0))
    # two axes across the line brake together: never over sqrt(3) times the limit
    assert max(jumps) <= math.sqrt(3.0) * 3.0 * DT_S + 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_stopping_distance(sign):
    # 3 m/s at jerk 4, limit 3: 0.75 s to full braking, 0.25 s of it, 0.75 s back; symmetric, so v T / 2
    assert stopping_distance(sign * 3.0, 0.0, -3.0, 3.0, 4.0) == pytest.approx(sign * 3.0 * 1.75 / 2.0)
    # 1 m/s never reaches the limit: 2 sqrt(v / J)
    assert stopping_distance(sign * 1.0, 0.0, -3.0, 3.0, 4.0) == pytest.approx(sign * 2.0 * 0.5 / 2.0)
    # at rest with an acceleration of 2 m/s^2: 0.5 s to zero, after 1/6 m and 0.5 m/s; then 2 sqrt(v / J) to
    # rest
    expected = 1.0 / 6.0 + 0.5 * 2.0 * math.sqrt(0.5 / 4.0) / 2.0
    assert stopping_distance(0.0, sign * 2.0, -3.0, 3.0, 4.0) == pytest.approx(sign * expected)


def test_the_reference_waits_for_a_vehicle_that_does_not_follow():
    trajectory = at((0.0, 0.0, 0.0))
    for _ in range(2500):
        s = trajectory.update(np.array((20.0, 0.0, 0.0)), DT_S, vehicle_pos_ned_m=np.zeros(3))
    assert 0.5 * P.xy_error_max_m < s.pos_ned_m[0] <= P.xy_error_max_m
    assert abs(s.vel_ned_m_s[0]) < 0.5


def test_yaw_takes_the_shorter_turn_within_its_rate_and_stops():
    trajectory = PositionTrajectory(P)
    trajectory.reset(np.zeros(3), yaw_rad=math.radians(170.0))
    turned = 0.0
    for _ in range(1500):
        s = trajectory.update(np.zeros(3), DT_S, yaw_rad=math.radians(-170.0))
        assert -1e-9 <= s.yaw_rate_rad_s <= P.yaw_rate_max_rad_s + 1e-9
        turned += s.yaw_rate_rad_s * DT_S
    assert turned == pytest.approx(math.radians(20.0), abs=1e-3)
    assert s.yaw_rad == pytest.approx(math.radians(-170.0), abs=1e-9)
    assert s.yaw_rate_rad_s == 0.0


def test_yaw_none_keeps_the_last_target():
    trajectory = PositionTrajectory(P)
    trajectory.reset(np.zeros(3), yaw_rad=0.0)
    trajectory.update(np.zeros(3), DT_S, yaw_rad=1.0)
    for _ in range(2000):
        s = trajectory.update(np.zeros(3), DT_S)
    assert s.yaw_rad == pytest.approx(1.0, abs=1e-9)
