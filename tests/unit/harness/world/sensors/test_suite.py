"""The suite with synthetic truth: schedules, delay, frames, and the errors of each profile."""

import math

import msgspec
import numpy as np
import pytest
from world_truth import truth_with

from autopilot.estimation import atmosphere
from autopilot.parameters.config import Site
from foundation.geometry.geodesy import geodetic_to_ned
from harness.world.sensors.config import GpsOverrides, SensorsConfig
from harness.world.sensors.suite import SensorSuite

STEP_US = 4_000
SITE = Site()


def truth_of(
    pos_ned_m, *, vel_ned_m_s=(0.0, 0.0, 0.0), q_ned_frd=(1.0, 0.0, 0.0, 0.0), omega=(0.0, 0.0, 0.0)
):
    """Return the truth of vehicles at (n, 3) positions, otherwise equal."""
    pos = np.array(pos_ned_m, dtype=float).reshape(-1, 3)
    n = len(pos)
    return truth_with(
        pos_ned_m=pos,
        vel_ned_m_s=np.tile(np.array(vel_ned_m_s, dtype=float), (n, 1)),
        q_ned_frd=np.tile(np.array(q_ned_frd, dtype=float), (n, 1)),
        omega_frd_rad_s=np.zeros((n, 3)),
        rotor_speed_rad_s=np.zeros((n, 4)),
        acc_ned_m_s2=np.zeros((n, 3)),
        specific_force_frd_m_s2=np.tile((0.0, 0.0, -9.8066), (n, 1)),
        mean_omega_frd_rad_s=np.tile(np.array(omega, dtype=float), (n, 1)),
    )


def suite_of(config, *, vehicles=1, seed=1, step_us=STEP_US):
    return SensorSuite(
        config=config, site=SITE, vehicles=vehicles, step_us=step_us, seed=np.random.SeedSequence(seed)
    )


def frames(suite, truth, steps, *, step_us=STEP_US):
    return [suite.sample(step * step_us, truth) for step in range(1, steps + 1)]


def position_of(fixes):
    """Return (n, 3) m, NED from the site's origin."""
    return geodetic_to_ned(
        fixes.lat_deg,
        fixes.lon_deg,
        fixes.alt_m,
        origin_lat_deg=SITE.latitude_deg,
        origin_lon_deg=SITE.longitude_deg,
        origin_alt_m=SITE.altitude_m,
    )


def gps_errors(config, *, vehicles, fixes, seed=1):
    """Return position errors (fixes, vehicles, 3) in m, velocity errors likewise, and the last fix."""
    suite = suite_of(config, vehicles=vehicles, seed=seed, step_us=20_000)
    truth = truth_of(np.zeros((vehicles, 3)))
    gps = [frame.gps for frame in frames(suite, truth, fixes * 10, step_us=20_000) if frame.gps is not None]
    return np.array([position_of(fix) for fix in gps]), np.array([fix.vel_ned_m_s for fix in gps]), gps[-1]


IDEAL = SensorsConfig(profile="ideal")


def test_sensors_report_when_they_are_due():
    suite = suite_of(SensorsConfig())
    seen = frames(suite, truth_of((0, 0, -10)), 150)
    due_us = {
        name: [frame.time_us for frame in seen if getattr(frame, name) is not None]
        for name in ("mag_frd_gauss", "baro", "gps")
    }
    assert due_us["mag_frd_gauss"] == list(range(20_000, 600_001, 20_000))
    assert due_us["baro"] == list(range(20_000, 600_001, 20_000))
    assert due_us["gps"] == [200_000, 400_000, 600_000]
    assert [frame.time_us for frame in seen] == list(range(4_000, 600_001, 4_000))


def test_a_rate_that_is_no_multiple_of_the_step_is_correct_on_average():
    config = SensorsConfig(profile="ideal", gps=GpsOverrides(rate_hz=30.0, delay_s=0.0))
    due_us = [f.time_us for f in frames(suite_of(config), truth_of((0, 0, 0)), 2500) if f.gps is not None]
    assert len(due_us) == 300
    late_us = np.array(due_us) - 33_333 * np.arange(1, 301)
    assert late_us.min() >= 0
    assert late_us.max() < STEP_US


