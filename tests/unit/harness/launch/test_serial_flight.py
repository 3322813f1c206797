"""Telemetry over serial modems in one process: rates, flow control, loss of the link by range."""

import contextlib

import msgspec
import pytest
from paths import SCENARIOS
from pymavlink.dialects.v20 import common

from autopilot.commander.failsafe import Cause
from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.modes import FlightMode
from autopilot.mavlink.serial_carrier import MODEM_COMPONENT, MODEM_SYSTEM
from autopilot.parameters.config import VehicleConfig
from autopilot.services.flow_control import BYTES_S
from autopilot.services.service import GROUND_STATION
from harness.ground_station.serial_relay import SerialRelay
from harness.launch.in_process_flight import InProcessFlight
from harness.launch.one_process import RUN_ID
from harness.records.run_folder import PhysicsConfig, RunFolder
from harness.scenario.scenario_file import load
from netsim.wire.messages import TxBatch

SECOND_US = 1_000_000
GROUND = 1
"""Station number of the ground station."""
LINK_BYTES_S = 3_300
"""More than one modem of 64 kbit/s transports of short MAVLink frames (docs/concepts/radio.md)."""
LOSS_S, DELAY_S = 5.0, 1.0
RANGE_M = 30.6
"""Where 0 dBm less 31.7 dB at 1 m and 50 dB a decade are -106 dBm, the sensitivity at 64 kbit/s."""
BEHIND_M = 15.0
SERIAL = [
    "agents=1", "formation.columns=1", "formation.rows=1", "onboard.enabled=false", "wind.mean_n=0",
    "links.telemetry=serial-radio", f"stations=[{{name='ground', pos_ned_m=[{-BEHIND_M}, 0.0, 0.0]}}]",
]  # fmt: skip
TAKE_OFF = "{command='takeoff', height_m=4.0}"
FAR_AWAY = "{command='waypoint', north_m=300.0, east_m=0.0, height_m=4.0}"
OUT_OF_RANGE = [
    "radio.path_loss_exponent=5.0", "serial_radio.tx_power_dbm=0.0", "autopilot.params.NAV_DLL_ACT=2",
    f"autopilot.params.COM_DL_LOSS_T={LOSS_S}", f"autopilot.params.COM_FAIL_ACT_T={DELAY_S}",
    "autopilot.params.RTL_RETURN_ALT=4", "autopilot.params.MPC_XY_CRUISE=10",
    f"autopilot.mission=[{TAKE_OFF}, {FAR_AWAY}]",
]  # fmt: skip


