"""Every fault has its effect only on its vehicle and only in its time. 5 s."""

import numpy as np
import pytest
from faults_fixtures import (
    BEGIN_US,
    END_US,
    EXAMPLES,
    HIT,
    SENSOR_FAULTS,
    SITE,
    STEP_US,
    N,
    columns,
    differences,
    fault_of,
    faults_of,
    fly,
    truth_at,
)
from pymavlink.dialects.v20 import common

from autopilot.estimation import atmosphere
from autopilot.mavlink.codec import Parser
from autopilot.navigation.site_frame import SiteFrame
from foundation.airframe.files import IRIS
from harness.cli.progress import describe
from harness.simulator.hil import SensorEncoder
from harness.simulator.messages import FaultChanged
from harness.simulator.truth_record import EVENT_KINDS
from harness.world.faults import AnyFault, kind
from harness.world.physics.world import World

AFFECTED = {
    "gps_loss": {"gps_lost"},
    "gps_bias": {"gps_pos"},
    "gps_noise": {"gps_pos", "gps_vel"},
    "accel_bias": {"accel"},
    "gyro_bias": {"gyro"},
    "mag_bias": {"mag"},
    "mag_yaw": {"mag"},
    "baro_freeze": {"pressure", "temperature"},
    "baro_bias": {"pressure"},
}


@pytest.fixture(scope="module")
def healthy():
    return fly()


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_a_sensor_fault_affects_only_its_sensor_its_vehicle_and_its_time(healthy, name):
    """All other samples are bit-identical; in its time every sample is affected."""
    found = differences(healthy, fly(fault_of(name)))
    assert {each[1] for each in found} == AFFECTED[name]
    assert {each[2] for each in found} == {HIT}
    times_us = [each[0] for each in found]
    assert min(times_us) >= BEGIN_US
    assert max(times_us) < END_US
    due = sum(
        BEGIN_US <= frame.time_us < END_US and any(column in columns(frame) for column in AFFECTED[name])
        for frame in healthy
    )
    assert len(set(times_us)) == due


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_all_affects_every_vehicle_and_without_a_duration_the_fault_lasts(healthy, name):
    every_vehicle = fault_of(name, uav="all", duration_s=None)
    found = differences(healthy, fly(every_vehicle))
    assert {each[2] for each in found} == set(range(N))
    last_us = {name: max(f.time_us for f in healthy if name in columns(f)) for name in AFFECTED[name]}
    assert {(each[0], each[1]) for each in found} >= {(at_us, name) for name, at_us in last_us.items()}


@pytest.mark.parametrize(
    ("name", "column", "offset"),
    [
        ("gps_bias", "gps_pos", (30.0, -40.0, 5.0)),
        ("accel_bias", "accel", (1.0, -2.0, 0.5)),
        ("gyro_bias", "gyro", (0.1, 0.0, -0.2)),
        ("mag_bias", "mag", (0.05, 0.1, -0.02)),
    ],
)
def test_a_bias_equals_its_offset(healthy, name, column, offset):
    for _, seen, _, change in differences(healthy, fly(fault_of(name))):
        assert seen == column
        np.testing.assert_allclose(
            change, offset, atol=2e-5
        )  # GPS through degrees on a curved Earth and back


def test_faults_that_overlap_add_up(healthy):
    twice = fly(fault_of("gyro_bias"), fault_of("gyro_bias", uav="all", offset_frd_rad_s=(0.0, 0.3, 0.0)))
    seen = {(vehicle, tuple(change.round(9))) for _, _, vehicle, change in differences(healthy, twice)}
    assert seen == {(0, (0.0, 0.3, 0.0)), (1, (0.1, 0.3, -0.2)), (2, (0.0, 0.3, 0.0))}


