"""Reported health of the estimator when sensors fail, as timelines; restart, parameters in flight."""

from dataclasses import replace

import numpy as np
import pytest
from estimation_fixtures import (
    STEP_S,
    EstimatorParams,
    Noise,
    errors,
    figure_eight,
    replay,
    rest,
    rms,
    simulate,
    step,
)
from msgspec.structs import replace as with_params

from autopilot.estimation.estimator import Estimator
from autopilot.estimation.health import NavigationTest, StuckBarometer, VerticalConflict
from foundation.types import EstimatorState, ImuSample

GOOD_GPS = Noise(gps_bias_m=0.0, gps_pos_m=0.1)
METRES_PER_DEGREE = 111_190.0
FIX_US = 200_000


def first(states, condition, *, from_s=0.0):
    """Return the time of the first state from ``from_s`` for which a condition holds, or None."""
    times = (k for k in range(max(0, step(from_s)), len(states)) if condition(states[k]))
    found = next(times, None)
    return None if found is None else (found + 1) * STEP_S


def without_fixes(flight, from_s, to_s):
    kept = {k: fix for k, fix in flight.fixes.items() if not from_s < fix.time_us * 1e-6 < to_s}
    return replace(flight, fixes=kept)


# -- health checks


def fixes(test, outcomes, *, from_us=0, period_us=FIX_US):
    """Feed the test with (velocity taken, position taken); return the result after each."""
    said = []
    for k, (velocity, position) in enumerate(outcomes):
        test.note(velocity_taken=velocity, position_taken=position, measured_us=from_us + k * period_us)
        said.append(test.failed)
    return said


def test_navigation_fails_after_one_second_of_rejections_and_recovers_after_two_of_acceptance():
    test = NavigationTest()
    assert fixes(test, [(True, True)] * 3 + [(False, False)] * 6) == [False] * 8 + [True]
    # 0.2 s apart: the sixth refusal is one second after the first
    assert fixes(test, [(True, True)] * 11, from_us=9 * FIX_US) == [True] * 10 + [False]


@pytest.mark.parametrize("other", [(True, False), (False, True), (True, True)])
def test_one_accepted_measurement_in_between_restarts_the_second(other):
    test = NavigationTest()
    series = [(False, False)] * 5 + [other] + [(False, False)] * 6
    assert fixes(test, series) == [False] * 11 + [True]


def test_rejections_far_apart_have_no_effect():
    assert fixes(NavigationTest(), [(False, False)] * 4, period_us=1_100_000) == [False] * 4


def test_mixed_outcomes_neither_fail_nor_recover():
    test = NavigationTest()
    fixes(test, [(False, False)] * 6)
    assert fixes(test, [(True, False), (True, True)] * 20, from_us=6 * FIX_US) == [True] * 40


def test_a_repeated_reading_is_a_stuck_barometer_only_while_the_vehicle_climbs():
    barometer, us = StuckBarometer(), 20_000
    assert not any(barometer.note(488.0, 0.0, k * us) for k in range(500))
    # 3 m/s: more than one metre with the 17th sample of 6 cm
    climb = [barometer.note(488.0, -3.0, (500 + k) * us) for k in range(40)]
    assert climb.index(True) == 16
    # another reading clears it; then half a second must pass, however fast the climb
    again = [barometer.note(488.1, -10.0, (540 + k) * us) for k in range(40)]
    assert again.index(True) == 25


def test_a_swaying_hover_does_not_make_a_constant_barometer_stuck():
    barometer, us = StuckBarometer(), 20_000
    assert not any(barometer.note(488.0, 0.4 * np.sin(0.05 * k), k * us) for k in range(3000))


def test_the_accelerometer_is_bad_when_both_others_contradict_it_the_same_way_for_long_enough():
    conflict = VerticalConflict()
    series = [(4.0, 4.0), (4.0, -4.0), (4.0, 2.0), (4.0, 4.0), (5.0, 4.0), (6.0, 5.0)]
    said = [conflict.note(v, h, k * FIX_US) for k, (v, h) in enumerate(series)]
    assert said == [False] * 5 + [True]
    assert conflict.bad
    # it is used again ten seconds after the last contradiction
    calm = [(conflict.note(0.0, 0.0, (5 + k) * FIX_US), conflict.bad)[1] for k in range(1, 52)]
    assert calm == [True] * 49 + [False] * 2


