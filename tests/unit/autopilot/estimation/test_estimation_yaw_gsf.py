"""Heading from inertial sensors and GPS velocity: arithmetic, convergence, and variance without motion."""

import numpy as np
import pytest
from estimation_fixtures import STEP_S, circle, figure_eight, level_start, simulate, step
from scipy.spatial.transform import Rotation

from autopilot.estimation import yaw_gsf
from autopilot.estimation.atmosphere import GRAVITY_M_S2
from autopilot.estimation.yaw_gsf import YawBank, carry_level, predict_model, update_model

REST_FORCE = np.array([0.0, 0.0, -GRAVITY_M_S2])
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
GPS_STEPS, DELAY_STEPS = 50, 30


def test_prediction_jacobian_agrees_with_finite_differences():
    rng = np.random.default_rng(0)
    dvel, dt_s, h = (0.8, -0.5), 0.2, 1e-6
    model, root = rng.normal(size=3), rng.normal(size=(3, 3))
    numeric = np.empty((3, 3))
    for column in range(3):
        ends = []
        for sign in (1.0, -1.0):
            moved = model + sign * h * np.eye(3)[column]
            predict_model(moved, np.zeros((3, 3)), *dvel, dt_s)
            ends.append(moved)
        numeric[:, column] = (ends[0] - ends[1]) / (2.0 * h)
    cov = root @ root.T
    noise = dt_s * np.diag(
        [yaw_gsf.VELOCITY_PSD_M2_S3, yaw_gsf.VELOCITY_PSD_M2_S3, yaw_gsf.AZIMUTH_PSD_RAD2_S]
    )
    expected = numeric @ cov @ numeric.T + noise
    predict_model(model, cov, *dvel, dt_s)
    np.testing.assert_allclose(cov, expected, atol=1e-8)


def test_update_is_the_textbook_one():
    rng = np.random.default_rng(1)
    model, root = rng.normal(size=3), rng.normal(size=(3, 3))
    cov = root @ root.T + 0.1 * np.eye(3)
    vel_var, measured = 0.04, model[:2] + np.array([0.1, -0.2])
    seen = np.eye(3)[:2]
    s = seen @ cov @ seen.T + vel_var * np.eye(2)
    gain = cov @ seen.T @ np.linalg.inv(s)
    expected_cov = (np.eye(3) - gain @ seen) @ cov
    expected = model + gain @ (measured - model[:2])
    innovation = measured - model[:2]
    density = np.exp(-0.5 * innovation @ np.linalg.solve(s, innovation)) / (
        2 * np.pi * np.sqrt(np.linalg.det(s))
    )
    assert update_model(model, cov, measured, vel_var) == pytest.approx(density, rel=1e-12)
    np.testing.assert_allclose(model, expected, atol=1e-12)
    np.testing.assert_allclose(cov, expected_cov, atol=1e-12)


def test_an_outlier_fix_moves_a_model_by_at_most_five_sigma_and_keeps_its_likelihood_above_zero():
    model, cov = np.zeros(3), np.diag([0.1, 0.1, 0.1])
    assert update_model(model, cov, np.array([1000.0, 0.0]), 0.04) > 0.0
    # gain 0.1 / 0.14 of an innovation of 5 sqrt(0.14)
    assert model[0] == pytest.approx(0.1 / 0.14 * 5.0 * np.sqrt(0.14))


def test_the_level_frame_turns_with_the_gyro_and_takes_its_tilt_from_gravity():
    """A tilt error of 10 degrees at rest decays as the second-order loop predicts.

    With gain k = 0.2 /s and bias gain b = 0.04 /s, e'' + k e' + b k e = 0 at small angles, e(0) = 1 and
    e'(0) = -k. Its roots -0.0553 and -0.1447 give e(t) = 1.618 exp(-0.1447 t) - 0.618 exp(-0.0553 t), and so
    e(10 s) = 0.0251.
    """
    rate_rad_s = 0.05  # about down, slow enough for the bias to be estimated
    tilted = Rotation.from_euler("ZYX", [0.0, 10.0, 0.0], degrees=True).as_quat(scalar_first=True)
    tilt = level_start(tilted, np.zeros(3))
    tilt.force_frd_m_s2[:] = REST_FORCE
    level = level_start(IDENTITY, np.zeros(3))
    for _ in range(round(10.0 / STEP_S)):
        carry_level(tilt, np.zeros(3), REST_FORCE, STEP_S)
        carry_level(level, np.array([0.0, 0.0, rate_rad_s]), REST_FORCE, STEP_S)
    pitch_deg = Rotation.from_quat(tilt.q_level_frd, scalar_first=True).as_euler("ZYX", degrees=True)[1]
    assert pitch_deg == pytest.approx(0.251, abs=0.01)
    turned_rad = Rotation.from_quat(level.q_level_frd, scalar_first=True).as_rotvec()
    np.testing.assert_allclose(turned_rad, [0.0, 0.0, 10.0 * rate_rad_s], atol=1e-9)


