"""Vehicles whose autopilot is another program: `harness.launch.px4` or `harness.launch.ardupilot`."""

from pathlib import Path

from harness.launch import ardupilot, px4, px4_instances
from harness.launch.external_process import ExternalProcessConfig
from harness.scenario.scenario import Scenario

TITLES = {"px4": "a PX4", "ardupilot": "an ArduPilot"}
"""By kind of autopilot."""


def instances(scenario: Scenario) -> tuple[int, ...]:
    """Return the vehicles whose autopilot is another program."""
    return tuple(i for i in range(scenario.agents) if scenario.autopilot.is_external(i))


def check_start(scenario: Scenario) -> None:
    """Check programs and settings before anything starts. Raises AutopilotError."""
    px4.check_start(scenario)
    ardupilot.check_start(scenario)


def check_free(scenario: Scenario) -> None:
    """Check that no other autopilot is in the way of this swarm's. Raises ResourceError."""
    px4.check_free(scenario)


def application_ports(scenario: Scenario) -> list[int]:
    """Return the fixed UDP ports that the applications beside other autopilots bind."""
    if not scenario.onboard.enabled:
        return []
    ports = (scenario.vehicle_ports(i).companion_remote_udp for i in instances(scenario))
    return [port for port in ports if port]


def process_config(
    scenario: Scenario, instance: int, *, run_folder: Path, simulator_port: int
) -> ExternalProcessConfig:
    """Return how a vehicle's autopilot is started; creates its folder. Raises OSError."""
    make = px4.process_config if scenario.autopilot.is_px4(instance) else ardupilot.process_config
    return make(scenario, instance, run_folder=run_folder, simulator_port=simulator_port)


def remove_files(scenario: Scenario) -> None:
    """Remove what autopilots leave outside the run folder, except files of running ones."""
    px4_instances.remove_files(px4.numbers(scenario))