# -- timelines


def test_a_spoofed_position_is_rejected_for_seven_seconds_and_navigation_stays_valid():
    flight = simulate(rest, 26.0, np.random.default_rng(1), GOOD_GPS)
    spoofed = {
        k: replace(fix, lat_deg=fix.lat_deg + 50.0 / METRES_PER_DEGREE) if fix.time_us > 15_100_000 else fix
        for k, fix in flight.fixes.items()
    }
    states = replay(Estimator(EstimatorParams()), replace(flight, fixes=spoofed))
    # rejected from the fix of 15.2 s; the last accepted one, of 15.0 s, is then 7.2 s old
    assert first(states, lambda s: s.pos_reset_counter == 2) == pytest.approx(22.2, abs=0.01)
    assert not any(s.navigation_failed for s in states)
    assert all(s.position_valid and s.velocity_valid for s in states[step(3.0) :])
    assert [states[-1].vel_reset_counter, states[-1].yaw_reset_counter] == [0, 0]
    # the old estimate has its own error: 0.1 m of noise fused with an assumed 1.5 m
    assert states[-1].pos_reset_delta_ned_m[0] == pytest.approx(50.0, abs=0.5)
    assert np.abs(states[-1].pos_reset_delta_ned_m[1:]).max() < 0.5


@pytest.mark.parametrize("path", [rest, figure_eight])
@pytest.mark.parametrize(("seconds", "invalid"), [(3.0, False), (10.0, True), (60.0, True)])
def test_gps_loss_is_bridged_then_reported_and_ends_without_a_reset(path, seconds, invalid):
    """Valid for 5 s after the last fix's time, 14.88 s, at a horizon that is 0.12 s late: until 20.0 s."""
    flight = simulate(path, 20.0 + seconds, np.random.default_rng(2), GOOD_GPS)
    states = replay(Estimator(EstimatorParams()), without_fixes(flight, 15.1, 15.1 + seconds))
    lost = first(states, lambda s: not s.position_valid, from_s=3.0)
    assert lost == (pytest.approx(20.0, abs=0.02) if invalid else None)
    # position and velocity become invalid and valid together, with the first fix
    assert all(s.velocity_valid == s.position_valid for s in states[step(3.0) :])
    assert all(s.attitude_valid and s.height_valid for s in states[step(3.0) :])
    back_s = 15.2 + seconds
    assert all(s.position_valid for s in states[step(back_s + 0.01) :])
    assert not any(s.navigation_failed for s in states)
    # the covariance has grown with the error, so the fix is consistent and nothing jumps
    assert states[-1].reset_counter == 1
    assert rms(errors(flight, states).pos_m[-250:]) < 0.6


def test_a_position_lost_by_more_than_its_uncertainty_is_reset_at_the_first_fix():
    flight = without_fixes(simulate(rest, 40.0, np.random.default_rng(3), GOOD_GPS), 15.1, 30.1)
    moved = {
        k: replace(fix, lat_deg=fix.lat_deg + 200.0 / METRES_PER_DEGREE) if fix.time_us > 30_000_000 else fix
        for k, fix in flight.fixes.items()
    }
    states = replay(Estimator(EstimatorParams()), replace(flight, fixes=moved))
    assert first(states, lambda s: s.pos_reset_counter == 2) == pytest.approx(30.2, abs=0.01)
    assert states[-1].pos_reset_delta_ned_m[0] == pytest.approx(200.0, abs=5.0)
    assert states[step(30.3)].position_valid


