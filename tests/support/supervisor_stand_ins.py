"""Stand-ins for a swarm's processes, as ``python supervisor_stand_ins.py MODULE --config FILE ...``.

They follow the protocol of the real processes without a simulation: vehicles rise at 1 m/s and are formed at
3 s. The name of the scenario selects a fault of physics, the seed one of the radio, a parameter one of a
vehicle.
"""

import argparse
import json
import os
import queue
import signal
import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from foundation.processes.child_protocol import Finished, Ready, Stop, commands, emit, end_with_parent
from foundation.processes.prefork import serve
from harness.simulator.messages import (
    AnyCommand,
    Formed,
    Pause,
    Paused,
    Progress,
    RunUntil,
    SetAttenuation,
    SetPid,
    SetRadioPid,
    VehicleLost,
    VehicleTruth,
    Waiting,
)

STEP_US = 4_000
FORMED_US = 3_000_000
ENDLESS_US = 1_020_000
"""Simulated time that the scenario ``endless`` does not exceed."""
SEED_RADIO_DIES = 1_300
"""With this seed the radio is killed at its stop command; with the next one it ends without `Finished`."""
FAILS_AT_LAST_M = 10.0
"""Takeoff altitude with which vehicle 0 is killed when its simulator closes the connection."""


def complain(line: str) -> None:
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def vehicle(time_us: int, *, alive: bool) -> VehicleTruth:
    return VehicleTruth(
        alive=alive,
        armed=True,
        mode="offboard",
        phase="on station" if time_us >= FORMED_US else "climb",
        pos_ned_m=(0.0, 0.0, -time_us * 1e-6),
        vel_ned_m_s=(0.0, 0.0, -1.0),
        q_ned_frd=(1.0, 0.0, 0.0, 0.0),
        error_m=0.25,
    )


def physics(
    config: dict[str, Any], connections: dict[int, socket.socket], listeners: dict[int, socket.socket]
) -> None:
    inbox: queue.SimpleQueue[AnyCommand] = queue.SimpleQueue()
    commands(AnyCommand, inbox)  # type: ignore[arg-type]
    fault = config["scenario"]["name"]
    emit(Ready(name="physics", pid=os.getpid()))
    vehicles: dict[int, socket.socket] = {}
    lost: set[int] = set()
    time_us = 0
    while not isinstance(command := inbox.get(), Stop):
        match command:
            case SetPid() | SetRadioPid() | SetAttenuation() | Pause():
                complain(f"command {command}")
                continue
            case RunUntil(time_us=end_us):
                pass
        while fault == "never-connects" and inbox.empty():
            emit(Waiting(time_us=time_us))
            time.sleep(0.1)
        if not vehicles:
            vehicles = connections | {i: listener.accept()[0] for i, listener in listeners.items()}
        reason = "time"
        while time_us < end_us and inbox.empty():
            for i in vehicles.keys() - lost:
                try:
                    gone = vehicles[i].recv(1, socket.MSG_DONTWAIT) == b""
                except BlockingIOError:
                    gone = False
                if gone:
                    lost.add(i)
                    emit(VehicleLost(time_us=time_us, instance=i, reason="its connection broke"))
            if lost and config["scenario"]["run"]["on_vehicle_loss"] == "end":
                reason = "vehicle_lost"
                break
            if len(lost) == len(vehicles):
                reason = "no_vehicles"
                break
            if fault == "physics-fails" and time_us >= 1_000_000:
                complain("physics: the world has ended")
                sys.exit(2)
            if fault == "physics-hangs" and time_us >= 1_000_000:
                signal.pause()
            if fault == "endless" and time_us >= ENDLESS_US:  # reports its progress until a command arrives
                emit(
                    Progress(time_us=time_us, wall_s=time.monotonic(), channel_busy_fraction=0.0, vehicles=())
                )
                time.sleep(0.1)
                continue
            time_us += STEP_US
            if fault == "held" and time_us == FORMED_US:
                os.kill(os.getppid(), signal.SIGINT)
            if time_us == FORMED_US and fault != "never-formed":
                emit(Formed(time_us=time_us))
                if command.stop_when_formed:
                    reason = "formed"
                    break
        truth = tuple(vehicle(time_us, alive=i not in lost) for i in vehicles)
        emit(Progress(time_us=time_us, wall_s=time.monotonic(), channel_busy_fraction=0.125, vehicles=truth))
        emit(Paused(time_us=time_us, reason=reason, vehicles=truth))
        if fault == "interrupted" and time_us >= FORMED_US:
            fault = ""
            os.kill(os.getppid(), signal.SIGINT)
    if fault == "physics-dies-at-last":
        os.kill(os.getpid(), signal.SIGKILL)
    emit(Finished(name="physics", details={"time_us": time_us, "formed": time_us >= FORMED_US}))


