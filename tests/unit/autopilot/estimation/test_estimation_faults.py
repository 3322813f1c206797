"""The estimator with sensors that are wrong, stop, are delayed or return."""

from dataclasses import replace

import numpy as np
import pytest
from estimation_fixtures import (
    STEP_S,
    Noise,
    errors,
    figure_eight,
    replay,
    rest,
    rms,
    simulate,
    step,
    straight,
)

from autopilot.estimation.estimator import Estimator
from autopilot.estimation.params import EstimatorParams
from foundation.types import EstimatorState, ImuSample

METRES_PER_DEGREE = 111_190.0
QUIET_GPS = Noise(gps_bias_m=0.0, gps_pos_m=0.1)


def with_fixes(flight, change):
    """Change a flight's fixes: ``change(time_s, fix)`` returns another one, or None to drop it."""
    fixes = {k: change(fix.time_us * 1e-6, fix) for k, fix in flight.fixes.items()}
    return replace(flight, fixes={k: fix for k, fix in fixes.items() if fix is not None})


def north(fix, metres):
    return replace(fix, lat_deg=fix.lat_deg + metres / METRES_PER_DEGREE)


def test_validity_comes_in_order():
    estimator = Estimator(EstimatorParams())
    assert estimator.filter is None
    assert not estimator.state.attitude_valid
    states = replay(estimator, simulate(rest, 3.0, np.random.default_rng(0)))
    first = {
        name: next(k for k, state in enumerate(states) if getattr(state, name)) * STEP_S
        for name in ("attitude_valid", "height_valid", "velocity_valid", "position_valid")
    }
    # one second at rest; then five fixes 0.2 s apart, the first of them after the alignment
    assert first["attitude_valid"] == first["height_valid"] == pytest.approx(1.0, abs=STEP_S)
    assert first["velocity_valid"] == first["position_valid"] == pytest.approx(2.0, abs=0.1)
    assert [state.reset_counter for state in states[:: len(states) - 1]] == [0, 1]


def test_one_outlier_fix_is_rejected_and_changes_nothing():
    flight = simulate(figure_eight, 20.0, np.random.default_rng(1), QUIET_GPS)
    wild = with_fixes(flight, lambda t, fix: north(fix, 30.0) if abs(t - 15.0) < 0.1 else fix)
    clean_estimator, estimator = Estimator(EstimatorParams()), Estimator(EstimatorParams())
    clean, states = replay(clean_estimator, flight), replay(estimator, wild)
    assert estimator.fusion.position.refused == 1
    assert clean_estimator.fusion.position.refused == 0
    apart_m = np.array([a.pos_ned_m - b.pos_ned_m for a, b in zip(clean, states, strict=True)])
    assert np.abs(apart_m[: step(15.0)]).max() == 0.0
    # one fix of a hundred is missing; the outlier would have moved it by metres
    assert 0.0 < np.abs(apart_m).max() < 0.1


def test_a_lasting_jump_causes_one_reset_after_seven_seconds():
    flight = simulate(figure_eight, 30.0, np.random.default_rng(2), QUIET_GPS)
    jumped = with_fixes(flight, lambda t, fix: north(fix, 100.0) if t > 15.1 else fix)
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, jumped)
    north_m = errors(flight, states).pos_m[:, 0]
    assert np.abs(north_m[step(15.0) : step(22.0)]).max() < 1.5
    assert states[step(22.0)].reset_counter == 1
    assert states[step(22.6)].reset_counter == 2
    assert north_m[step(22.6) :] == pytest.approx(100.0, abs=1.0)
    # velocity was fused all the time
    assert all(state.position_valid for state in states[step(15.0) :])
    assert rms(errors(flight, states).vel_m_s[step(15.0) :]) < 0.15
    assert states[-1].reset_counter == 2


