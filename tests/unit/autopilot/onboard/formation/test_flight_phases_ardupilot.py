"""Phases of a flight beside an ArduPilot: guided mode before arming, no setpoint before the formation."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from autopilot.estimation.atmosphere import pressure_pa
from autopilot.mavlink.modes import FlightMode
from autopilot.onboard.client.autopilots import ARDUPILOT, PX4
from autopilot.onboard.client.commands import CommandSender
from autopilot.onboard.client.own_state import OwnState
from autopilot.onboard.client.take_off import HAND_OVER_HEIGHT_M, READY_TIMEOUT_US
from autopilot.onboard.formation.flight_phases import (
    HEARTBEAT_LAG_US,
    TAKE_OFF_HEIGHT_M,
    FlightSequence,
    Situation,
)
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.parameters.config import Site

SITE = Site()
STABILIZE, GUIDED, RTL, LAND, BRAKE = 0, 4, 6, 9, 17
SET_MODE, ARM, TAKE_OFF = (
    mavlink.MAV_CMD_DO_SET_MODE,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_NAV_TAKEOFF,
)
NEAR = Situation(shape_std_m=0.0, miss_m=0.1, place_height_m=10.0)
FAR = Situation(shape_std_m=0.0, miss_m=9.0, place_height_m=10.0)


class Bench:
    """A flight sequence with an ArduPilot whose state the test sets; 20 ms a step."""

    def __init__(self, autopilot=ARDUPILOT):
        self.own = OwnState(site=SITE, gps_delay_s=0.1, autopilot=autopilot)
        self.commands = CommandSender(target_system=1)
        self.flight = FlightSequence(
            commands=self.commands, on_station_tolerance_m=0.5, on_station_hold_s=1.0, held=False,
            shortfall=lambda _: "", autopilot=autopilot,
        )  # fmt: skip
        self.now_us = 1_000_000
        self.mode, self.armed, self.ready, self.status = STABILIZE, False, True, mavlink.MAV_STATE_STANDBY
        self.height_m = 0.0
        """Approached at 1 m/s."""
        self._flown_m = 0.0
        self.sent = []

    def step(self, situation=FAR, *, answers=mavlink.MAV_RESULT_ACCEPTED, count=1):
        for _ in range(count):
            self.now_us += 20_000
            boot_ms, own = self.now_us // 1_000, self.own
            moved_m = max(-0.02, min(0.02, self.height_m - self._flown_m))
            self._flown_m += moved_m
            position = (0.0, 0.0, -self._flown_m, 0.0, 0.0, -moved_m / 0.02)
            own.on_local_position(mavlink.MAVLink_local_position_ned_message(boot_ms, *position), self.now_us)
            base = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
            own.on_heartbeat(
                mavlink.MAVLink_heartbeat_message(2, 3, base, self.mode, self.status, 3), self.now_us
            )
            bit = mavlink.MAV_SYS_STATUS_PREARM_CHECK
            own.on_status(mavlink.MAVLink_sys_status_message(bit, bit, bit * self.ready, *[0] * 10))
            lat, lon, alt = (
                round(SITE.latitude_deg * 1e7), round(SITE.longitude_deg * 1e7), round(SITE.altitude_m * 1e3),
            )  # fmt: skip
            own.on_origin(mavlink.MAVLink_gps_global_origin_message(lat, lon, alt, 0))
            own.on_gps(mavlink.MAVLink_gps_raw_int_message(self.now_us, 3, lat, lon, alt, 90, 140, 0, 0, 10))
            self.flight.update(own, situation, self.now_us)
            for message in self.commands.on_timer(self.now_us):
                self.sent.append(message)
                self.commands.on_ack(
                    mavlink.MAVLink_command_ack_message(message.command, answers), self.now_us
                )

    def fly(self):
        """Fly until the application controls the vehicle."""
        self.step(count=3)
        self.mode = GUIDED
        self.step(count=3)
        self.armed = True
        self.step(count=3)
        self.height_m, self.status = 1.0, mavlink.MAV_STATE_ACTIVE
        self.step(count=60)
        assert self.flight.phase is FlightPhase.JOINING

    def numbers(self):
        return [message.command for message in self.sent]


def test_guided_mode_is_commanded_and_seen_before_arming():
    bench = Bench()
    bench.step(count=100)  # accepted, but not in a HEARTBEAT
    assert set(bench.numbers()) == {SET_MODE}
    first = bench.sent[0]
    assert (first.param1, first.param2, first.target_component) == (1.0, GUIDED, 1)
    bench.mode = GUIDED
    bench.step(count=2)
    assert bench.numbers()[-1] == ARM


def test_arming_waits_for_the_pre_arm_checks_and_for_no_longer_than_its_limit():
    bench = Bench()
    bench.ready = False
    bench.step(count=READY_TIMEOUT_US // 20_000 - 10)
    assert bench.sent == []
    assert bench.flight.phase is FlightPhase.ARMING
    bench.step(count=20)
    assert bench.numbers() == [SET_MODE]


def test_a_refused_arming_is_repeated_each_second_and_never_the_take_off_commanded():
    bench = Bench()
    bench.mode = GUIDED
    bench.step(answers=mavlink.MAV_RESULT_FAILED, count=500)
    assert set(bench.numbers()) == {ARM}
    assert len(bench.sent) == pytest.approx(10, abs=1)
    assert bench.flight.phase is FlightPhase.ARMING


def test_no_setpoint_is_sent_before_the_application_takes_over():
    """A setpoint would end ArduPilot's take-off on the ground."""
    bench = Bench()
    assert not bench.flight.needs_setpoint
    bench.step(count=3)
    bench.mode = GUIDED
    phases = set()
    for _ in range(50):
        bench.armed |= bench.flight.phase is FlightPhase.TAKE_OFF
        bench.step()
        phases.add(bench.flight.phase)
        assert not bench.flight.needs_setpoint
    assert phases == {FlightPhase.ARMING, FlightPhase.TAKE_OFF}
    bench.height_m = HAND_OVER_HEIGHT_M + 0.1
    bench.step(count=40)
    assert bench.flight.phase is FlightPhase.JOINING
    assert bench.flight.needs_setpoint