def test_slow_spoofing_grows_at_its_rate_with_a_consistent_velocity(healthy):
    """At 10 m/s along (0.6, -0.8, 0) to 7 m: complete after 0.7 s."""
    creep = fault_of("gps_bias", offset_ned_m=(4.2, -5.6, 0.0), rate_m_s=10.0)
    seen = {}
    for time_us, name, vehicle, change in differences(healthy, fly(creep)):
        assert vehicle == HIT
        seen.setdefault(name, {})[time_us] = change
    # the fix at 1.0 s is not yet displaced
    length_m = {1_200_000: 2.0, 1_400_000: 4.0, 1_600_000: 6.0, 1_800_000: 7.0}
    assert seen["gps_pos"].keys() == length_m.keys()
    for time_us, expected_m in length_m.items():
        np.testing.assert_allclose(
            seen["gps_pos"][time_us], expected_m * np.array((0.6, -0.8, 0.0)), atol=2e-5
        )
    assert seen["gps_vel"].keys() == {1_000_000, 1_200_000, 1_400_000, 1_600_000}
    for change in seen["gps_vel"].values():
        np.testing.assert_allclose(change, (6.0, -8.0, 0.0), atol=1e-12)


def test_gps_noise_has_its_standard_deviation():
    """60 s at 5 Hz and 3 axes: 900 samples of vehicle 1, so 2.4 % of a standard deviation; four of those."""
    state = faults_of(fault_of("gps_noise", duration_s=None))
    errors = []
    for time_us in range(BEGIN_US, BEGIN_US + 60_000_000, 200_000):
        state.advance(time_us)
        errors.append(state.gps_errors())
    position_m, velocity_m_s = np.array([e[0] for e in errors]), np.array([e[1] for e in errors])
    assert position_m[:, HIT].std() == pytest.approx(4.0, rel=0.1)
    assert velocity_m_s[:, HIT].std() == pytest.approx(0.5, rel=0.1)
    assert not position_m[:, [0, 2]].any()


def test_a_rotated_field_shifts_a_level_compass_clockwise_by_its_angle():
    """The field is rotated about the vertical, so inclination and strength are unchanged at any tilt."""
    for healthy_frame, faulty_frame in zip(
        fly(profile="ideal"), fly(fault_of("mag_yaw"), profile="ideal"), strict=True
    ):
        if healthy_frame.mag_frd_gauss is None or not BEGIN_US <= healthy_frame.time_us < END_US:
            continue
        q = truth_at(healthy_frame.time_us).q_ned_frd[HIT]
        inverse = np.array((q[0], -q[1], -q[2], -q[3]))
        before, after = (_rotated(inverse, f.mag_frd_gauss[HIT]) for f in (healthy_frame, faulty_frame))
        # the field's direction decreases by the increase of the heading
        turned = np.arctan2(after[1], after[0]) - np.arctan2(before[1], before[0])
        assert np.degrees(turned) == pytest.approx(-40.0, abs=1e-6)
        assert after[2] == pytest.approx(before[2], abs=1e-12)


def _rotated(q_to_frd, vector_frd):
    """Rotate from FRD to NED with matrices, independent of the quaternion code under test."""
    w, x, y, z = q_to_frd
    frd_from_ned = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    return frd_from_ned.T @ vector_frd


def test_a_biased_barometer_reads_the_pressure_of_another_altitude():
    frame = next(
        f for f in fly(fault_of("baro_bias"), profile="ideal") if f.baro is not None and f.time_us >= BEGIN_US
    )
    altitude_m = SITE.altitude_m - truth_at(frame.time_us).pos_ned_m[:, 2]
    pressure_hpa = [0.01 * atmosphere.pressure_pa(a) for a in altitude_m + np.array((0.0, 8.0, 0.0))]
    np.testing.assert_allclose(frame.baro.pressure_hpa, pressure_hpa, rtol=1e-12)


def test_a_frozen_barometer_repeats_its_last_sample_and_then_continues(healthy):
    frozen = fly(fault_of("baro_freeze"))
    last = [f.baro for f in healthy if f.baro is not None and f.time_us < BEGIN_US][-1]
    samples = [f.baro for f in frozen if f.baro is not None and BEGIN_US <= f.time_us < END_US]
    assert len(samples) == 50  # 50 Hz for a second: it continues to report
    assert {s.pressure_hpa[HIT] for s in samples} == {last.pressure_hpa[HIT]}
    assert {s.temperature_degc[HIT] for s in samples} == {last.temperature_degc[HIT]}


def test_a_barometer_that_is_frozen_from_the_start_keeps_its_first_sample():
    samples = [
        f.baro for f in fly(fault_of("baro_freeze", start_s=0.0, duration_s=None)) if f.baro is not None
    ]
    assert len({s.pressure_hpa[HIT] for s in samples}) == 1
    assert len({s.pressure_hpa[0] for s in samples}) > 50


