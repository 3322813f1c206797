"""Vehicles flown by a real PX4: checks of the scenario, and the command that starts a PX4.

PX4 derives its ports from its instance number, which is the vehicle's number plus the offset of the
scenario's ports from PX4's default ones (`instance_offset`), so that swarms on other ports have other
instances. ``autopilot.px4_command`` and ``autopilot.px4_env`` may contain

    {build}  ``autopilot.px4_build``, as an absolute path
    {i}      the instance number, {sysid} the vehicle's MAVLink system
    {work}   the vehicle's working folder in the run folder
    {host}   the simulator's address, {tcp} its port for this vehicle
    {gcs_local} {gcs_remote} {companion_local} {companion_remote}    the UDP ports of its links

so that a user can wrap it: ["taskset", "-c", "2", "{build}/bin/px4", "-i", "{i}", ...].

Parameters of the scenario are passed as PX4_PARAM_NAME, which PX4's start-up script sets, except coflight's
own (CF_...); see `harness.launch.px4_parameters`.
"""

import os
import string
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from autopilot.parameters.config import AutopilotConfig
from harness.launch import px4_instances
from harness.launch.external_process import AutopilotError, ExternalProcessConfig
from harness.launch.px4_parameters import (
    SIMULATION_PARAMETERS,
    error_in,
    known_ones,
    known_parameters,
    receiver_parameters,
)
from harness.scenario.scenario import Scenario

_PORTS = {
    "simulator_tcp": (4560, "tcp"),
    "gcs_local_udp": (18570, "gcs_local"),
    "companion_local_udp": (14580, "companion_local"),
}
"""Default ports of PX4 instance 0, to which the instance is added, and their placeholders."""


def instances(scenario: Scenario) -> tuple[int, ...]:
    """Return the vehicles that a PX4 flies."""
    return tuple(i for i in range(scenario.agents) if scenario.autopilot.is_px4(i))


def check_start(scenario: Scenario) -> None:
    """Check build, user, parameters, ports and localisation before anything starts. Raises AutopilotError."""
    if not instances(scenario):
        return
    config = scenario.autopilot
    build = _build(config)
    program = build / "bin" / "px4"
    if not program.is_file():
        raise AutopilotError(
            f"autopilot.px4_build: there is no {program}; expected the folder of a PX4 SITL build"
        )
    if os.geteuid() == 0 and config.px4_command[0].replace("{build}", str(build)) == str(program):
        raise AutopilotError(
            "autopilot.kind: PX4 is not to run as root: its files would be in the way of other users' PX4s; "
            "run as another user, or change the user in autopilot.px4_command, for instance by setpriv"
        )
    known = known_parameters(build)
    if known is not None:
        for vehicle in instances(scenario):
            error = error_in(config.external_params(vehicle), known)
            if error is not None:
                raise AutopilotError(f"autopilot.params: {error}")
    if scenario.onboard.enabled and scenario.onboard.localisation == "truth":
        raise AutopilotError(
            "onboard.localisation: 'truth' is sent over the simulator's link, which PX4 occupies"
        )
    instance_offset(scenario)


def instance_offset(scenario: Scenario) -> int:
    """Return the difference between PX4's instance numbers and the vehicles'.

    It is that of the scenario's ports, less those that the command passes, from PX4's. Raises AutopilotError.
    """
    named = _named(scenario.autopilot)
    offsets: dict[str, int] = {}
    for field, (base, placeholder) in _PORTS.items():
        port = getattr(scenario.ports, field)
        if placeholder in named and (port or field == "simulator_tcp"):
            continue
        offsets[field] = port - base
    if not offsets:  # the command passes all ports, which need not rise with the numbers
        return 0
    (common, _), *_ = Counter(offsets.values()).most_common()
    for field, offset in offsets.items():
        base, placeholder = _PORTS[field]
        if offset < 0 or offset != common:
            port = getattr(scenario.ports, field)
            raise AutopilotError(
                f"ports.{field}: a PX4 listens on {base} plus its number, not on {port or 'a free one'}; "
                "raise all its ports by the same offset (--port-offset), or pass "
                f"{{{placeholder}}} in autopilot.px4_command"
            )
    return common


def numbers(scenario: Scenario) -> tuple[int, ...]:
    """Return the instance numbers of the PX4s. Raises AutopilotError."""
    vehicles = instances(scenario)
    offset = instance_offset(scenario) if vehicles else 0
    return tuple(vehicle + offset for vehicle in vehicles)


def check_free(scenario: Scenario) -> None:
    """Check that no other PX4 is in the way of this swarm's. Raises ResourceError."""
    for number in numbers(scenario):
        px4_instances.check_free(number, scenario.ports.host)


def process_config(
    scenario: Scenario, instance: int, *, run_folder: Path, simulator_port: int
) -> ExternalProcessConfig:
    """Return how a vehicle's PX4 is started; creates its folder. Raises OSError."""
    config, ports, offset = scenario.autopilot, scenario.vehicle_ports(instance), instance_offset(scenario)
    work = (run_folder / "px4" / f"uav-{instance}").absolute()
    work.mkdir(parents=True)
    values: dict[str, object] = {
        "build": _build(config),
        "i": instance + offset,
        "sysid": instance + 1,
        "work": work,
        "host": ports.host,
        "tcp": simulator_port,
        "gcs_local": ports.gcs_local_udp,
        "gcs_remote": ports.gcs_remote_udp,
        "companion_local": ports.companion_local_udp,
        "companion_remote": ports.companion_remote_udp,
    }
    parameters = receiver_parameters(scenario.sensors.gps_model())
    if config.px4_simulation_parameters:
        parameters |= SIMULATION_PARAMETERS
    parameters = known_ones(parameters, known_parameters(_build(config)))
    if offset:  # PX4's default is its instance number plus one
        parameters["MAV_SYS_ID"] = instance + 1
    parameters |= config.external_params(instance)
    return ExternalProcessConfig(
        name=f"uav {instance}",
        command=tuple(part.format_map(values) for part in config.px4_command),
        environment={name: value.format_map(values) for name, value in config.px4_env.items()}
        | _environment(parameters),
        folder=str(work),
        details={"gcs_local_udp": ports.gcs_local_udp, "companion_local_udp": ports.companion_local_udp},
    )


def _environment(parameters: Mapping[str, float]) -> dict[str, str]:
    """Return parameters for PX4's start-up script; whole numbers have no decimal point."""
    return {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in parameters.items()}


def _build(config: AutopilotConfig) -> Path:
    return Path(config.px4_build or "").expanduser().absolute()


def _named(config: AutopilotConfig) -> set[str]:
    """Return the placeholders in command and environment."""
    texts = (*config.px4_command, *config.px4_env.values())
    return {name for text in texts for _, name, _, _ in string.Formatter().parse(text) if name is not None}
