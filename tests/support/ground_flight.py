"""One vehicle in this process whose MAVLink is over its radio or modem, and a scripted ground station."""

import contextlib

import msgspec
from paths import SCENARIOS
from pymavlink.dialects.v20 import common

from autopilot.commander.failsafe import Cause
from autopilot.mavlink.codec import Encoder
from autopilot.parameters.config import VehicleConfig
from harness.launch.in_process_flight import InProcessFlight
from harness.launch.one_process import RUN_ID
from harness.records.run_folder import PhysicsConfig, RunFolder
from harness.scenario.scenario_file import load
from netsim.wire.messages import TxBatch

SECOND_US = 1_000_000
GROUND = 1
"""Station number of the ground station."""


@contextlib.contextmanager
def in_process(folder_path, overrides):
    """Yield the flight of the article's scenario with one vehicle; it is closed afterwards."""
    scenario = load(SCENARIOS / "article.toml", overrides)
    folder = RunFolder(folder_path).create()

    def read(path, kind):
        return msgspec.json.decode(path.read_bytes(), type=kind)

    physics = read(folder.write_physics_config(scenario, run_id=RUN_ID), PhysicsConfig)
    path = folder.write_vehicle_config(scenario, 0, run_id=RUN_ID, simulator_port=0, radio_endpoint=None)
    flown = InProcessFlight(
        physics, folder.radio_config(scenario, run_id=RUN_ID), [read(path, VehicleConfig)],
        emit=lambda *_: None, on_failure=lambda *_: None,
    )  # fmt: skip
    with contextlib.closing(flown):
        yield flown
    folder.release()


class GroundFlight:
    """A flight of `in_process`, and the ground station; ``relay`` makes the items of its radio or modem."""

    def __init__(self, flight, relay):
        self.flight, self.relay = flight, relay
        self._encoder = Encoder(system=255, component=190)
        self.vehicle = flight.links[0].host.vehicle
        advance = flight.emulator.advance

        def observed(request):
            batches = advance(request)
            if GROUND in batches:
                for _, datagram in self.relay.datagrams(batches[GROUND]):
                    self.on_datagram(datagram)
            return batches

        flight.emulator.advance = observed

    def on_datagram(self, datagram):
        """Take a datagram that the ground station has received."""

    @property
    def time_s(self):
        return self.flight.simulation.time_us / SECOND_US

    @property
    def north_m(self):
        return self.flight.simulation.truth.pos_ned_m[0, 0]

    @property
    def link_counts(self):
        return self.flight.links[0].host.link_counts()["ground_station"]

    @property
    def is_lost(self):
        return bool(self.vehicle.flight.causes & int(Cause.GCS_LOST))

    def send(self, message):
        """Send a message of the ground station."""
        self.relay.put(0, self._encoder.encode(message))
        items = tuple(self.relay.take())
        assert len(items) == 1
        assert self.flight.emulator.submit(TxBatch(station=GROUND, now_us=0, items=items))

    def command(self, command, *params):
        """Send a COMMAND_LONG."""
        padded = (*params, *[0.0] * (7 - len(params)))
        self.send(common.MAVLink_command_long_message(1, 1, command, 0, *padded))

    def until(self, condition, limit_s, each_second=lambda: None):
        """Step until the condition holds, with a heartbeat of the station every second."""
        end_us = self.flight.simulation.time_us + round(limit_s * SECOND_US)
        while not condition():
            time_us = self.flight.simulation.time_us
            assert time_us < end_us
            if time_us % SECOND_US == 0:
                self.send(common.MAVLink_heartbeat_message(common.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
                each_second()
            self.flight.simulation.step()

    def begin_mission(self):
        """Request the mission mode and arming, from 6 s on until armed; to be called each second."""
        if not self.vehicle.commander.armed and self.time_s > 6.0:
            self.command(common.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0)
            self.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