def test_a_jammed_receiver_reports_no_fix_and_no_satellites_and_others_are_not_affected():
    frames = [f for f in fly(fault_of("gps_loss")) if f.gps is not None and BEGIN_US <= f.time_us < END_US]
    assert len(frames) == 5
    encoder = SensorEncoder()
    for frame in frames:
        messages = [
            next(m for m in Parser().push(data) if m.get_type() == "HIL_GPS")
            for data in encoder.encode(frame.time_us, frame)
        ]
        assert [m.fix_type for m in messages] == [
            common.GPS_FIX_TYPE_3D_FIX, common.GPS_FIX_TYPE_NO_FIX, common.GPS_FIX_TYPE_3D_FIX
        ]  # fmt: skip
        assert [m.satellites_visible for m in messages] == [10, 0, 10]
        assert (messages[HIT].eph, messages[HIT].epv, messages[HIT].vel) == (65_535, 65_535, 65_535)
        assert messages[0].lat != 0


def test_the_flight_log_has_no_position_while_there_is_no_fix():
    """Through the encoder and the vehicle's parser: the site, then nothing, then the site again."""
    site = SiteFrame(SITE)
    encoder, seen = SensorEncoder(), {}
    assert np.isnan(site.fix_ned_m(None)).all()
    for frame in fly(fault_of("gps_loss"), profile="ideal"):
        if frame.gps is not None:
            data = list(encoder.encode(frame.time_us, frame))[HIT]
            fix = next(m for m in Parser().push(data) if m.get_type() == "HIL_GPS")
            seen[frame.time_us] = site.fix_ned_m(fix)
    lost = {time_us for time_us, pos in seen.items() if np.isnan(pos).all()}
    assert lost == {time_us for time_us in seen if BEGIN_US <= time_us < END_US}
    for time_us in seen.keys() - lost:
        expected = truth_at(time_us - 120_000).pos_ned_m[HIT]
        np.testing.assert_allclose(seen[time_us], expected, atol=0.02)  # 1e-7 deg are 11 mm


def spin(*faults, steps=500):
    """Return rotor speeds and vertical accelerations of hovering vehicles, per step."""
    spawn = [(0.0, 5.0 * i, -200.0) for i in range(N)]
    state = faults_of(*faults)
    seen = []
    with World(
        airframes=[IRIS] * len(spawn), spawn_pos_ned_m=spawn, spawn_yaw_rad=0.0, step_us=STEP_US
    ) as world:
        for step in range(1, steps + 1):
            state.advance(step * STEP_US)
            stopped = np.zeros((N, 4), bool) if state.rotor_stopped is None else state.rotor_stopped
            world.step(
                np.full((N, 4), 0.7067),
                np.ones(N, bool),
                np.zeros((N, 3)),
                rotors_stopped=stopped,
                rotor_effectiveness=state.rotor_effectiveness,
            )
            seen.append((step * STEP_US, world.truth))
    return seen


def test_a_broken_propeller_has_less_thrust_and_torque_at_its_speed():
    """Rotor 2, front left, has a quarter of 3.8 N: the vehicle, level in that first step, tips to it."""
    seen = dict(spin(fault_of("motor"), steps=260))
    before, first = seen[BEGIN_US - STEP_US], seen[BEGIN_US]
    np.testing.assert_allclose(before.acc_ned_m_s2[0], before.acc_ned_m_s2[HIT], atol=1e-9)
    lost_n = 0.75 * 5.84e-6 * first.rotor_speed_rad_s[HIT, 2] ** 2
    lacking_m_s2 = first.acc_ned_m_s2[HIT, 2] - first.acc_ned_m_s2[0, 2]
    # both descend slowly, which hardly changes the thrust
    assert lacking_m_s2 == pytest.approx(lost_n / 1.55, rel=0.01)
    roll_rad_s2, pitch_rad_s2, yaw_rad_s2 = first.omega_frd_rad_s[HIT] / (STEP_US * 1e-6)
    assert roll_rad_s2 == pytest.approx(-0.22 * lost_n / 0.029125, rel=0.02)
    assert pitch_rad_s2 == pytest.approx(-0.13 * lost_n / 0.029125, rel=0.02)
    # the reaction to a clockwise rotor is reduced
    assert yaw_rad_s2 == pytest.approx(0.06 * lost_n / 0.055225, rel=0.02)
    np.testing.assert_array_equal(first.rotor_speed_rad_s[HIT], first.rotor_speed_rad_s[0])
    np.testing.assert_array_equal(first.omega_frd_rad_s[[0, 2]], 0.0)