def test_force_far_from_gravity_does_not_correct_the_tilt():
    tilt = level_start(IDENTITY, np.zeros(3))
    for _ in range(round(2.0 / STEP_S)):
        carry_level(tilt, np.zeros(3), np.array([12.0, 0.0, -GRAVITY_M_S2]), STEP_S)
    # 15.5 m/s^2 is 58 % over gravity; until the low pass (0.5 s) settles it has a small effect
    assert 2.0 * np.degrees(np.arccos(tilt.q_level_frd[0])) < 5.0
    # and the velocity change includes all of it: 2 s x 12 m/s^2
    assert tilt.vel_change_m_s[0] == pytest.approx(24.0, rel=0.05)


def test_azimuth_is_the_turn_between_two_attitudes_of_the_same_tilt():
    rng = np.random.default_rng(2)
    for _ in range(20):
        attitude = Rotation.random(random_state=rng)
        turn_rad = rng.uniform(-3.1, 3.1)
        turned = Rotation.from_rotvec([0.0, 0.0, turn_rad]) * attitude
        tilt = level_start(attitude.as_quat(scalar_first=True), np.zeros(3))
        azimuth_rad = yaw_gsf.azimuth_of(turned.as_quat(scalar_first=True), tilt.q_level_frd)
        assert np.remainder(azimuth_rad - turn_rad + 1.0, 2.0 * np.pi) == pytest.approx(1.0, abs=1e-9)


def fly(flight, start_rad):
    """Run a flight with a bank that starts with the right tilt and any heading; yield (time, error, std)."""
    start = Rotation.from_rotvec([0.0, 0.0, start_rad]) * flight.rotations_ned_frd[0]
    tilt = level_start(start.as_quat(scalar_first=True), flight.gyro_bias_rad_s[0])
    bank, seen = YawBank(tilt), []
    for k in range(len(flight.time_us) - DELAY_STEPS):
        carry_level(tilt, flight.gyro_rad_s[k], flight.accel_m_s2[k], STEP_S)
        if k + DELAY_STEPS in flight.fixes:
            bank.fuse(flight.fixes[k + DELAY_STEPS].vel_ned_m_s[:2], 0.2)
            turn_rad = bank.turn_rad(flight.rotations_ned_frd[k].as_quat(scalar_first=True))
            seen.append(((k + 1) * STEP_S, turn_rad, bank.std_rad))
    return np.array(seen)


@pytest.mark.parametrize("path", [circle, figure_eight])
@pytest.mark.parametrize("start_deg", [-150.0, -20.0, 70.0, 179.0])
def test_two_seconds_of_motion_determine_the_heading_from_any_start(path, start_deg):
    """The flights start at 5 s and reach 1 m/s^2 within one second; a reset requires 15 degrees."""
    seen = fly(simulate(path, 20.0, np.random.default_rng(3)), np.radians(start_deg))
    resting, moving = seen[seen[:, 0] < 5.0], seen[seen[:, 0] > 7.2]
    assert np.degrees(resting[1:, 2].min()) > 60.0
    assert np.degrees(moving[:, 2].max()) < 15.0
    assert np.degrees(np.abs(moving[:, 1]).max()) < 15.0


def test_ten_minutes_at_rest_give_no_heading():
    """GPS noise of 0.1 m/s and an accelerometer bias of 0.1 m/s^2 must not reduce the variance."""
    rng = np.random.default_rng(4)
    tilt = level_start(IDENTITY, np.zeros(3))
    bank, narrowest_rad = YawBank(tilt), np.inf
    biased = REST_FORCE + np.array([0.1, 0.0, 0.0])
    for k in range(round(600.0 / STEP_S)):
        carry_level(tilt, 0.0138 * rng.standard_normal(3), biased, STEP_S)
        if k % GPS_STEPS == 0:
            bank.fuse(0.1 * rng.standard_normal(2), 0.2)
            if k:
                narrowest_rad = min(narrowest_rad, bank.std_rad)
    assert np.degrees(narrowest_rad) > 60.0
    assert bank.weights.sum() == pytest.approx(1.0)


def test_a_gap_in_the_fixes_keeps_the_heading_and_resets_the_velocity():
    flight = simulate(figure_eight, 20.0, np.random.default_rng(5))
    gap = range(step(10.0), step(15.0))
    with_gap = {k: fix for k, fix in flight.fixes.items() if k not in gap}
    flight.fixes.clear()
    flight.fixes.update(with_gap)
    seen = fly(flight, np.radians(90.0))
    after = seen[seen[:, 0] > 14.9]
    assert np.degrees(np.abs(after[:, 1]).max()) < 15.0
    assert np.degrees(after[0, 2]) < 15.0