def test_gps_outage_dead_reckons_then_is_reported_and_recovers():
    flight = simulate(figure_eight, 45.0, np.random.default_rng(3), QUIET_GPS)
    # the last fix before arrives at 15.0 and refers to 14.88
    silent = with_fixes(flight, lambda t, fix: None if 15.1 < t < 35.1 else fix)
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, silent)
    missed = errors(flight, states)
    assert states[step(19.9)].position_valid
    assert states[step(19.9)].velocity_valid
    assert rms(missed.vel_m_s[step(18.0) : step(19.9)]) < 0.5
    assert not states[step(20.2)].position_valid
    assert not states[step(20.2)].velocity_valid
    assert states[step(30.0)].attitude_valid
    assert states[step(30.0)].height_valid
    assert states[step(30.0)].pos_std_m[0] > 2.0 * states[step(14.0)].pos_std_m[0]
    assert np.degrees(rms(missed.attitude_ned_rad[step(20.0) : step(35.0)])) < 2.0
    assert rms(missed.pos_m[step(20.0) : step(35.0), 2:]) < 0.2
    assert states[step(36.0)].position_valid
    assert rms(missed.vel_m_s[step(38.0) :]) < 0.15
    assert rms(missed.pos_m[step(38.0) :]) < 1.0


def test_ten_seconds_without_gps_in_a_hover_drift_by_less_than_five_metres():
    for seed in range(3):
        flight = simulate(rest, 40.0, np.random.default_rng(10 + seed), QUIET_GPS)
        silent = with_fixes(flight, lambda t, fix: None if t > 30.1 else fix)
        missed = errors(flight, replay(Estimator(EstimatorParams()), silent))
        assert np.linalg.norm(missed.pos_m[-1] - missed.pos_m[step(30.0)]) < 5.0


def test_attitude_holds_on_the_ground_without_any_gps():
    flight = with_fixes(simulate(rest, 60.0, np.random.default_rng(4)), lambda _t, _fix: None)
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, flight)
    assert np.degrees(rms(errors(flight, states).attitude_ned_rad[step(2.0) :])) < 1.0
    assert not any(state.position_valid or state.velocity_valid for state in states)
    assert estimator.fusion.held_pos_m is not None
    assert estimator.fusion.unaided(estimator.filter.horizon_us, timeout_us=1_000_000)


def test_a_start_with_reversed_heading_is_corrected_when_the_compass_recovers():
    flight = simulate(figure_eight, 40.0, np.random.default_rng(5), QUIET_GPS)
    flight.field_gauss[: step(4.0), :2] *= -1.0
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, flight)
    missed = errors(flight, states)
    assert abs(np.degrees(missed.attitude_ned_rad[step(3.0), 2])) > 170.0
    assert states[-1].reset_counter > 1
    assert np.degrees(rms(missed.attitude_ned_rad[step(25.0) :])) < 1.5


def test_a_barometer_step_is_rejected_then_reset_to():
    flight = simulate(rest, 20.0, np.random.default_rng(6), QUIET_GPS)
    flight.pressure_pa[step(10.0) :] -= 600.0  # some 52 m up
    states = replay(Estimator(EstimatorParams()), flight)
    assert states[step(14.9)].pos_ned_m[2] == pytest.approx(0.0, abs=0.3)
    assert states[step(14.9)].height_valid
    assert states[step(15.5)].pos_ned_m[2] == pytest.approx(-52.5, abs=1.0)
    assert states[step(15.5)].reset_counter == 2


def test_silent_barometer_invalidates_height():
    estimator = Estimator(EstimatorParams())
    flight = simulate(rest, 12.0, np.random.default_rng(7))
    flight.pressure_pa[step(5.0) :] = np.nan
    states = replay(estimator, flight)
    assert states[step(9.9)].height_valid
    assert not states[step(10.3)].height_valid
    assert states[-1].position_valid


@pytest.mark.parametrize(
    "flaw",
    [
        {"fix_type": 2},
        {"satellites": 5},
        {"eph_m": 9.0},
        {"lat_deg": np.nan},
        {"vel_ned_m_s": np.full(3, np.inf)},
    ],
)
def test_bad_fixes_do_not_set_the_origin(flaw):
    flight = with_fixes(simulate(rest, 4.0, np.random.default_rng(8)), lambda _t, fix: replace(fix, **flaw))
    state = replay(Estimator(EstimatorParams()), flight)[-1]
    assert not state.position_valid
    assert state.reset_counter == 0