def test_only_the_stopped_motor_runs_down_and_recovers():
    seen = dict(spin(fault_of("motor_stop", duration_s=0.4), steps=400))
    at = {time_us: truth.rotor_speed_rad_s for time_us, truth in seen.items()}
    hover_rad_s = at[BEGIN_US - STEP_US][0, 0]
    # 25 ms of time constant: exp(-0.2 s / 25 ms) is 0.03 %
    assert at[BEGIN_US + 200_000][HIT, 3] == pytest.approx(0.0, abs=0.5)
    np.testing.assert_allclose(at[BEGIN_US + 200_000][HIT, :3], hover_rad_s, rtol=1e-9)
    np.testing.assert_allclose(at[BEGIN_US + 200_000][[0, 2]], hover_rad_s, rtol=1e-9)
    assert at[BEGIN_US + 400_000 + 200_000][HIT, 3] == pytest.approx(hover_rad_s, rel=1e-3)


def test_begin_and_end_are_reported_once_and_at_their_steps():
    state = faults_of(fault_of("gps_loss"), fault_of("baro_freeze", start_s=0.5, duration_s=None, uav="all"))
    changes = {}
    for time_us in range(STEP_US, 3_000_000, STEP_US):
        for change in state.advance(time_us):
            changes.setdefault(time_us, []).append((kind(change.fault), change.fault.uav, change.began))
    assert changes == {
        500_000: [("baro_freeze", "all", True)],
        BEGIN_US: [("gps_loss", HIT, True)],
        END_US: [("gps_loss", HIT, False)],
    }


def lost_us(*faults, step_us=STEP_US):
    state, seen, changes = faults_of(*faults), [], []
    for time_us in range(step_us, 60_000, step_us):
        changes += state.advance(time_us)
        if state.gps_lost is not None:
            seen.append(time_us)
    return seen, changes


def test_times_between_steps_take_effect_at_the_next_step():
    seen, _ = lost_us(fault_of("gps_loss", start_s=0.0101, duration_s=0.01))
    assert seen == [12_000, 16_000, 20_000]


@pytest.mark.parametrize("start_s", [0.008, 0.0081, 0.0099999, 0.012])
def test_the_shortest_fault_lasts_for_one_step_wherever_it_begins(start_s):
    seen, changes = lost_us(fault_of("gps_loss", start_s=start_s, duration_s=0.004))
    assert seen == [8_000 if start_s == 0.008 else 12_000]
    assert len(changes) == 2


def test_a_fault_between_two_steps_has_no_effect():
    assert lost_us(fault_of("gps_loss", start_s=0.021, duration_s=0.004), step_us=20_000) == ([], [])


def test_ends_are_reported_before_begins_each_with_its_number():
    state = faults_of(
        fault_of("motor_stop", start_s=2.0),
        fault_of("gps_loss"),
        fault_of("motor", start_s=0.5, duration_s=1.5),
    )
    state.add(fault_of("baro_freeze", start_s=2.0, duration_s=None), 0)
    changes = {}
    for time_us in range(STEP_US, 2_100_000, STEP_US):
        for change in state.advance(time_us):
            entry = (change.began, change.number, kind(change.fault), change.motor)
            changes.setdefault(time_us, []).append(entry)
    assert changes == {
        500_000: [(True, 2, "motor", 2)],
        BEGIN_US: [(True, 1, "gps_loss", None)],
        END_US: [
            (False, 2, "motor", 2),
            (False, 1, "gps_loss", None),
            (True, 0, "motor_stop", 3),
            (True, 3, "baro_freeze", None),
        ],
    }


