"""A wrong compass: from the start, in flight, temporarily, near a magnet; and a correct one."""

import math
from dataclasses import replace

import numpy as np
import pytest
from estimation_fixtures import (
    FIELD_NED_GAUSS,
    STEP_S,
    EstimatorParams,
    Noise,
    circle,
    errors,
    figure_eight,
    replay,
    rest,
    rms,
    simulate,
    step,
    straight,
)
from pymavlink.dialects.v20 import common
from scipy.spatial.transform import Rotation
from vehicle_world import Flight, vehicle_config

from autopilot.estimation.estimator import Estimator
from autopilot.estimation.health import COMPASS_RECOVERY_US, field_disturbed
from autopilot.mavlink.modes import FlightMode
from studies.vehicle.estimation import wrong_compass

GOOD_GPS = Noise(gps_bias_m=0.0, gps_pos_m=0.1)


def turned(flight, degrees, *, from_s=0.0, to_s=math.inf):
    """The flight with its compass turned about the body's z axis for some time."""
    time_s = flight.time_us * 1e-6
    wrong = (time_s >= from_s) & (time_s < to_s)
    field = flight.field_gauss.copy()
    field[wrong] = Rotation.from_euler("z", degrees, degrees=True).apply(field[wrong])
    return replace(flight, field_gauss=field)


def heading_error_deg(flight, states):
    return np.degrees(errors(flight, states).attitude_ned_rad[:, 2])


@pytest.mark.parametrize("path", [circle, figure_eight, straight])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_reversed_compass_is_detected_within_three_seconds_of_motion(path, seed):
    """The paths reach 1 m/s^2 after one second; then one second of rejections is needed, PX4's delay."""
    result = wrong_compass(seed, math.pi, path=path)
    assert result.caught_s is not None
    assert result.caught_s < 3.0
    assert result.resets == 1
    assert math.degrees(result.heading_error_rad) < 5.0


@pytest.mark.parametrize("degrees", [90.0, -120.0])
def test_a_compass_with_swapped_axes_is_detected(degrees):
    result = wrong_compass(4, math.radians(degrees))
    assert result.caught_s is not None
    assert result.caught_s < 4.0
    assert math.degrees(result.heading_error_rad) < 5.0


@pytest.mark.parametrize("path", [circle, figure_eight, straight])
def test_a_correct_compass_is_never_rejected(path):
    for seed in range(4):
        estimator = Estimator(EstimatorParams())
        states = replay(estimator, simulate(path, 40.0, np.random.default_rng(seed)))
        assert states[-1].reset_counter == 1  # the origin
        assert not estimator.fusion.compass.faulty
        assert abs(math.degrees(estimator.fusion.bank_turn_rad)) < 25.0


def test_the_reset_reports_its_deltas():
    flight = turned(simulate(figure_eight, 12.0, np.random.default_rng(5), GOOD_GPS), 180.0)
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, flight)
    (k,) = (k for k in range(1, len(states)) if states[k].yaw_reset_counter > states[k - 1].yaw_reset_counter)
    before, after = states[k - 1], states[k]
    assert [after.reset_counter, after.pos_reset_counter, after.vel_reset_counter] == [2, 2, 1]
    assert abs(abs(math.degrees(after.yaw_reset_delta_rad)) - 180.0) < 15.0
    # the two states are one step apart, at most 0.06 m/s and 0.03 m
    np.testing.assert_allclose(
        after.vel_reset_delta_ned_m_s, after.vel_ned_m_s - before.vel_ned_m_s, atol=0.06
    )
    np.testing.assert_allclose(after.pos_reset_delta_ned_m, after.pos_ned_m - before.pos_ned_m, atol=0.06)
    # and it reduced the error
    off = errors(flight, states)
    assert np.linalg.norm(off.vel_m_s[k - 1, :2]) > 3.0
    assert np.linalg.norm(off.vel_m_s[k, :2]) < 0.6
    # without it the state would have been reset to the fixes after seven seconds
    assert not any(state.navigation_failed for state in states)


def test_a_compass_that_becomes_correct_is_used_again_after_ten_seconds():
    # correct from the ninth second: found faulty before, consistent since the heading is known
    flight = turned(simulate(figure_eight, 30.0, np.random.default_rng(6), GOOD_GPS), 180.0, to_s=9.0)
    faulty = []
    estimator = Estimator(EstimatorParams())
    states = replay(
        estimator, flight, on_step=lambda _, e: faulty.append(bool((f := e.fusion) and f.compass.faulty))
    )
    found, again = faulty.index(True), len(faulty) - faulty[::-1].index(True)
    assert found < step(8.0)
    lag_s = 0.12 + 0.02  # of the horizon, and between samples
    assert (again + 1) * STEP_S >= 9.0 + COMPASS_RECOVERY_US * 1e-6
    assert (again + 1) * STEP_S < 10.5 + COMPASS_RECOVERY_US * 1e-6 + lag_s
    assert np.abs(heading_error_deg(flight, states)[again:]).max() < 2.0
    assert estimator.fusion.heading.test_ratio < 1.0