@pytest.mark.parametrize("path", [rest, figure_eight])
@pytest.mark.parametrize(("jump_m_s2", "within_s", "height_m"), [(1.0, 4.0, 3.0), (3.0, 2.5, 4.5)])
def test_a_vertical_accelerometer_jump_is_detected_by_gps_and_barometer(path, jump_m_s2, within_s, height_m):
    """Both contradict it: height and velocity are reset within seconds and stay within metres.

    Without that, the climb would last until 5 s of rejections: 0.5 x (1 - 0.4 of bias) x 8^2 = 19 m.
    """
    flight = simulate(path, 40.0, np.random.default_rng(3), GOOD_GPS)
    flight.accel_m_s2[step(15.0) :, 2] += jump_m_s2
    bad = []
    states = replay(
        Estimator(EstimatorParams()),
        flight,
        on_step=lambda _, e: bad.append(bool((f := e.fusion) and f.vertical.bad)),
    )
    assert not any(bad[: step(15.0)])
    reset_s = first(states, lambda s: s.height_reset_counter > 0)
    assert 15.0 < reset_s < 15.0 + within_s
    assert bad.index(True) == round(reset_s / STEP_S) - 1
    # ten seconds later it is used again, and detected again
    assert sum(bad[step(15.0) :]) * STEP_S > 15.0
    missed = errors(flight, states)
    assert np.abs(missed.pos_m[:, 2]).max() < height_m
    assert rms(missed.pos_m[step(15.0) :, 2:]) < 1.5
    assert all(s.height_valid and s.attitude_valid for s in states[step(3.0) :])
    assert not any(s.navigation_failed for s in states)


def test_a_horizontal_accelerometer_jump_of_1_m_s2_is_absorbed_by_bias_and_tilt():
    """At most 0.4 m/s^2 are estimated as bias, the rest as tilt: in hover they are not separately observable.

    So the tilt is between 0.6 / g and 1 / g, 3.5 and 5.8 degrees, plus the remaining biases over g.
    """
    flight = simulate(rest, 40.0, np.random.default_rng(4), GOOD_GPS)
    flight.accel_m_s2[step(15.0) :, 0] += 1.0
    states = replay(Estimator(EstimatorParams()), flight)
    assert not any(s.navigation_failed for s in states)
    assert all(s.position_valid for s in states[step(3.0) :])
    tilt_rad = rms(errors(flight, states).attitude_ned_rad[-500:, :2])
    assert 3.3 < np.degrees(tilt_rad) < 6.0
    untaken_m_s2 = flight.accel_bias_m_s2[-1] + [1.0, 0.0, 0.0] - states[-1].accel_bias_m_s2
    assert tilt_rad == pytest.approx(np.hypot(*untaken_m_s2[:2]) / 9.80665, rel=0.15)


def test_a_horizontal_accelerometer_jump_of_3_m_s2_fails_navigation():
    flight = simulate(rest, 30.0, np.random.default_rng(4), GOOD_GPS)
    flight.accel_m_s2[step(15.0) :, 0] += 3.0
    states = replay(Estimator(EstimatorParams()), flight)
    failed_s = first(states, lambda s: s.navigation_failed)
    # five sigma of velocity are exceeded in one second, of position (7.7 m) in 2.9 s; then one second of
    # rejections
    assert failed_s == pytest.approx(19.2, abs=0.5)
    after = states[step(failed_s) : step(30.0)]
    assert not any(s.position_valid or s.velocity_valid for s in after)
    assert all(s.attitude_valid and s.height_valid for s in after)
    # resets to GPS do not remove the cause, so it stays failed
    assert states[-1].vel_reset_counter > 0
    assert all(s.navigation_failed for s in after)


def test_navigation_recovers_once_the_accelerometer_does():
    flight = simulate(rest, 40.0, np.random.default_rng(5), GOOD_GPS)
    flight.accel_m_s2[step(15.0) : step(20.0), 0] += 3.0
    states = replay(Estimator(EstimatorParams()), flight)
    failed_s = first(states, lambda s: s.navigation_failed)
    assert 18.5 < failed_s < 20.0
    again_s = first(states, lambda s: not s.navigation_failed, from_s=failed_s + 0.1)
    # the state is reset to both 7 s after they were last accepted, then both are accepted for two seconds
    assert again_s < 15.0 + 3.0 + 7.5 + 2.5
    assert all(s.position_valid and s.velocity_valid for s in states[step(again_s) :])
    assert rms(errors(flight, states).pos_m[-500:]) < 0.6


