"""Names and command lines of the processes of a run."""

import os
import sys
from pathlib import Path

PHYSICS, RADIO, PREFORK, NETWORK = "physics", "radio", "prefork", "network"


def uav(instance: int) -> str:
    """Return the name of a vehicle's process."""
    return f"uav {instance}"


def application(instance: int) -> str:
    """Return the name of the process of an on-board application beside another autopilot."""
    return f"application {instance}"


def ground_station(name: str) -> str:
    """Return the name of the process of a ground station on the radio."""
    return f"ground station {name}"


def python_module(module: str, *arguments: str) -> list[str]:
    """Return the command that runs one of coflight's processes."""
    # -P: no file of the working folder may shadow a module
    return [sys.executable, "-P", "-m", module, *arguments]


def bound_module(module: str, *arguments: str) -> list[str]:
    """Return the command that runs one of coflight's processes, which the kernel ends with this one.

    Start it from a thread that lives as long as this process (`harness.launch.spawner`).
    """
    return python_module("foundation.processes.bound_program", str(os.getpid()), module, *arguments)


def supervised(config: Path) -> tuple[str, ...]:
    """Return the arguments of one of coflight's processes as a child of this one."""
    return ("--config", str(config), "--supervised")