class SerialFlight:
    """One vehicle in this process, and a scripted ground station."""

    def __init__(self, flight):
        self._flight = flight
        self._relay, self._encoder = SerialRelay(1), Encoder(system=255, component=190)
        self._parser = Parser()
        self.vehicle = flight.links[0].host.vehicle
        self.received = []
        """Messages that the ground station has received."""
        advance = flight.emulator.advance

        def observed(request):
            batches = advance(request)
            if GROUND in batches:
                for _, datagram in self._relay.datagrams(batches[GROUND].items):
                    self.received += self._parser.push(datagram)
            return batches

        flight.emulator.advance = observed

    @property
    def time_s(self):
        return self._flight.simulation.time_us / SECOND_US

    @property
    def north_m(self):
        return self._flight.simulation.truth.pos_ned_m[0, 0]

    @property
    def is_lost(self):
        return bool(self.vehicle.flight.causes & int(Cause.GCS_LOST))

    @property
    def counts(self):
        return self._flight.links[0].host.link_counts()["ground_station"]["serial"]["ground"]

    @property
    def ground_bytes(self):
        return self._relay.counts["uav 0"]["received_bytes"]

    def count(self, kind):
        return sum(message.get_type() == kind for message in self.received)

    def command(self, command, *params):
        padded = (*params, *[0.0] * (7 - len(params)))
        self.send(common.MAVLink_command_long_message(1, 1, command, 0, *padded))

    def send(self, message):
        item = self._relay.frame(0, self._encoder.encode(message))
        assert self._flight.emulator.submit(TxBatch(station=GROUND, now_us=0, items=(item,)))

    def until(self, condition, limit_s, each_second=lambda: None):
        """Step until the condition holds, with a heartbeat of the station every second."""
        end_us = self._flight.simulation.time_us + round(limit_s * SECOND_US)
        while not condition():
            time_us = self._flight.simulation.time_us
            assert time_us < end_us
            if time_us % SECOND_US == 0:
                self.send(common.MAVLink_heartbeat_message(common.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
                each_second()
            self._flight.simulation.step()

    def run(self, seconds, each_second=lambda: None):
        end_s = self.time_s + seconds
        self.until(lambda: self.time_s >= end_s, seconds + 1.0, each_second)


@pytest.fixture
def fly(tmp_path):
    with contextlib.ExitStack() as stack:

        def start(*overrides):
            scenario = load(SCENARIOS / "article.toml", [*SERIAL, *overrides])
            folder = RunFolder(tmp_path / "run").create()
            stack.callback(folder.release)

            def read(path, kind):
                return msgspec.json.decode(path.read_bytes(), type=kind)

            physics = read(folder.write_physics_config(scenario, run_id=RUN_ID), PhysicsConfig)
            path = folder.write_vehicle_config(
                scenario, 0, run_id=RUN_ID, simulator_port=0, radio_endpoint=None
            )
            flown = InProcessFlight(
                physics, folder.radio_config(scenario, run_id=RUN_ID), [read(path, VehicleConfig)],
                emit=lambda *_: None, on_failure=lambda *_: None,
            )  # fmt: skip
            stack.enter_context(contextlib.closing(flown))
            return SerialFlight(flown)

        yield start


def test_telemetry_keeps_to_the_data_rate_of_a_telemetry_port(fly):
    flight = fly()
    flight.run(5.0)
    bytes_before, heartbeats = flight.ground_bytes, flight.count("HEARTBEAT")
    flight.run(10.0)
    rate_bytes_s = (flight.ground_bytes - bytes_before) / 10.0
    assert 0.5 * BYTES_S < rate_bytes_s < 1.2 * BYTES_S
    assert flight.count("HEARTBEAT") - heartbeats in range(9, 12)
    # both modems report after the heartbeats of their hosts
    reports = [message for message in flight.received if message.get_type() == "RADIO_STATUS"]
    assert len(reports) >= 13
    assert {(each.get_srcSystem(), each.get_srcComponent()) for each in reports} == {
        (MODEM_SYSTEM, MODEM_COMPONENT)
    }
    assert min(each.rssi for each in reports) > max(each.noise for each in reports)
    assert flight.counts["radio_status"] >= 13


def test_streams_adapt_to_a_link_that_is_slower_than_they_are(fly):
    flight = fly("links.bandwidth_bytes_s=20000")
    streams = flight.vehicle.messaging.streams[GROUND_STATION]
    for kind in (30, 31, 32, 33, 83, 85):
        assert streams.set_interval(kind, 20_000, 0)
    assert sum(streams.needs_bytes_s) > 4 * LINK_BYTES_S
    factors, lost = [], []

    def note():
        factors.append(streams.rate_factor)
        lost.append(flight.is_lost)

    flight.run(20.0, note)
    sent, received, heartbeats = flight.counts["sent_bytes"], flight.ground_bytes, flight.count("HEARTBEAT")
    flight.run(20.0, note)
    assert max(factors[:2]) == 1.0
    assert max(factors[20:]) < 0.5
    sent_bytes_s, received_bytes_s = (
        (flight.counts["sent_bytes"] - sent) / 20,
        (flight.ground_bytes - received) / 20,
    )
    assert 0.7 * LINK_BYTES_S < received_bytes_s < LINK_BYTES_S
    assert sent_bytes_s == pytest.approx(received_bytes_s, rel=0.1)
    assert flight.count("HEARTBEAT") - heartbeats >= 15
    assert not any(lost[3:])


def test_a_vehicle_out_of_range_of_its_modem_returns(fly):
    flight = fly(*OUT_OF_RANGE)
    commander = flight.vehicle.commander

    def begin_mission():
        if not commander.armed and flight.time_s > 6.0:
            flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0)
            flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    flight.until(lambda: commander.armed, 20.0, begin_mission)
    assert not flight.is_lost
    flight.until(lambda: flight.is_lost, 30.0)
    lost_s = flight.time_s
    # at 10 m/s or less; 1 s of heartbeats and 1 dB of range
    assert RANGE_M - BEHIND_M - 2.0 < flight.north_m < RANGE_M - BEHIND_M + 10.0 * (LOSS_S + 2.0)
    flight.until(lambda: commander.mode is FlightMode.RETURN, 5.0)
    assert flight.time_s - lost_s == pytest.approx(DELAY_S, abs=0.2)
    flight.until(lambda: not flight.is_lost, 60.0)
    assert commander.mode is FlightMode.RETURN
