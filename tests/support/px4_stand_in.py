"""A stand-in for PX4's side of its simulator API, for tests without a PX4.

It reproduces the observed behaviour of a PX4 v1.17: it tries to connect until the simulator listens; it sends
one COMMAND_LONG SET_MESSAGE_INTERVAL and one HEARTBEAT, in either order; it receives sensors without an
answer while it starts, for a wall time of its own; then it sends one HIL_ACTUATOR_CONTROLS for every
HIL_SENSOR, with the same time stamp, sometimes late, and nothing else. Its command line is PX4's:

    STAND_IN='{"seed": 3}' px4 -i 0 -d ETC -w WORK [--tcp 4560 --gcs 18570:14550 --companion 14580:14540]

With ``"flies": true`` the answers are computed by coflight's own autopilot, a process behind it with PX4's
ports and no on-board application. Otherwise the motors turn at a constant speed after arming.
"""

import argparse
import contextlib
import json
import os
import random
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Encoder, Parser
from harness.launch.px4_parameters import SIMULATION_PARAMETERS

STEP_S = 0.004
FIRST_STEPS = (13, 54)
CUSTOM_MODE, ARMED = 1, 128
LOCKSTEP = 1
RETRY_S = 0.05
PARAMETER = "PX4_PARAM_"


@dataclass
class Manners:
    """Behaviour of a stand-in: the content of the environment variable ``STAND_IN``."""

    seed: int = 0
    late: dict[int, float] = field(default_factory=dict)
    """Delays in s, by the number of the answer from 0."""
    late_every: int = 0
    late_s: float = 0.2
    lost: tuple[int, ...] = ()
    """Numbers of the answers that are not sent."""
    mute_from: int | None = None
    armed_from: int = 100
    flies: bool = False


class StandIn:
    """One PX4; `run` returns when the simulator closes the connection."""

    def __init__(self, instance: int, port: int, manners: Manners) -> None:
        self.system = instance + 1
        self.port = port
        self.manners = manners
        self.sensors: list[int] = []
        """Times of all received HIL_SENSOR, us."""
        self.first_answered: int | None = None
        """Number of HIL_SENSOR before the first answered one."""
        self.answered = 0
        self.connection: socket.socket | None = None
        self._rng = random.Random(manners.seed)  # noqa: S311
        self._parser = Parser()
        self._encoder = Encoder(system=self.system, component=1)
        self.silence_s = self._rng.randint(*FIRST_STEPS) * STEP_S

    def connect(self, wall_limit_s: float = 30.0) -> None:
        deadline_s = time.monotonic() + wall_limit_s
        while True:
            try:
                self.connection = socket.create_connection(("127.0.0.1", self.port), timeout=wall_limit_s)
                break
            except ConnectionRefusedError:
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(RETRY_S)
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.connection.settimeout(None)
        words = [
            mavlink.MAVLink_command_long_message(0, 0, 511, 0, 115.0, 5000.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            mavlink.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3),
        ]
        self._rng.shuffle(words)
        for word in words:
            self.connection.sendall(self._encoder.encode(word))

    def run(self) -> None:
        """Receive sensors and answer them with `fly`."""
        assert self.connection is not None
        frames = b""
        ready_s: float | None = None
        with contextlib.suppress(OSError):
            while data := self.connection.recv(65_536):
                for message in self._parser.push(data):
                    frames += bytes(message.get_msgbuf())
                    if message.get_type() != "HIL_SENSOR" or message.id != 0:
                        continue
                    self.sensors.append(message.time_usec)
                    # start-up takes wall time from the first sensors on, at any rate of these
                    ready_s = ready_s or time.monotonic() + self.silence_s
                    if time.monotonic() >= ready_s:
                        self._answer(message, frames)
                    frames = b""

    def _answer(self, sensor: mavlink.MAVLink_hil_sensor_message, frames: bytes) -> None:
        number, manners = self.answered, self.manners
        self.answered += 1
        if self.first_answered is None:
            self.first_answered = len(self.sensors) - 1
        answer = self.fly(sensor, frames)
        if number in manners.lost or (manners.mute_from is not None and number >= manners.mute_from):
            return
        late_s = manners.late.get(number, 0.0)
        if manners.late_every and number % manners.late_every == manners.late_every - 1:
            late_s = manners.late_s
        time.sleep(late_s)
        assert self.connection is not None
        self.connection.sendall(answer)

    def fly(self, sensor: mavlink.MAVLink_hil_sensor_message, frames: bytes) -> bytes:  # noqa: ARG002
        """Return HIL_ACTUATOR_CONTROLS as bytes; ``frames`` are all bytes received up to the sensors."""
        armed = self.answered > self.manners.armed_from
        controls = [0.6] * 4 + [0.0] * 12 if armed else [0.0] * 16
        mode = CUSTOM_MODE | (ARMED if armed else 0)
        return self._encoder.encode(
            mavlink.MAVLink_hil_actuator_controls_message(sensor.time_usec, controls, mode, LOCKSTEP)
        )

    def close(self) -> None:
        if self.connection is not None:
            with contextlib.suppress(OSError):
                self.connection.shutdown(socket.SHUT_RDWR)
            self.connection.close()


