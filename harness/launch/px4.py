"""Vehicles flown by a real PX4: checks of the scenario, and the command that starts a PX4.

PX4 derives its ports from its instance number. They agree with the scenario's if the scenario has PX4's
default ports, or if the command passes them. ``autopilot.px4_command`` and ``autopilot.px4_env`` may contain

    {build}  ``autopilot.px4_build``, as an absolute path
    {i}      the vehicle's number, {sysid} its MAVLink system: one more
    {work}   the vehicle's working folder in the run folder
    {host}   the simulator's address, {tcp} its port for this vehicle
    {gcs_local} {gcs_remote} {companion_local} {companion_remote}    the UDP ports of its links

so that a user can wrap it: ["taskset", "-c", "2", "{build}/bin/px4", "-i", "{i}", ...].

Parameters of the scenario are passed as PX4_PARAM_NAME, which PX4's start-up script sets, except coflight's
own (CF_...). By default PX4's parameters for the delay and the drift of the GPS receiver follow from the
simulated receiver: PX4 would reject one that drifts like a consumer receiver.
"""

import math
import string
from collections.abc import Mapping
from pathlib import Path

from autopilot.parameters.config import AutopilotConfig
from harness.launch.external_process import ExternalProcessConfig
from harness.scenario.scenario import Scenario
from harness.world.sensors.config import GpsModel

OWN_PARAMETERS = "CF_"
"""Prefix of the parameters of coflight's own autopilot."""
_PORTS = {
    "simulator_tcp": (4560, "tcp"),
    "gcs_local_udp": (18570, "gcs_local"),
    "companion_local_udp": (14580, "companion_local"),
}
"""Default ports of PX4 instance 0, to which the instance is added, and their placeholders."""
_MS_PER_S = 1e3
_DRIFT_FILTER_S = 10.0
"""Time constant of the filter of a fix's drift on the ground in PX4's estimator."""
_DRIFT_SIGMAS = 5.0
_LEAST_DRIFT_M_S, _MOST_DRIFT_M_S = {"H": 0.1, "V": 0.2}, {"H": 1.0, "V": 1.5}
"""PX4's default and maximum of EKF2_REQ_HDRIFT and EKF2_REQ_VDRIFT."""


class Px4Error(ValueError):
    """A PX4 cannot be started as configured; the text is one line for the user."""


def instances(scenario: Scenario) -> tuple[int, ...]:
    """Return the vehicles that a PX4 flies."""
    return tuple(i for i in range(scenario.agents) if scenario.autopilot.is_px4(i))


def application_ports(scenario: Scenario) -> list[int]:
    """Return the fixed UDP ports that the applications beside PX4s bind."""
    if not scenario.onboard.enabled:
        return []
    ports = (scenario.vehicle_ports(i).companion_remote_udp for i in instances(scenario))
    return [port for port in ports if port]


def check_start(scenario: Scenario) -> None:
    """Check PX4's build, ports and localisation before anything starts. Raises Px4Error."""
    if not instances(scenario):
        return
    program = _build(scenario.autopilot) / "bin" / "px4"
    if not program.is_file():
        raise Px4Error(f"autopilot.px4_build: there is no {program}; expected the folder of a PX4 SITL build")
    if scenario.onboard.enabled and scenario.onboard.localisation == "truth":
        raise Px4Error("onboard.localisation: 'truth' is sent over the simulator's link, which PX4 occupies")
    named = _named(scenario.autopilot)
    for field, (base, placeholder) in _PORTS.items():
        port = getattr(scenario.ports, field)
        passed = placeholder in named and (port or field == "simulator_tcp")
        if port != base and not passed:
            raise Px4Error(
                f"ports.{field}: a PX4 listens on {base} plus its number, not on {port or 'a free one'}; "
                f"fly on the scenario's ports without an offset, or pass {{{placeholder}}} in "
                "autopilot.px4_command"
            )


def process_config(
    scenario: Scenario, instance: int, *, run_folder: Path, simulator_port: int
) -> ExternalProcessConfig:
    """Return how a vehicle's PX4 is started; creates its folder. Raises OSError."""
    config, ports = scenario.autopilot, scenario.vehicle_ports(instance)
    work = (run_folder / "px4" / f"uav-{instance}").absolute()
    work.mkdir(parents=True)
    values: dict[str, object] = {
        "build": _build(config),
        "i": instance,
        "sysid": instance + 1,
        "work": work,
        "host": ports.host,
        "tcp": simulator_port,
        "gcs_local": ports.gcs_local_udp,
        "gcs_remote": ports.gcs_remote_udp,
        "companion_local": ports.companion_local_udp,
        "companion_remote": ports.companion_remote_udp,
    }
    parameters = _receiver(scenario.sensors.gps_model()) | config.for_uav(instance).params
    return ExternalProcessConfig(
        name=f"uav {instance}",
        command=tuple(part.format_map(values) for part in config.px4_command),
        environment={name: value.format_map(values) for name, value in config.px4_env.items()}
        | _environment(parameters),
        folder=str(work),
        details={"gcs_local_udp": ports.gcs_local_udp, "companion_local_udp": ports.companion_local_udp},
    )


def _receiver(model: GpsModel) -> dict[str, float]:
    """Return the parameters that follow from the simulated receiver.

    PX4 rejects fixes that drift on the ground, by their filtered rate with time constant T = 10 s. For a
    first-order Gauss-Markov error of std σ and time constant τ this rate has a std of σ / T sqrt(T / (T +
    τ)).
    """
    parameters = {"EKF2_GPS_DELAY": model.delay_s * _MS_PER_S}
    share = _DRIFT_FILTER_S / (_DRIFT_FILTER_S + model.bias_time_constant_s)
    for axis, std_m in (("H", model.horizontal_bias_std_m), ("V", model.vertical_bias_std_m)):
        most_m_s = _DRIFT_SIGMAS * std_m / _DRIFT_FILTER_S * math.sqrt(share)
        if most_m_s > _LEAST_DRIFT_M_S[axis]:
            parameters[f"EKF2_REQ_{axis}DRIFT"] = min(round(most_m_s, 3), _MOST_DRIFT_M_S[axis])
    return parameters


def _environment(parameters: Mapping[str, float]) -> dict[str, str]:
    """Return parameters for PX4's start-up script; whole numbers have no decimal point."""
    return {
        f"PX4_PARAM_{name}": f"{value:.9g}"
        for name, value in parameters.items()
        if not name.startswith(OWN_PARAMETERS)
    }


def _build(config: AutopilotConfig) -> Path:
    return Path(config.px4_build or "").expanduser().absolute()


def _named(config: AutopilotConfig) -> set[str]:
    """Return the placeholders in command and environment."""
    texts = (*config.px4_command, *config.px4_env.values())
    return {name for text in texts for _, name, _, _ in string.Formatter().parse(text) if name is not None}
