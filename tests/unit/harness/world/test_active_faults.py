"""A user's faults act on their vehicle and in their time, and add up with the built-in ones. 3 s."""

import numpy as np
import pytest
from faults_fixtures import BEGIN_US, END_US, HIT, ROTORS, STEP_US, N, differences, fault_of, fly, truth_at
from world_models import models

from autopilot.parameters.config import Site
from harness.world.active_faults import MOST_ATTENUATION_DB, Faults
from harness.world.faults import UserFault
from harness.world.interfaces import inputs_of
from harness.world.sensors.config import SensorsConfig
from harness.world.sensors.suite import SensorSuite

ALIVE = np.ones(N, bool)
SAME = {
    "accel_bias": {"accel_offset_frd_m_s2": (1.0, -2.0, 0.5)},
    "gyro_bias": {"gyro_offset_frd_rad_s": (0.1, 0.0, -0.2)},
    "mag_bias": {"mag_offset_frd_gauss": (0.05, 0.1, -0.02)},
    "mag_yaw": {"heading_error_rad": np.radians(40.0).item()},
    "baro_freeze": {"baro_frozen": True},
    "baro_bias": {"baro_offset_m": 8.0},
    "gps_loss": {"gps_lost": True},
    "gps_bias": {"gps_offset_ned_m": (30.0, -40.0, 5.0)},
}
"""Effects of the built-in examples."""


def user(model, settings=None, uav=HIT, **fields):
    fields = {"start_s": 1.0, "duration_s": 1.0, **fields}
    return UserFault(uav=uav, model=f"user_world_models:{model}", settings=settings or {}, **fields)


def offsets(**effects):
    return user("Offsets", {"effects": effects})


def faults_of(*faults):
    return Faults(faults, ROTORS, np.random.default_rng(5), models(N).fault)


def advanced(faults, time_us):
    faults.advance(time_us, lambda vehicle: inputs_of(time_us, truth_at(time_us), ALIVE, vehicle, 4))
    return faults


def flown(*faults):
    """Return sensor frames as `faults_fixtures.fly`, with faults of the user."""
    suite = SensorSuite(
        config=SensorsConfig(profile="consumer"), site=Site(), vehicles=N, step_us=STEP_US,
        seed=np.random.SeedSequence(1),
    )  # fmt: skip
    state = faults_of(*faults)
    return [
        suite.sample(time_us, truth_at(time_us), advanced(state, time_us))
        for time_us in range(STEP_US, 3_000_000, STEP_US)
    ]


@pytest.mark.parametrize("name", SAME)
def test_a_users_fault_with_the_effects_of_a_built_in_one_gives_the_same_bits(name):
    built_in, own = fly(fault_of(name)), flown(offsets(**SAME[name]))
    assert differences(built_in, own) == []
    assert differences(fly(), own) != []


def test_faults_of_the_user_and_built_in_ones_add_up():
    state = faults_of(
        fault_of("gyro_bias", uav="all", offset_frd_rad_s=(0.0, 0.3, 0.0)),
        offsets(gyro_offset_frd_rad_s=(0.1, 0.1, 0.0), rotor_effectiveness={"2": 0.5}),
        fault_of("motor", motor=2, effectiveness=0.5),
        offsets(rotors_stopped=(1,), range_offset_m=2.0),
        fault_of("ranging_bias", offset_m=3.0),
    )
    advanced(state, BEGIN_US)
    expected_rad_s = np.array([(0.0, 0.3, 0.0)] * N)
    expected_rad_s[HIT] = (0.1, 0.4, 0.0)
    np.testing.assert_allclose(state.gyro_offset_frd_rad_s, expected_rad_s)
    expected = np.ones((N, 4))
    expected[HIT, 2] = 0.25
    np.testing.assert_array_equal(state.rotor_effectiveness, expected)
    np.testing.assert_array_equal(np.argwhere(state.rotor_stopped), [(HIT, 1)])
    assert state.range_offsets_m == {HIT: 5.0}


def test_effects_follow_time_and_state_and_end():
    state = faults_of(user("Ramp", uav="all"))
    assert advanced(state, BEGIN_US - STEP_US).force_ned_n is None
    for time_us in (BEGIN_US, BEGIN_US + 40_000, END_US - STEP_US):
        advanced(state, time_us)
        height_m = truth_at(time_us).pos_ned_m[:, 2]
        expected_n = [((time_us - BEGIN_US) * 1e-6, float(i), height_m[i]) for i in range(N)]
        np.testing.assert_allclose(state.force_ned_n, expected_n)
    assert advanced(state, END_US).force_ned_n is None


def test_of_the_vehicles_of_one_fault_the_greatest_attenuation_counts():
    loss = {"effects": {"attenuation_db": 30.0}}
    state = faults_of(user("Offsets", loss, uav="all"), user("Offsets", loss), fault_of("radio_attenuation"))
    assert advanced(state, BEGIN_US).extra_attenuation_db == 30.0 + 30.0 + 60.0
    many = faults_of(*[fault_of("radio_attenuation", attenuation_db=300.0)] * 5)
    assert advanced(many, BEGIN_US).extra_attenuation_db == MOST_ATTENUATION_DB


def test_a_fault_drops_or_changes_readings_of_its_vehicle_and_sensor():
    state = faults_of(user("Jamming", {"sensor": "uwb", "added": 0.5}), user("Jamming", {"sensor": "down"}))
    assert state.reading(HIT, "uwb", (1.0, 2.0)) == (1.0, 2.0)  # not active yet
    advanced(state, BEGIN_US)
    assert state.reading(HIT, "uwb", (1.0, 2.0)) == (1.5, 2.5)
    assert state.reading(HIT, "down", (1.0,)) is None
    assert state.reading(HIT, "other", (1.0,)) == (1.0,)
    assert state.reading(0, "uwb", (1.0, 2.0)) == (1.0, 2.0)
    advanced(state, END_US)
    assert state.reading(HIT, "down", (1.0,)) == (1.0,)


def test_changes_have_the_models_name():
    changes = faults_of(user("Ramp")).advance(
        BEGIN_US, lambda vehicle: inputs_of(BEGIN_US, truth_at(BEGIN_US), ALIVE, vehicle, 4)
    )
    assert [(change.began, change.number, change.motor) for change in changes] == [(True, 0, None)]