class FlyingStandIn(StandIn):
    """A stand-in in front of coflight's own autopilot."""

    def __init__(
        self, instance: int, port: int, manners: Manners, *, work: Path, gcs: str, companion: str
    ) -> None:
        super().__init__(instance, port, manners)
        with socket.create_server(("127.0.0.1", 0)) as server:
            config = self._config(instance, server.getsockname()[1], gcs, companion)
            path = work / "autopilot.json"
            path.write_text(json.dumps(config), encoding="ascii")
            # in the same process group, which is ended with the run
            subprocess.Popen([sys.executable, "-P", "-m", "autopilot", "--config", str(path)])
            self._autopilot, _ = server.accept()
        self._autopilot.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._autopilot_parser = Parser()

    def _config(self, instance: int, port: int, gcs: str, companion: str) -> dict[str, object]:
        (gcs_local, gcs_remote), (local, remote) = (each.split(":") for each in (gcs, companion))
        params = {
            name.removeprefix(PARAMETER): float(value)
            for name, value in os.environ.items()
            if name.startswith(PARAMETER)
            and not name.endswith("DRIFT")  # this and the next are used by PX4's estimator alone
            and name.removeprefix(PARAMETER) not in SIMULATION_PARAMETERS
        }
        return {
            "run_id": "px4",
            "instance": instance,
            "seed": 0,
            "ports": {
                "simulator_tcp": port,
                "gcs_local_udp": int(gcs_local),
                "gcs_remote_udp": int(gcs_remote),
                "companion_local_udp": int(local),
                "companion_remote_udp": int(remote),
            },
            "devices": {"gps_delay_s": params.pop("EKF2_GPS_DELAY") * 1e-3},
            "autopilot": {"params": params},
            "onboard": {"enabled": False},
            "places_ned_m": [[0.0, 0.0, 0.0]] * (instance + 1),
        }

    def fly(self, sensor: mavlink.MAVLink_hil_sensor_message, frames: bytes) -> bytes:
        self._autopilot.sendall(frames)
        while data := self._autopilot.recv(65_536):
            for message in self._autopilot_parser.push(data):
                if message.get_type() == "HIL_ACTUATOR_CONTROLS" and message.time_usec == sensor.time_usec:
                    return bytes(message.get_msgbuf())
        sys.exit("px4: its autopilot has ended")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("-i", dest="instance", type=int, required=True)
    parser.add_argument("-d", dest="etc", type=Path, required=True)
    parser.add_argument("-w", dest="work", type=Path, required=True)
    parser.add_argument("--tcp", type=int)
    parser.add_argument("--gcs")
    parser.add_argument("--companion")
    arguments = parser.parse_args()
    i = arguments.instance
    arguments.tcp = arguments.tcp or 4560 + i
    arguments.gcs = arguments.gcs or f"{18570 + i}:14550"
    arguments.companion = arguments.companion or f"{14580 + i}:{14540 + i}"
    manners = Manners(**json.loads(os.environ.get("STAND_IN", "{}")))
    if not arguments.etc.is_dir():
        sys.exit(f"px4: no {arguments.etc}")
    if manners.flies:
        px4: StandIn = FlyingStandIn(
            arguments.instance, arguments.tcp, manners,
            work=arguments.work, gcs=arguments.gcs, companion=arguments.companion,
        )  # fmt: skip
    else:
        px4 = StandIn(arguments.instance, arguments.tcp, manners)
    px4.connect()
    sys.stdout.write(f"px4 {arguments.instance} started\n")
    px4.run()
    # without its simulator a PX4 prints this line each second and does not end
    while True:
        sys.stdout.write("poll timeout 0, 22\n")
        sys.stdout.flush()
        time.sleep(1.0)


if __name__ == "__main__":
    main()
