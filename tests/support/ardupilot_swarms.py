"""Swarms of stand-ins for ArduPilot: their scenario, program and free ports."""

import json
import socket
import sys
from pathlib import Path

from paths import ROOT, SUPPORT

from autopilot.parameters.config import AutopilotConfig
from harness.launch.swarm import Swarm

STAND_IN = SUPPORT / "ardupilot_stand_in.py"
SCENARIO = """
[run]
silence_limit_s = 3.0
[formation]
height_m = 3.0
columns = 1
[antenna]
wavelength_m = 10.0
[wind]
mean_n = 0.0
[sensors]
profile = "ideal"
[onboard]
localisation = "gps"
[radio]
bandwidth_mhz = 80
"""
_BASES = iter(range(30_000, 32_000, 16))
"""First of 16 ports below those that the system gives out; no two swarms of a test have the same."""


def free_base(count: int) -> int:
    """Return the first of ``count`` free UDP ports, below the range of ephemeral ports."""
    for base in _BASES:
        try:
            for port in range(base, base + count):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return base
    raise AssertionError("no ports")


def write_program(path: Path) -> Path:
    """Write an executable file that runs the stand-in."""
    path.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} {STAND_IN} "$@"\n', "utf-8")
    path.chmod(0o755)
    return path


def make_swarm(
    folder: Path, agents: int, *overrides: str, name: str = "run", speed: float | str = "max", **how: object
) -> Swarm:
    """Return a swarm of stand-ins; ``**how`` are fields of `ardupilot_stand_in.Deviations`."""
    program = folder / "arducopter"
    if not program.exists():
        write_program(program)
    path = folder / "ardupilots.toml"
    path.write_text(SCENARIO, encoding="ascii")
    given = json.dumps(how).replace("{", "{{").replace("}", "}}")
    command = ["env", f"STAND_IN={given}", *AutopilotConfig().ardupilot_command]
    base = free_base(16)
    return Swarm(
        path,
        agents=agents,
        ports="scenario",
        speed=speed,
        out=folder / name,
        overrides=[
            "autopilot.kind=ardupilot",
            f"autopilot.ardupilot_program='{program}'",
            f"autopilot.ardupilot_command={json.dumps(command)}",
            "ports.simulator_tcp=0",
            "ports.radio_tcp=0",
            f"ports.gcs_remote_udp={base}",
            "ports.gcs_local_udp=0",
            "ports.companion_local_udp=0",
            f"ports.companion_remote_udp={base + 1}",
            *overrides,
        ],
    )