def test_a_compass_that_fails_in_flight_does_not_override_gps():
    """After seven seconds of rejections the state would be reset to it, without the second estimate."""
    flight = turned(simulate(figure_eight, 60.0, np.random.default_rng(7), GOOD_GPS), 90.0, from_s=20.0)
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, flight)
    assert states[-1].reset_counter == 1
    assert estimator.fusion.compass.faulty
    assert np.abs(heading_error_deg(flight, states)[step(15.0) :]).max() < 5.0


def test_landing_clears_a_faulty_compass():
    flight = turned(simulate(figure_eight, 12.0, np.random.default_rng(8), GOOD_GPS), 180.0)
    estimator = Estimator(EstimatorParams())
    replay(estimator, flight)
    assert estimator.fusion.compass.faulty
    estimator.on_landed()
    assert not estimator.fusion.compass.faulty


def test_a_temporary_magnet_is_detected_by_its_strength_and_not_fused():
    flight = simulate(figure_eight, 30.0, np.random.default_rng(9), GOOD_GPS)
    magnet = slice(step(15.0), step(17.0))
    flight.field_gauss[magnet] += [1.0, 1.0, 0.0]
    disturbed = []
    estimator = Estimator(EstimatorParams())
    states = replay(
        estimator,
        flight,
        on_step=lambda _, e: disturbed.append(bool((f := e.fusion) and f.compass.disturbed)),
    )
    assert sum(disturbed) * STEP_S == pytest.approx(2.0, abs=0.05)
    assert states[-1].reset_counter == 1
    assert np.abs(heading_error_deg(flight, states)[step(15.0) :]).max() < 2.0


def test_alignment_waits_while_the_field_differs_from_the_sites():
    flight = simulate(rest, 6.0, np.random.default_rng(10))
    flight.field_gauss[: step(2.6)] *= 2.0
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, flight)
    aligned = next(k for k, state in enumerate(states) if state.attitude_valid)
    # windows of one second: the third contains both fields, 1.4 times the site's on average, and is rejected
    # too
    assert (aligned + 1) * STEP_S == pytest.approx(4.0, abs=0.05)
    # without the check it aligns immediately
    unchecked = Estimator(EstimatorParams(mag_check=0))
    assert replay(unchecked, flight)[step(1.1)].attitude_valid


def test_field_checks_compare_strength_and_inclination():
    level = np.array([1.0, 0.0, 0.0, 0.0])
    dip_rad = math.atan2(FIELD_NED_GAUSS[2], math.hypot(*FIELD_NED_GAUSS[:2]))
    strength_gauss = float(np.linalg.norm(FIELD_NED_GAUSS))

    def disturbed(check, *, strength=0.0, dip_deg=0.0):
        down_rad, gauss = dip_rad + math.radians(dip_deg), strength_gauss + strength
        field = gauss * np.array([0.0, math.cos(down_rad), math.sin(down_rad)])
        return field_disturbed(EstimatorParams(mag_check=check), level, field)

    assert [disturbed(1, strength=s) for s in (-0.21, -0.19, 0.19, 0.21)] == [True, False, False, True]
    assert [disturbed(2, dip_deg=d) for d in (-21.0, -19.0, 19.0, 21.0)] == [True, False, False, True]
    assert not disturbed(2, strength=0.5)
    assert not disturbed(1, dip_deg=-40.0)
    assert disturbed(3, strength=0.5)
    assert disturbed(3, dip_deg=-40.0)
    assert field_disturbed(EstimatorParams(), level, np.zeros(3))


@pytest.mark.parametrize("degrees", [180.0, 90.0])
def test_a_vehicle_with_a_reversed_compass_takes_off_and_holds(degrees):
    """Closed loop: the controller pushes the wrong way until the heading is corrected, and then holds.

    The deviation grows exponentially until the reset: 2.7 s after leaving the ground, 6 m in all, measured.
    """
    with Flight(vehicle_config()) as flight:
        estimator, right = flight.vehicle.estimator, flight.vehicle.estimator.on_mag
        turn = Rotation.from_euler("z", degrees, degrees=True)
        estimator.on_mag = lambda time_us, field: right(time_us, turn.apply(field))
        commander = flight.vehicle.commander
        assert flight.run(20.0, until=lambda: flight.vehicle.flight.state.position_valid)
        assert flight.run(20.0, until=lambda: commander.arm(flight.now_us) is None)
        altitude_m = flight.vehicle.flight.state.origin_alt_m + 5.0
        flight.command(common.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan, altitude_m)
        farthest_m = 0.0

        def watch():
            nonlocal farthest_m
            farthest_m = max(farthest_m, float(np.linalg.norm(flight.world.truth.pos_ned_m[0, :2])))
            return False

        flight.run(30.0, until=watch)
        state, truth = estimator.state, flight.world.truth
        assert state.yaw_reset_counter == 1
        assert farthest_m < 15.0
        assert np.linalg.norm(truth.vel_ned_m_s[0]) < 0.5
        assert flight.height_m == pytest.approx(5.0, abs=0.7)
        assert commander.mode is FlightMode.HOLD
        seen = Rotation.from_quat(state.q_ned_frd, scalar_first=True)
        real = Rotation.from_quat(truth.q_ned_frd[0], scalar_first=True)
        assert math.degrees(rms((seen * real.inv()).as_rotvec())) < 12.0