def test_origin_is_the_mean_fix_and_its_altitude_that_of_the_ground():
    noise = Noise(gps_bias_m=0.0, gps_pos_m=1.0)
    flight = simulate(rest, 3.0, np.random.default_rng(9), noise)
    state = replay(Estimator(EstimatorParams()), flight)[-1]
    used = [fix for fix in flight.fixes.values() if fix.time_us > 1_120_000][:5]
    assert state.origin_lat_deg == pytest.approx(np.mean([fix.lat_deg for fix in used]), abs=1e-10)
    assert state.origin_lon_deg == pytest.approx(np.mean([fix.lon_deg for fix in used]), abs=1e-10)
    assert state.origin_alt_m == pytest.approx(np.mean([fix.alt_m for fix in used]), abs=0.1)


def test_a_late_fix_is_extrapolated_to_the_horizon_by_its_velocity():
    """At 5 m/s, fixes that arrive another 0.1 s late would shift the position by half a metre."""
    flight = simulate(straight, 30.0, np.random.default_rng(11), Noise(gps_bias_m=0.0, gps_pos_m=0.02))
    last = len(flight.time_us)
    late = replace(flight, fixes={k + 25: fix for k, fix in flight.fixes.items() if k + 25 < last})
    missed = errors(flight, replay(Estimator(EstimatorParams()), late))
    assert missed.pos_m[step(20.0) :, 0].mean() == pytest.approx(0.0, abs=0.15)


def test_broken_samples_change_nothing():
    flight = simulate(rest, 3.0, np.random.default_rng(12))
    estimator = Estimator(EstimatorParams())
    replay(estimator, flight)
    state, now_us = estimator.state, int(flight.time_us[-1])
    fine = np.array([0.0, 0.0, -9.8])
    for time_us, accel, gyro in (
        (now_us, fine, np.zeros(3)),
        (now_us - 4_000, fine, np.zeros(3)),
        (now_us + 4_000, np.array([np.nan, 0.0, -9.8]), np.zeros(3)),
        (now_us + 4_000, fine, np.array([0.0, np.inf, 0.0])),
    ):
        estimator.on_imu(ImuSample(time_us=time_us, accel_frd_m_s2=accel, gyro_frd_rad_s=gyro))
        assert repr((estimator.state, estimator.clock.estimate_us)) == repr((state, now_us))
    estimator.on_mag(now_us, np.full(3, np.nan))
    estimator.on_baro(now_us, 0.0, 15.0)
    estimator.on_baro(now_us, np.inf, 15.0)
    estimator.on_imu(ImuSample(time_us=now_us + 4_000, accel_frd_m_s2=fine, gyro_frd_rad_s=np.zeros(3)))
    assert estimator.clock.estimate_us == now_us + 4_000
    np.testing.assert_allclose(estimator.state.pos_ned_m, state.pos_ned_m, atol=0.01)


def test_a_copied_state_does_not_change():
    flight = simulate(figure_eight, 12.0, np.random.default_rng(13))
    states = replay(Estimator(EstimatorParams()), flight)
    early = states[step(8.0)]
    again = replay(Estimator(EstimatorParams()), flight)[step(8.0)]
    for name in ("q_ned_frd", "vel_ned_m_s", "pos_ned_m", "acc_ned_m_s2", "omega_frd_rad_s", "pos_std_m"):
        np.testing.assert_array_equal(getattr(early, name), getattr(again, name))
    assert not np.array_equal(early.pos_ned_m, states[-1].pos_ned_m)


def test_the_live_state_is_overwritten_and_equals_the_copy():
    flight = simulate(figure_eight, 4.0, np.random.default_rng(14))
    estimator = Estimator(EstimatorParams())
    states = replay(estimator, flight)
    live, kept = estimator.live, states[-1]
    for name in EstimatorState.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(live, name), getattr(kept, name))
    earlier = states[step(3.0)].pos_ned_m.copy()
    next_us = estimator.clock.estimate_us + 4_000
    on = ImuSample(time_us=next_us, accel_frd_m_s2=np.zeros(3), gyro_frd_rad_s=np.zeros(3))
    estimator.on_imu(on)
    assert estimator.live is live
    assert estimator.clock.estimate_us == next_us
    assert live.pos_ned_m.tolist() != kept.pos_ned_m.tolist()
    np.testing.assert_array_equal(states[step(3.0)].pos_ned_m, earlier)
