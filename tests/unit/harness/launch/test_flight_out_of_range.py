"""A vehicle that flies out of its ground station's range: loss and return of the link by physics."""

import contextlib

import msgspec
import pytest
from paths import SCENARIOS
from pymavlink.dialects.v20 import common

from autopilot.commander.failsafe import Cause
from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.modes import FlightMode
from autopilot.parameters.config import VehicleConfig
from harness.ground_station.relay import Relay
from harness.launch.in_process_flight import InProcessFlight
from harness.launch.one_process import RUN_ID
from harness.records.run_folder import PhysicsConfig, RunFolder
from harness.scenario.scenario_file import load
from netsim.wire.messages import TxBatch

SECOND_US = 1_000_000
LOSS_S, DELAY_S = 5.0, 1.0
TAKE_OFF = "{command='takeoff', height_m=4.0}"
FAR_AWAY = "{command='waypoint', north_m=300.0, east_m=0.0, height_m=4.0}"
# 10 dBm less 46.8 dB at 1 m and 30 dB a decade are -82 dBm, radio.cca_preamble_dbm, at 32 m
RANGE_M = 32.0
OVERRIDES = [
    "agents=1", "formation.columns=1", "formation.rows=1", "onboard.enabled=false", "wind.mean_n=0",
    "links.telemetry=radio", "stations=[{name='ground', pos_ned_m=[-15.0, 0.0, 0.0]}]",
    "radio.path_loss_exponent=3.0", "radio.tx_power_dbm=10.0", "radio.data_mode=ofdm6",
    "autopilot.params.NAV_DLL_ACT=2", f"autopilot.params.COM_DL_LOSS_T={LOSS_S}",
    f"autopilot.params.COM_FAIL_ACT_T={DELAY_S}", "autopilot.params.RTL_RETURN_ALT=4",
    "autopilot.params.MPC_XY_CRUISE=10",
    f"autopilot.mission=[{TAKE_OFF}, {FAR_AWAY}]",
]  # fmt: skip


class Flight:
    """One vehicle in this process, and a scripted ground station."""

    def __init__(self, flight):
        self._flight = flight
        self._relay, self._encoder = Relay(1), Encoder(system=255, component=190)
        self.vehicle = flight.links[0].host.vehicle

    @property
    def time_s(self):
        return self._flight.simulation.time_us / SECOND_US

    @property
    def north_m(self):
        return self._flight.simulation.truth.pos_ned_m[0, 0]

    @property
    def received(self):
        return self.frames["received"]

    @property
    def frames(self):
        return self._flight.links[0].host.link_counts()["ground_station"]["frames"]["ground"]

    @property
    def is_lost(self):
        return bool(self.vehicle.flight.causes & int(Cause.GCS_LOST))

    def send(self, message):
        frame = self._relay.frame(0, self._encoder.encode(message))
        assert self._flight.emulator.submit(TxBatch(station=1, now_us=0, items=(frame,)))

    def command(self, command, *params):
        padded = (*params, *[0.0] * (7 - len(params)))
        self.send(common.MAVLink_command_long_message(1, 1, command, 0, *padded))

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


@pytest.fixture
def flight(tmp_path):
    scenario = load(SCENARIOS / "article.toml", OVERRIDES)
    folder = RunFolder(tmp_path / "run").create()

    def read(path, kind):
        return msgspec.json.decode(path.read_bytes(), type=kind)

    physics = read(folder.write_physics_config(scenario, run_id=RUN_ID), PhysicsConfig)
    path = folder.write_vehicle_config(scenario, 0, run_id=RUN_ID, simulator_port=0, radio_endpoint=None)
    flown = InProcessFlight(
        physics, folder.radio_config(scenario, run_id=RUN_ID), [read(path, VehicleConfig)],
        emit=lambda *_: None, on_failure=lambda *_: None,
    )  # fmt: skip
    with contextlib.closing(flown):
        yield Flight(flown)
    folder.release()


def test_a_vehicle_out_of_range_returns_and_the_link_with_it(flight):
    commander = flight.vehicle.commander

    def begin_mission():
        if not commander.armed and flight.time_s > 6.0:
            flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0)
            flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    flight.until(lambda: commander.armed, 20.0, begin_mission)
    assert not flight.is_lost
    assert flight.frames["lost"] == 0
    flight.until(lambda: flight.is_lost, 30.0)
    lost_s, known = flight.time_s, flight.received
    # at 10 m/s or less, the last heartbeat having been received up to a second before the range's end
    assert RANGE_M - 15.0 < flight.north_m < RANGE_M - 15.0 + 10.0 * (LOSS_S + 2.0)
    assert flight.frames["lost"] > 100  # telemetry does not get through either
    flight.until(lambda: commander.mode is FlightMode.RETURN, 5.0)
    assert flight.time_s - lost_s == pytest.approx(DELAY_S, abs=0.2)
    farthest_m = flight.north_m
    flight.until(lambda: not flight.is_lost, 30.0)
    assert flight.received == known + 1  # the first heartbeat that arrives
    assert flight.north_m < farthest_m
    # PX4: a link that is there again leaves the return in effect, until another mode is requested
    acknowledged = flight.frames["acknowledged"]
    flight.until(lambda: flight.received >= known + 3, 10.0)
    assert commander.mode is FlightMode.RETURN
    assert flight.frames["acknowledged"] > acknowledged
    flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0)
    flight.until(lambda: commander.mode is FlightMode.HOLD, 2.0)
    assert not commander.failsafe
