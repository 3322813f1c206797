"""Swarms of stand-ins for PX4, of any scenario."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

from external_swarms import free_base
from paths import ROOT, SUPPORT

from harness.launch.swarm import Swarm

STAND_IN = SUPPORT / "px4_stand_in.py"
COMMAND = (
    '["env", "{build}/bin/px4", "-i", "{i}", "-d", "{build}/etc", "-w", "{work}", "--tcp", "{tcp}",'
    ' "--gcs", "{gcs_local}:{gcs_remote}", "--companion", "{companion_local}:{companion_remote}"]'
)


def px4_swarms(folder: Path, scenario: Path) -> Callable[..., Swarm]:
    """Return a factory of swarms; ``**manners`` are fields of `px4_stand_in.Manners`."""
    build = folder / "build"
    (build / "bin").mkdir(parents=True)
    (build / "etc").mkdir()
    program = build / "bin" / "px4"
    program.write_text(
        f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} {STAND_IN} "$@"\n', encoding="utf-8"
    )
    program.chmod(0o755)

    def make(agents, *overrides, name="run", speed="max", **manners):
        env = json.dumps(manners).replace("{", "{{").replace("}", "}}")
        bases = dict(zip(("gcs", "companion", "application"), range(free_base(12), 99_999, 4), strict=False))
        return Swarm(
            scenario,
            agents=agents,
            ports="scenario",
            speed=speed,
            out=folder / name,
            overrides=[
                "autopilot.kind=px4",
                f"autopilot.px4_build={build}",
                f"autopilot.px4_command={COMMAND}",
                f"autopilot.px4_env.STAND_IN='{env}'",
                "ports.simulator_tcp=0",
                "ports.radio_tcp=0",
                "ports.gcs_remote_udp=0",
                f"ports.gcs_local_udp={bases['gcs']}",
                f"ports.companion_local_udp={bases['companion']}",
                f"ports.companion_remote_udp={bases['application']}",
                *overrides,
            ],
        )

    return make