def radio(config: dict[str, Any]) -> None:
    inbox: queue.SimpleQueue[Stop] = queue.SimpleQueue()
    commands(Stop, inbox)
    with socket.create_server((config["host"], config["port"])) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        emit(Ready(name="radio", pid=os.getpid(), details={"endpoint": endpoint}))
        inbox.get()
    if config["seed"] == SEED_RADIO_DIES:
        os.kill(os.getpid(), signal.SIGKILL)
    if config["seed"] == SEED_RADIO_DIES + 1:
        return
    emit(Finished(name="radio", details={"counters": {}}))


def simulator_of(ports: dict[str, Any], inherited: int | None) -> socket.socket:
    if inherited is not None:
        return socket.socket(fileno=inherited)
    return socket.create_connection((ports["host"], ports["simulator_tcp"]))


def uav(config: dict[str, Any], inherited: int | None) -> None:
    end_with_parent()
    name, ports = f"uav {config['instance']}", config["ports"]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gcs,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as companion,
        simulator_of(ports, inherited) as simulator,
    ):
        gcs.bind((ports["host"], ports["gcs_local_udp"]))
        companion.bind((ports["host"], ports["companion_local_udp"]))
        altitude_m = config["autopilot"]["params"].get("MIS_TAKEOFF_ALT")
        if altitude_m == config["instance"]:
            complain(f"{name}: no such airframe")
            sys.exit(2)
        details = {"gcs_local_udp": gcs.getsockname()[1], "companion_local_udp": companion.getsockname()[1]}
        emit(Ready(name=name, pid=os.getpid(), details=details))
        while simulator.recv(1):
            pass
    if altitude_m == FAILS_AT_LAST_M + config["instance"]:
        os.kill(os.getpid(), signal.SIGKILL)
    emit(Finished(name=name, details={"ground_messages": 0}))


def prefork_server(line: socket.socket) -> None:
    emit(Ready(name="prefork", pid=os.getpid()))
    serve(line, main)
    emit(Finished(name="prefork"))


def sockets(text: str) -> dict[int, socket.socket]:
    pairs = (pair.split(":") for pair in filter(None, text.split(",")))
    return {int(instance): socket.socket(fileno=int(fd)) for instance, fd in pairs}


def main(command_line: Sequence[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("module", nargs="?", default="autopilot")
    parser.add_argument("--config", type=Path)
    parser.add_argument("--listen-fds", default="")
    parser.add_argument("--vehicle-fds", default="")
    parser.add_argument("--simulator-fd", type=int)
    parser.add_argument("--interval-fd")
    parser.add_argument("--radio-endpoint")
    parser.add_argument("--fork-fd", type=int)
    parser.add_argument("--supervised", action="store_true")
    arguments = parser.parse_args(command_line)
    settings = json.loads(arguments.config.read_bytes()) if arguments.config else {}
    match arguments.module:
        case "harness.simulator.server":
            physics(settings, sockets(arguments.vehicle_fds), sockets(arguments.listen_fds))
        case "netsim":
            radio(settings)
        case "autopilot.process.prefork_server":
            prefork_server(socket.socket(fileno=arguments.fork_fd))
        case "autopilot":
            uav(settings, arguments.simulator_fd)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
