"""Timeline of samples and arrivals: rates, delays, faults, lost vehicles."""

import math

import numpy as np
from pymavlink.dialects.v20 import common
from world_models import STEP_US, models, state_of

from autopilot.mavlink.codec import Parser
from autopilot.mavlink.hil import HilParser, HilSensor
from harness.simulator.hil import SensorEncoder
from harness.world.active_faults import Faults
from harness.world.faults import UserFault
from harness.world.interfaces import Reading
from harness.world.sensors.config import ExtraSensor
from harness.world.sensors.extra import Arrival, ExtraSensors
from harness.world.sensors.suite import SensorFrame

COUNTER = "user_world_models:Counter"
PLACES = [(0.0, 0.0, -5.0), (0.0, 0.0, -6.0), (0.0, 0.0, -7.0)]


def timeline(choices, until_us, faults=(), lost_from_us=math.inf):
    """Return (time_us, name, vehicle, measured_us, values) of each arrival."""
    world = models(3)
    sensors = ExtraSensors(world.sensors(choices), STEP_US)
    active = Faults(faults, (4, 4, 4), np.random.default_rng(0), world.fault)
    seen = []
    for time_us in range(STEP_US, until_us + 1, STEP_US):

        def inputs_of(vehicle, time_us=time_us):
            return state_of(PLACES, vehicle, time_us=time_us)

        active.advance(time_us, inputs_of)
        lost = (1,) if time_us >= lost_from_us else ()
        for sensor, reading in sensors.sample(time_us, inputs_of, active, lost):
            seen.append((time_us, sensor.name, sensor.vehicle, reading.measured_us, reading.values))
    return seen


def counter(period_us, delay_us, **fields):
    return ExtraSensor(model=COUNTER, settings={"period_us": period_us, "delay_us": delay_us}, **fields)


def test_samples_are_taken_after_each_period_and_arrive_after_the_delay():
    """Every 10 ms in steps of 4 ms, and 6 ms late, which is two steps."""
    seen = timeline([counter(10_000, 6_000, uavs=(2,))], 48_000)
    assert [(each[3], each[0]) for each in seen] == [
        (12_000, 20_000), (20_000, 28_000), (32_000, 40_000), (40_000, 48_000),
    ]  # fmt: skip
    assert [each[4] for each in seen] == [(float(count), 7.0) for count in (1, 2, 3, 4)]
    assert {each[2] for each in seen} == {2}


def test_a_reading_without_delay_arrives_in_its_step_and_order_is_by_sensor_and_vehicle():
    choices = [counter(8_000, 0, name="one"), counter(4_000, 0, name="two", uavs=(1, 0))]
    seen = [(each[0], each[1], each[2]) for each in timeline(choices, 8_000)]
    assert seen == [
        (4_000, "two", 0), (4_000, "two", 1),
        (8_000, "one", 0), (8_000, "one", 1), (8_000, "one", 2), (8_000, "two", 0), (8_000, "two", 1),
    ]  # fmt: skip


def test_a_lost_vehicle_has_no_readings():
    seen = timeline([counter(4_000, 8_000)], 40_000, lost_from_us=20_000)
    assert max(each[0] for each in seen if each[2] == 1) == 16_000
    assert max(each[0] for each in seen if each[2] == 0) == 40_000


def test_a_fault_acts_on_what_is_measured_in_its_time():
    jam = UserFault(
        uav=0, model="user_world_models:Jamming", settings={"sensor": "one"}, start_s=0.02, duration_s=0.02
    )
    seen = timeline([counter(4_000, 8_000, name="one")], 60_000, faults=[jam])
    times_us = {vehicle: [each[3] for each in seen if each[2] == vehicle] for vehicle in (0, 1)}
    assert sorted(set(times_us[1]) - set(times_us[0])) == list(range(20_000, 40_000, 4_000))


def frame_of(time_us):
    return SensorFrame(
        time_us=time_us, accel_frd_m_s2=np.zeros((3, 3)), gyro_frd_rad_s=np.zeros((3, 3)),
        mag_frd_gauss=None, baro=None, gps=None,
    )  # fmt: skip


def test_messages_precede_the_clock_of_their_vehicle_whatever_flies_it():
    """UAV 1 is flown by a PX4; the others by coflight's autopilot."""
    world = models(3)
    finders = world.sensors([ExtraSensor(model="range_finder", uavs=(1, 2))])
    (tag,) = world.sensors([ExtraSensor(model="uwb_tag", uavs=(2,), settings={"vehicles": True})])
    arrivals = [Arrival(each, Reading(4_000, (3.0, 0.5))) for each in finders]
    arrivals.append(Arrival(tag, Reading(4_000, (1.5, math.nan))))
    encoder = SensorEncoder(px4=[1])
    for time_us in (8_000, 12_000):
        frames = encoder.encode(time_us, frame_of(time_us), arrivals=arrivals)
        seen = [[message.get_msgId() for message in HilParser(HilSensor).push(bytes(f))] for f in frames]
        distance, array = common.MAVLINK_MSG_ID_DISTANCE_SENSOR, common.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY
        clock = common.MAVLINK_MSG_ID_HIL_SENSOR
        assert seen == [[clock], [distance, clock], [distance, array, clock]]
    plain = encoder.encode(16_000, frame_of(16_000))
    assert [len(Parser().push(bytes(frame))) for frame in plain] == [1, 1, 1]


def test_an_array_has_name_number_time_and_values():
    (tag,) = models(3).sensors([ExtraSensor(model="uwb_tag", uavs=(2,), settings={"vehicles": True})])
    (message,) = Parser().push(tag.frame(Reading(123_456, (1.5, math.nan)), common.MAVLink(None)))
    assert (message.get_type(), message.name, message.array_id) == ("DEBUG_FLOAT_ARRAY", "uwb_tag", 0)
    assert message.time_usec == 123_456
    assert message.data[0] == 1.5
    assert math.isnan(message.data[1])
    assert set(message.data[2:]) == {0.0}