def test_ideal_sensors_report_the_truth():
    q_east = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # heading east: north is on the left, east ahead
    truth = truth_of(
        (30.0, -20.0, -100.0), vel_ned_m_s=(1.0, 2.0, 3.0), q_ned_frd=q_east, omega=(0.1, 0.2, 0.3)
    )
    frame = frames(suite_of(IDEAL), truth, 50)[-1]
    np.testing.assert_array_equal(frame.accel_frd_m_s2, [(0.0, 0.0, -9.8066)])
    np.testing.assert_array_equal(frame.gyro_frd_rad_s, [(0.1, 0.2, 0.3)])
    north, east, down = SITE.magnetic_field_ned_gauss
    np.testing.assert_allclose(frame.mag_frd_gauss, [(east, -north, down)], atol=1e-12)
    assert frame.baro.pressure_hpa[0] == pytest.approx(atmosphere.pressure_pa(588.0) / 100.0, rel=1e-12)
    assert frame.baro.temperature_degc[0] == pytest.approx(15.0 - 6.5e-3 * 588.0, abs=1e-9)
    pos = position_of(frame.gps)
    np.testing.assert_allclose(pos, truth.pos_ned_m, atol=1e-6)
    np.testing.assert_array_equal(frame.gps.vel_ned_m_s, truth.vel_ned_m_s)


@pytest.mark.parametrize(("delay_s", "lag_s"), [(None, 0.12), (0.0, 0.0), (0.251, 0.252)])
def test_a_fix_describes_the_past(delay_s, lag_s):
    """At 5 m/s north a fix is 5 m/s x 0.12 s behind; delays are rounded to whole steps of 4 ms."""
    suite = suite_of(SensorsConfig(profile="ideal", gps=GpsOverrides(delay_s=delay_s)))
    behind_m = []
    for step in range(1, 301):
        north_m = 5.0 * step * STEP_US * 1e-6
        truth = truth_of((north_m, 0.0, 0.0), vel_ned_m_s=(5.0, 0.0, 0.0))
        fix = suite.sample(step * STEP_US, truth).gps
        if fix is not None:
            seen_m = position_of(fix)
            behind_m.append(north_m - seen_m[0, 0])
    assert len(behind_m) >= 4
    np.testing.assert_allclose(behind_m, 5.0 * lag_s, atol=1e-6)


def test_consumer_gps_has_errors_of_metres_and_reports_its_accuracy():
    """400 receivers and 150 s: standard deviation, correlation, independence, and eph."""
    pos, vel, fix = gps_errors(SensorsConfig(), vehicles=400, fixes=300)
    np.testing.assert_allclose(pos.std(axis=(0, 1)), np.hypot((1.5, 1.5, 2.5), 0.1), rtol=0.1)
    np.testing.assert_allclose(vel.std(axis=(0, 1)), 0.1, rtol=0.02)
    assert fix.eph_m == pytest.approx(math.hypot(1.5, 0.1))
    assert fix.epv_m == pytest.approx(math.hypot(2.5, 0.1))
    # over 0.2 s almost only the white noise changes: 2 x 0.1^2 + 2 x 1.5^2 (1 - exp(-0.2/60))
    expected_m = math.sqrt(2.0 * 0.1**2 + 2.0 * 1.5**2 * (1.0 - math.exp(-0.2 / 60.0)))
    assert np.diff(pos[..., :2], axis=0).std() == pytest.approx(expected_m, rel=0.02)
    # over 30 s the slow error keeps exp(-1/2)
    kept = np.mean(pos[150:, :, :2] * pos[:-150, :, :2]) / 1.5**2
    assert kept == pytest.approx(math.exp(-0.5), abs=0.1)
    neighbours = np.mean(pos[0, :-1, 0] * pos[0, 1:, 0]) / 1.5**2
    assert abs(neighbours) < 4.0 / math.sqrt(400.0)


def test_gazebo_gps_has_errors_of_millimetres():
    pos, vel, _ = gps_errors(SensorsConfig(profile="gazebo"), vehicles=50, fixes=50)
    np.testing.assert_allclose(pos.std(axis=(0, 1)), (2.8e-3, 2.8e-3, 5.5e-3), rtol=0.1)
    np.testing.assert_allclose(vel.std(axis=(0, 1)), 0.0126, rtol=0.1)


