"""References along legs: minimum time, limits at every step, rest exactly at the target."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from autopilot.control.params import TrajectoryParams
from autopilot.navigation.guide import Guide

DT_S = 0.004
P = TrajectoryParams(
    xy_cruise_m_s=5.0, z_vel_up_m_s=3.0, z_vel_dn_m_s=1.5, acc_xy_m_s2=3.0, acc_up_m_s2=4.0, acc_dn_m_s2=3.0,
    jerk_m_s3=4.0,
)  # fmt: skip


def at(pos, yaw_rad=0.0, limits=P):
    guide = Guide(limits)
    guide.reset(np.array(pos, dtype=float), vel_ned_m_s=np.zeros(3), yaw_rad=yaw_rad)
    return guide


def move(guide, target, limit_s=60.0):
    """Return setpoints until the reference is at rest at the target."""
    target = np.array(target, dtype=float)
    guide.go_to(target)
    setpoints = []
    while len(setpoints) * DT_S < limit_s:
        setpoints.append(guide.update(DT_S))
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
    guide = at(np.zeros(3), limits=TrajectoryParams(acc_lead_s=0.0))
    guide.go_to(np.array((20.0, 10.0, -8.0)))
    last_acc = np.zeros(3)
    for _ in range(3000):
        s = guide.update(DT_S)
        assert math.hypot(*s.vel_ned_m_s[:2]) <= 5.0 + 1e-6
        assert -3.0 - 1e-6 <= s.vel_ned_m_s[2] <= 1.5
        assert math.hypot(*s.acc_ned_m_s2[:2]) <= 3.0 + 1e-6
        assert -4.0 - 1e-6 <= s.acc_ned_m_s2[2] <= 3.0 + 1e-6
        assert np.linalg.norm(s.acc_ned_m_s2 - last_acc) <= 2.0 * 4.0 * DT_S  # twice in the last step
        last_acc = s.acc_ned_m_s2
    np.testing.assert_array_equal(s.pos_ned_m, (20.0, 10.0, -8.0))


def test_target_may_change_under_way():
    guide = at((0.0, 0.0, 0.0))
    guide.go_to(np.array((10.0, 0.0, 0.0)))
    jumps = []
    last = np.zeros(3)
    for k in range(4000):
        if k == 500:
            guide.go_to(np.array((0.0, 6.0, 0.0)))
        s = guide.update(DT_S)
        jumps.append(np.linalg.norm(s.vel_ned_m_s - last))
        last = s.vel_ned_m_s
    np.testing.assert_array_equal(s.pos_ned_m, (0.0, 6.0, 0.0))
    # two axes across the line brake together: never over sqrt(3) times the limit
    assert max(jumps) <= math.sqrt(3.0) * 3.0 * DT_S + 1e-9


def test_yaw_takes_the_shorter_turn_within_its_rate_and_stops():
    guide = at(np.zeros(3), yaw_rad=math.radians(170.0))
    guide.turn_to(math.radians(-170.0))
    turned = 0.0
    for _ in range(1500):
        s = guide.update(DT_S)
        assert -1e-9 <= s.yaw_rate_rad_s <= P.yaw_rate_max_rad_s + 1e-9
        turned += s.yaw_rate_rad_s * DT_S
    assert turned == pytest.approx(math.radians(20.0), abs=1e-3)
    assert s.yaw_rad == pytest.approx(math.radians(-170.0), abs=1e-9)
    assert s.yaw_rate_rad_s == 0.0


def test_a_leg_without_a_heading_keeps_the_last_target():
    guide = at(np.zeros(3))
    guide.turn_to(1.0)
    guide.update(DT_S)
    guide.go_to(np.zeros(3))
    for _ in range(2000):
        s = guide.update(DT_S)
    assert s.yaw_rad == pytest.approx(1.0, abs=1e-9)


def test_a_trajectory_continues_within_its_new_limits():
    """From 5 m/s to a new limit of 3 m/s at jerk 4: reached within 2 sqrt(2 / 4) = 1.41 s, and kept."""
    limits = P
    trajectory, untouched = at((0.0, 0.0, -5.0)), at((0.0, 0.0, -5.0))
    for moving in (trajectory, untouched):
        moving.go_to(np.array((60.0, 0.0, -5.0)))
    for _ in range(1000):
        trajectory.set_limits(replace(limits))
        before = trajectory.update(DT_S)
        np.testing.assert_array_equal(before.pos_ned_m, untouched.update(DT_S).pos_ned_m)
    assert before.vel_ned_m_s[0] == pytest.approx(limits.xy_cruise_m_s)
    slower = replace(limits, xy_cruise_m_s=3.0)
    trajectory.set_limits(slower)
    last = before.vel_ned_m_s[0]
    for k in range(750):
        speed = trajectory.update(DT_S).vel_ned_m_s[0]
        assert abs(speed - last) <= limits.acc_xy_m_s2 * DT_S * (1.0 + 1e-9)
        last = speed
        assert k * DT_S < 2.0 * math.sqrt(2.0 / limits.jerk_m_s3) + 0.05 or speed <= 3.0 + 1e-6
