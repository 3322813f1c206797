"""A vehicle's process with a simulator that sends sensor data at rest, and the ports of its links."""

import contextlib
import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import Self

import msgspec
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.hil import HilActuatorControls, HilParser
from autopilot.parameters.config import VehicleConfig, VehiclePorts
from autopilot.parameters.onboard_config import OnboardConfig

STEP_US = 4_000
DEADLINE_S = 30.0


def config(**changes):
    """Return the settings of a vehicle without an application."""
    given = {"run_id": "test", "instance": 0, "seed": 7, "places_ned_m": ((0.0, 0.0, -5.0),)}
    return VehicleConfig(**{**given, "onboard": OnboardConfig(enabled=False), **changes})


class VehicleProcess:
    """A started ``python -m autopilot`` on free ports, without default partners."""

    def __init__(self, folder: Path, **changes) -> None:
        self._stack = contextlib.ExitStack()
        listener = self._stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        listener.settimeout(DEADLINE_S)
        self.simulator_address = listener.getsockname()
        ports = VehiclePorts(
            simulator_tcp=self.simulator_address[1],
            gcs_local_udp=0,
            gcs_remote_udp=0,
            companion_local_udp=0,
            companion_remote_udp=0,
        )
        path = folder / "uav-0.json"
        path.write_bytes(msgspec.json.encode(config(ports=ports, **changes)))
        command = [sys.executable, "-P", "-m", "autopilot", "--config", str(path)]
        self._process = self._stack.enter_context(
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        )
        self._stack.callback(self._process.kill)
        self._connection, _ = listener.accept()
        self._stack.enter_context(self._connection)
        self._connection.settimeout(DEADLINE_S)
        self._encoder, self._parser = Encoder(system=0, component=1), HilParser(HilActuatorControls)
        self._now_us = 0
        self.ports: dict[str, int] = json.loads(self._process.stdout.readline())["details"]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def step(self) -> HilActuatorControls:
        """Make one step and return the answer."""
        self._now_us += STEP_US
        sensors = common.MAVLink_hil_sensor_message(
            self._now_us, 0.0, 0.0, -9.81, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 955.0, 0.0, 488.0, 20.0, 0x1FFF
        )
        self._connection.sendall(self._encoder.encode(sensors))
        while True:
            for message in self._parser.push(self._connection.recv(4096)):
                if isinstance(message, HilActuatorControls) and message.time_usec == self._now_us:
                    return message

    def finish(self) -> dict[str, object]:
        """Close the connection and return the details of the process's last event."""
        self._connection.close()
        events = map(json.loads, self._process.stdout)
        details = next(event["details"] for event in events if event["event"] == "finished")
        assert self._process.wait(DEADLINE_S) == 0
        return details