@pytest.mark.parametrize("place_height_m", [1.5, 10.0])
def test_the_take_off_is_commanded_once_with_its_height_above_the_ground(place_height_m):
    bench = Bench()
    bench.mode = GUIDED
    situation = Situation(shape_std_m=0.0, miss_m=9.0, place_height_m=place_height_m)
    bench.step(situation, count=3)
    bench.armed = True
    bench.step(situation, count=100)
    take_offs = [message for message in bench.sent if message.command == TAKE_OFF]
    assert [message.param7 for message in take_offs] == [min(TAKE_OFF_HEIGHT_M, place_height_m)]
    # ArduPilot has no use for the position and yaw, which PX4 is not given by NaN
    assert not any(math.isnan(getattr(take_offs[0], f"param{i}")) for i in range(1, 8))


def test_a_vehicle_that_disarms_on_the_ground_is_armed_again():
    """ArduPilot disarms after some seconds at rest."""
    bench = Bench()
    bench.mode = GUIDED
    bench.step(count=3)
    bench.armed = True
    bench.step(count=3)
    bench.armed = False
    bench.step(count=HEARTBEAT_LAG_US // 20_000 + 5)
    assert bench.numbers().count(ARM) == 2


def test_it_is_on_station_after_the_hold_and_yields_to_other_modes():
    bench = Bench()
    bench.fly()
    bench.step(NEAR, count=60)
    assert bench.flight.phase is FlightPhase.ON_STATION
    bench.mode = LAND
    bench.step(NEAR, count=2)
    assert bench.flight.phase is FlightPhase.YIELDED
    assert not bench.flight.needs_setpoint
    assert bench.flight.texts == ["offboard left: yielding"]
    sent = len(bench.sent)
    bench.armed = False
    bench.step(NEAR, count=HEARTBEAT_LAG_US // 20_000 + 5)
    assert bench.flight.phase is FlightPhase.LANDED
    bench.mode, bench.armed = GUIDED, True
    bench.step(NEAR, count=200)
    assert bench.flight.phase is FlightPhase.LANDED  # left to the ground station
    assert len(bench.sent) == sent
    assert not bench.flight.needs_setpoint


@pytest.mark.parametrize("mode", [RTL, BRAKE, STABILIZE, 999])
def test_guided_mode_by_a_ground_station_returns_it_to_its_place(mode):
    bench = Bench()
    bench.fly()
    bench.mode = mode
    bench.step(count=2)
    assert bench.flight.phase is FlightPhase.YIELDED
    bench.mode = GUIDED
    bench.step(count=2)
    assert bench.flight.phase is FlightPhase.JOINING


def test_a_failsafe_of_a_flying_vehicle_yields():
    bench = Bench()
    bench.fly()
    bench.status = mavlink.MAV_STATE_CRITICAL
    bench.step(count=2)
    assert bench.flight.phase is FlightPhase.YIELDED
    assert bench.flight.texts == ["failsafe: yielding"]


def test_px4_follows_setpoints_before_its_mode_changes():
    bench = Bench(PX4)
    bench.step(count=3)
    assert bench.flight.phase in {FlightPhase.ARMING, FlightPhase.TAKE_OFF}
    assert bench.flight.needs_setpoint
    assert bench.numbers()[0] == ARM


def test_the_height_follows_the_pressure_beside_an_ardupilot():
    own = OwnState(site=SITE, gps_delay_s=0.1, autopilot=ARDUPILOT)
    for time_ms in range(1_000, 60_000, 20):
        down_m = -0.05 * (time_ms - 1_000) * 1e-3  # the estimate drifts up by 3 m
        own.on_local_position(
            mavlink.MAVLink_local_position_ned_message(time_ms, 0.0, 0.0, down_m, 0.0, 0.0, -0.05),
            time_ms * 1_000,
        )
        own.on_heartbeat(mavlink.MAVLink_heartbeat_message(2, 3, 128, 4, 4, 3), time_ms * 1_000)
        if time_ms % 100 == 0:
            hpa = pressure_pa(SITE.altitude_m + 0.01 * (time_ms % 200 == 0)) / 100.0
            own.on_pressure(mavlink.MAVLink_scaled_pressure_message(time_ms, hpa, 0.0, 2_500))
    assert own.odometry_ned_m[2] == pytest.approx(0.0, abs=0.1)
    assert own.mode is FlightMode.OFFBOARD


@pytest.mark.parametrize("hpa", [0.0, -5.0])
def test_a_pressure_that_is_none_is_ignored(hpa):
    own = OwnState(site=SITE, gps_delay_s=0.1, autopilot=ARDUPILOT)
    own.on_local_position(
        mavlink.MAVLink_local_position_ned_message(1_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1_000_000
    )
    own.on_pressure(mavlink.MAVLink_scaled_pressure_message(1_000, hpa, 0.0, 2_500))
    assert own.odometry_ned_m == (0.0, 0.0, 0.0)
