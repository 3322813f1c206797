"""Swarms of stand-ins for ArduPilot: their scenario, program and free ports."""

import json
import sys
from pathlib import Path

from external_swarms import CALM, free_base
from paths import ROOT, SUPPORT

from autopilot.parameters.config import AutopilotConfig
from harness.launch.swarm import Swarm

STAND_IN = SUPPORT / "ardupilot_stand_in.py"


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
    path.write_text(CALM, encoding="ascii")
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