def test_an_injected_fault_starts_relative_to_now():
    state = faults_of()
    state.advance(700_000)
    state.add(fault_of("accel_bias", start_s=0.0, duration_s=0.1), 704_000)
    assert not state.advance(700_000)
    assert [c.began for c in state.advance(704_000)] == [True]
    assert state.accel_offset_frd_m_s2 is not None
    assert [c.began for c in state.advance(804_000)] == [False]
    assert state.accel_offset_frd_m_s2 is None


def test_equal_runs_with_faults_are_equal_to_the_bit_and_noise_follows_the_seed():
    everything = [fault_of(name, uav="all") for name in SENSOR_FAULTS]
    first, again, other = (fly(*everything, until_us=1_500_000, seed=seed) for seed in (5, 5, 6))
    assert not differences(first, again)
    assert {each[1] for each in differences(first, other)} == {"gps_pos", "gps_vel"}


def test_a_change_is_described_in_words():
    change = FaultChanged(
        time_us=4_500_000, number=0, instance=2, what="gps_loss", motor=None, change="began"
    )
    assert describe(change) == "t = 4.50 s: fault 0 (gps_loss) of uav 2 began"
    change = FaultChanged(
        time_us=4_500_000, number=3, instance=None, what="motor_stop", motor=1, change="ended"
    )
    assert describe(change) == "t = 4.50 s: fault 3 (motor_stop 1) of every uav ended"


def test_a_change_is_recorded_in_the_event_log():
    assert FaultChanged.__struct_config__.tag in EVENT_KINDS


def test_noise_at_one_vehicle_does_not_depend_on_faults_of_others(healthy):
    """From the first fix on, with another's noise before, during and in addition, and with other faults."""
    own = fault_of("gps_noise", duration_s=None)
    alone = differences(healthy, fly(own))
    for others in (
        [fault_of("gps_noise", uav=0, start_s=0.3, duration_s=0.5)],
        [fault_of("gps_noise", uav=2, start_s=1.5), fault_of("gps_bias", uav=0), fault_of("gps_loss", uav=2)],
    ):
        together = [each for each in differences(healthy, fly(*others, own)) if each[2] == HIT]
        assert len(together) == len(alone)
        for first, second in zip(alone, together, strict=True):
            assert first[:3] == second[:3]
            np.testing.assert_array_equal(first[3], second[3])


def test_overlapping_noises_add_up_by_their_variances(healthy):
    """3 m and 4 m give 5 m, with the same draws as a single fault of 5 m."""
    two = fly(fault_of("gps_noise", position_std_m=3.0, velocity_std_m_s=0.0),
              fault_of("gps_noise", uav="all", position_std_m=4.0, velocity_std_m_s=0.0))  # fmt: skip
    one = fly(fault_of("gps_noise", position_std_m=5.0, velocity_std_m_s=0.0))
    first, second = ([e[3] for e in differences(healthy, frames) if e[2] == HIT] for frames in (two, one))
    np.testing.assert_allclose(first, second, atol=1e-6)


def radio_at(state, time_us):
    state.advance(time_us)
    return state.extra_attenuation_db, dict(state.range_offsets_m)


def test_radio_faults_are_active_in_their_time_and_add_up():
    state = faults_of(
        fault_of("radio_attenuation", attenuation_db=20.0),
        fault_of("radio_attenuation", attenuation_db=180.0, start_s=1.5),
        fault_of("ranging_bias", offset_m=5.0),
        fault_of("ranging_bias", uav="all", offset_m=-2.0, start_s=1.5),
    )
    assert radio_at(state, BEGIN_US - STEP_US) == (0.0, {})
    assert radio_at(state, BEGIN_US) == (20.0, {HIT: 5.0})
    assert radio_at(state, 1_500_000) == (200.0, {0: -2.0, HIT: 3.0, 2: -2.0})
    assert radio_at(state, END_US) == (180.0, dict.fromkeys(range(N), -2.0))
    assert radio_at(state, 2_500_000) == (0.0, {})


@pytest.mark.parametrize("name", ["radio_attenuation", "ranging_bias"])
def test_radio_faults_do_not_affect_the_sensors(healthy, name):
    assert not differences(healthy, fly(fault_of(name)))


def test_every_kind_has_an_example_here():
    tags = {member.__struct_config__.tag for member in AnyFault.__args__}
    assert tags - {"user"} == EXAMPLES.keys()  # that of users is in test_active_faults.py
