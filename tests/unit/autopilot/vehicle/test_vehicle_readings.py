"""Readings of a scenario's own sensors reach telemetry and the application. 2 s."""

import math

import pytest
from pymavlink.dialects.v20 import common
from vehicle_world import STEP_US, vehicle_config

from autopilot.mavlink.hil import HilSensor
from autopilot.services.service import COMPANION, GROUND_STATION
from autopilot.vehicle.vehicle import Vehicle

DISTANCE, ARRAY = common.MAVLINK_MSG_ID_DISTANCE_SENSOR, common.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY
IMU = 0b111111


class Listener:
    """An application that stores what it receives."""

    def __init__(self):
        self.seen = []

    def on_mavlink(self, message, now_us):
        self.seen.append((now_us, message))


class Bench:
    """A vehicle on the ground that receives inertial samples, and readings before them."""

    def __init__(self):
        self.vehicle = Vehicle(vehicle_config())
        self.time_us = 0
        self.sent = {GROUND_STATION: [], COMPANION: []}

    def step(self, *readings, steps=1):
        for number in range(steps):
            self.time_us += STEP_US
            clock = HilSensor(self.time_us, 0.0, 0.0, -9.81, *[0.0] * 10, IMU)
            messages = [*(readings if number == 0 else ()), clock]
            for partner, message in self.vehicle.step(sim_messages=messages).links:
                if message.get_msgId() == DISTANCE:
                    self.sent[partner.link].append((self.time_us, message.id, message.current_distance))


@pytest.fixture
def bench():
    return Bench()


def distance(number, distance_cm):
    return common.MAVLink_distance_sensor_message(0, 10, 4000, distance_cm, 0, number, 25, 4)


def test_without_a_range_finder_nothing_is_streamed(bench):
    bench.step(steps=600)
    assert bench.sent == {GROUND_STATION: [], COMPANION: []}


def test_readings_are_streamed_at_px4s_rates_with_one_message_for_each_sensor(bench):
    for count in range(100):  # every 20 ms for 2 s
        bench.step(distance(0, 100 + count), distance(3, 500 + count), steps=5)
    companion = bench.sent[COMPANION]
    times_us = [STEP_US, *range(100_000, 2_000_001, 100_000)]  # 10 Hz
    assert [each[:2] for each in companion] == [(at_us, number) for at_us in times_us for number in (0, 3)]
    for time_us, number, found_cm in companion:  # the newest ones
        assert found_cm == (100 if number == 0 else 500) + (time_us - STEP_US) // 20_000
    assert [each[0] for each in bench.sent[GROUND_STATION]] == [STEP_US] * 2 + [2_000_000] * 2  # 0.5 Hz


def test_a_reading_is_sent_once(bench):
    bench.step(distance(0, 100))
    bench.step(steps=600)
    assert len(bench.sent[COMPANION]) == 1


def test_the_application_receives_readings_in_their_step_and_nothing_else_of_the_simulator(bench):
    listener = bench.vehicle.app = Listener()
    bench.vehicle._announce = lambda *_: None  # the heartbeat of the own autopilot
    array = common.MAVLink_debug_float_array_message(5, b"uwb", 1, [1.5, math.nan, *[0.0] * 56])
    foreign = common.MAVLink_heartbeat_message(0, 0, 0, 0, 0, 3)
    bench.step()
    bench.step(distance(0, 100), array, foreign)
    bench.step(steps=3)
    kinds = [(time_us, message.get_msgId()) for time_us, message in listener.seen]
    assert kinds == [(2 * STEP_US, DISTANCE), (2 * STEP_US, ARRAY)]
    assert listener.seen[1][1].data[0] == 1.5