def test_a_gyro_jump_within_the_bias_limit_is_estimated():
    """EKF2_GYR_B_NOISE lets the bias walk by 1e-4 rad/s in a second: 0.01 rad/s take most of a minute."""
    flight = simulate(figure_eight, 75.0, np.random.default_rng(6), GOOD_GPS)
    flight.gyro_rad_s[step(15.0) :] += [0.01, -0.01, 0.01]
    states = replay(Estimator(EstimatorParams()), flight)
    assert states[-1].reset_counter == 1
    assert all(s.position_valid and s.attitude_valid for s in states[step(3.0) :])
    assert np.degrees(rms(errors(flight, states).attitude_ned_rad[-2500:])) < 2.0
    np.testing.assert_allclose(states[-1].gyro_bias_rad_s, [0.018, -0.016, 0.014], atol=4e-3)


def test_a_gyro_jump_beyond_it_fails_navigation():
    flight = simulate(figure_eight, 30.0, np.random.default_rng(7), GOOD_GPS)
    flight.gyro_rad_s[step(15.0) :, 0] += 0.5
    states = replay(Estimator(EstimatorParams()), flight)
    failed_s = first(states, lambda s: s.navigation_failed)
    # 29 degrees more in every second, 5 m/s^2 of error after one; the position's gate, 5 x 1.5 m, is exceeded
    # last, and then for one second
    assert 16.5 < failed_s < 20.5
    assert not states[step(failed_s)].position_valid


def test_a_frozen_barometer_is_detected_by_the_climb_and_height_becomes_invalid():
    flight = simulate(figure_eight, 40.0, np.random.default_rng(8), GOOD_GPS)
    flight.pressure_pa[step(12.0) : step(25.0)] = flight.pressure_pa[step(12.0)]
    stuck = []
    states = replay(
        Estimator(EstimatorParams()),
        flight,
        on_step=lambda _, e: stuck.append(bool((f := e.fusion) and f.barometer.stuck)),
    )
    found_s = (stuck.index(True) + 1) * STEP_S
    assert 12.5 < found_s < 14.0
    assert not any(stuck[step(25.2) :])
    # five seconds after the last accepted reading, at a horizon that is 0.12 s late
    invalid_s = first(states, lambda s: not s.height_valid, from_s=3.0)
    assert invalid_s == pytest.approx(found_s + 5.0, abs=0.05)
    assert states[step(25.3)].height_valid
    missed_m = errors(flight, states).pos_m[:, 2]
    assert np.abs(missed_m).max() < 1.6
    assert rms(missed_m[step(28.0) :, None]) < 0.15
    assert all(s.position_valid for s in states[step(3.0) :])


# -- the filter itself


@pytest.mark.parametrize(("broken", "value"), [("cov", np.nan), ("cov", -1e-3), ("x", np.inf)])
def test_invalid_numbers_stop_the_filter_until_a_restart(broken, value):
    flight = simulate(rest, 20.0, np.random.default_rng(9), GOOD_GPS)
    origin = []

    def sabotage(k, estimator):
        if k == step(8.0):
            origin.append(estimator.live.origin_lat_deg)
            array = estimator.filter.cov if broken == "cov" else estimator.filter.x
            array[(4, 4) if broken == "cov" else 8] = value
        if k == step(10.0):
            assert estimator.numerical_failure
            estimator.restart()
            assert estimator.filter is None

    estimator = Estimator(EstimatorParams())
    states = replay(estimator, flight, on_step=sabotage)
    failed_s = first(states, lambda s: not s.attitude_valid, from_s=3.0)
    assert failed_s == pytest.approx(8.01, abs=0.03)
    down = states[step(failed_s) : step(10.0)]
    assert not any(s.position_valid or s.velocity_valid or s.height_valid for s in down)
    for state in states:
        for name in EstimatorState.__dataclass_fields__:
            assert np.all(np.isfinite(getattr(state, name)))
    # body rates are still updated
    assert len({float(s.omega_frd_rad_s[0]) for s in down}) > 100
    # one second to align, then the first fix: the frame is the same as before
    assert first(states, lambda s: s.attitude_valid, from_s=10.0) == pytest.approx(11.0, abs=0.02)
    assert first(states, lambda s: s.position_valid, from_s=10.0) < 11.5
    end = states[-1]
    assert end.origin_lat_deg == origin[0]
    assert rms(end.pos_ned_m - states[step(7.9)].pos_ned_m) < 0.5
    assert end.height_valid
    assert end.reset_counter > states[step(9.0)].reset_counter
    assert not estimator.numerical_failure