def test_overrides_replace_only_the_profiles_gps():
    config = msgspec.toml.decode(
        'profile = "ideal"\n[gps]\nhorizontal_bias_std_m = 4.0\nrate_hz = 10.0', type=SensorsConfig
    )
    pos, vel, fix = gps_errors(config, vehicles=300, fixes=2)
    assert len(pos) == 3  # at 0.1 s the truth of 0.12 s ago does not exist
    np.testing.assert_allclose(pos[0].std(axis=0), (4.0, 4.0, 0.0), rtol=0.17, atol=1e-6)
    assert not vel.any()
    assert (fix.eph_m, fix.epv_m) == (4.0, 0.01)


def test_magnetometer_and_barometer_noise_is_that_of_the_data_sheets():
    suite = suite_of(SensorsConfig(profile="gazebo"), vehicles=20)
    truth = truth_of(np.tile((0.0, 0.0, -10.0), (20, 1)))
    seen = frames(suite, truth, 1500)
    mag = (
        np.array([f.mag_frd_gauss for f in seen if f.mag_frd_gauss is not None])
        - SITE.magnetic_field_ned_gauss
    )
    np.testing.assert_allclose(np.diff(mag, axis=0).std(), math.sqrt(2.0) * 4e-4 * math.sqrt(50.0), rtol=0.03)
    pressure_pa = 100.0 * np.array([f.baro.pressure_hpa for f in seen if f.baro is not None])
    assert (pressure_pa - atmosphere.pressure_pa(498.0)).std() == pytest.approx(1.0, rel=0.05)
    gyro = np.array([f.gyro_frd_rad_s for f in seen])
    accel = np.array([f.accel_frd_m_s2 for f in seen]) - (0.0, 0.0, -9.8066)
    assert gyro.std() == pytest.approx(0.0138, rel=0.01)
    assert accel.std() == pytest.approx(0.1007, rel=0.01)


def test_consumer_sensors_have_turn_on_biases_that_differ_by_vehicle():
    vehicles = 300
    suite = suite_of(SensorsConfig(), vehicles=vehicles)
    seen = frames(suite, truth_of(np.tile((0.0, 0.0, -10.0), (vehicles, 1))), 250)
    gyro_bias = np.mean([f.gyro_frd_rad_s for f in seen], axis=0)
    accel_bias = np.mean([f.accel_frd_m_s2 for f in seen], axis=0) - (0.0, 0.0, -9.8066)
    drift = {"gyro": 3.879e-5 * math.sqrt(500.0), "accel": 6e-3 * math.sqrt(150.0)}
    white = {"gyro": 8.726646e-4, "accel": 6.37e-3}  # of a mean over one second
    assert gyro_bias.std() == pytest.approx(math.hypot(8.73e-3, drift["gyro"], white["gyro"]), rel=0.1)
    assert accel_bias.std() == pytest.approx(math.hypot(0.05, drift["accel"], white["accel"]), rel=0.1)


def test_one_vehicle_does_not_affect_the_errors_of_another():
    here, moved = truth_of([(0, 0, -10), (5, 0, -10)]), truth_of([(0, 0, -10), (50, 9, 0)])
    for ours, theirs in zip(
        frames(suite_of(SensorsConfig(), vehicles=2), here, 100),
        frames(suite_of(SensorsConfig(), vehicles=2), moved, 100),
        strict=True,
    ):
        assert ours.accel_frd_m_s2[0].tobytes() == theirs.accel_frd_m_s2[0].tobytes()
        if ours.gps is not None:
            assert ours.gps.lat_deg[0] == theirs.gps.lat_deg[0]
            assert ours.baro.pressure_hpa[0] == theirs.baro.pressure_hpa[0]
            assert ours.gps.lat_deg[1] != theirs.gps.lat_deg[1]


def test_sensors_have_streams_of_their_own():
    """Another GPS rate changes no other sensor's noise."""
    slow = frames(suite_of(SensorsConfig()), truth_of((0, 0, -10)), 100)
    fast = frames(suite_of(SensorsConfig(gps=GpsOverrides(rate_hz=10.0))), truth_of((0, 0, -10)), 100)
    assert [f.baro.pressure_hpa[0] for f in slow if f.baro] == [
        f.baro.pressure_hpa[0] for f in fast if f.baro
    ]
    assert slow[-1].gyro_frd_rad_s.tobytes() == fast[-1].gyro_frd_rad_s.tobytes()


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ('profile = "perfect"', "profile"),
        ("[gps]\nwhite_std_m = -0.1", "gps.white_std_m"),
        ("[gps]\nrate = 5", "rate"),
    ],
)
def test_wrong_settings_are_refused_by_name(toml, message):
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.toml.decode(toml, type=SensorsConfig)