def test_an_uncertain_tilt_invalidates_the_attitude():
    flight = simulate(figure_eight, 12.0, np.random.default_rng(10), GOOD_GPS)

    def forget(k, estimator):
        if k == step(8.0):
            # about both axes, because the compass would observe one of them
            estimator.filter.cov[[0, 1], [0, 1]] = np.radians(60.0) ** 2

    states = replay(Estimator(EstimatorParams()), flight, on_step=forget)
    assert not states[step(8.05)].attitude_valid
    # in motion the fixes make it observable again
    assert states[-1].attitude_valid


def test_the_same_parameters_again_change_nothing_to_the_bit():
    flight = simulate(figure_eight, 10.0, np.random.default_rng(11))

    def again(k, estimator):
        if k % 100 == 0:
            estimator.set_params(with_params(estimator.params))

    plain = replay(Estimator(EstimatorParams()), flight)[-1]
    other = replay(Estimator(EstimatorParams()), flight, on_step=again)[-1]
    for name in EstimatorState.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(plain, name), getattr(other, name))


def test_parameters_act_immediately():
    flight = simulate(rest, 14.0, np.random.default_rng(12), GOOD_GPS)
    estimator = Estimator(EstimatorParams())
    wild = EstimatorParams(gps_pos_gate=100.0, baro_noise_m=5.0, accel_noise_m_s2=1.0)
    stds = {}

    def change(k, estimator):
        if k == step(10.0):
            estimator.set_params(wild)
        stds[k] = estimator.live.pos_std_m[2]

    replay(estimator, flight, on_step=change)
    # in sigmas the noise is the same; in gates it is a twentieth
    assert estimator.fusion.position.test_ratio < 0.03
    # the barometer has a hundredth of the weight, and the prediction forty times the noise
    assert stds[step(13.9)] > 3.0 * stds[step(9.9)]
    # the limit also applies to the present bias
    tight = EstimatorParams(accel_bias_limit_m_s2=0.01)
    estimator.set_params(tight)
    last = flight.time_us[-1]
    estimator.on_baro(int(last) + 4_000 - 120_000, 955.9, 15.0)
    for k in range(1, 60):
        estimator.on_baro(int(last) + 4_000 * k, 955.9 + 1e-4 * k, 15.0)
        estimator.on_imu(
            ImuSample(
                time_us=int(last) + 4_000 * k,
                accel_frd_m_s2=flight.accel_m_s2[-1],
                gyro_frd_rad_s=flight.gyro_rad_s[-1],
            )
        )
    assert np.abs(estimator.live.accel_bias_m_s2).max() <= 0.01


def test_the_delay_takes_effect_at_the_next_start():
    estimator = Estimator(EstimatorParams())
    slower = EstimatorParams(gps_delay_us=200_000)
    estimator.set_params(slower)  # before the alignment
    assert estimator.params.gps_delay_us == 200_000
    replay(estimator, simulate(rest, 2.0, np.random.default_rng(13)))
    with pytest.raises(ValueError, match="delay"):
        estimator.set_params(EstimatorParams())
    assert estimator.params == slower
    estimator.restart(EstimatorParams())
    assert estimator.params.gps_delay_us == 120_000
