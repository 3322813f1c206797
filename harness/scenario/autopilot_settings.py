"""Validation of a scenario's autopilot settings: parameters, plans, links."""

import re
import string
from pathlib import Path

from msgspec import structs

from autopilot.mavlink import signing
from autopilot.navigation import plan_file, site_plan
from autopilot.parameters import parameter_file
from autopilot.parameters.config import AutopilotConfig, LinksConfig, Site
from autopilot.parameters.table import ParameterError, ParameterSet, Settings


def with_parameter_file(config: AutopilotConfig, folder: Path) -> AutopilotConfig:
    """Merge the values of ``params_file``, relative to the scenario's folder; ``params`` has precedence.

    Raises ParameterFileError.
    """
    if config.params_file is None:
        return config
    values = parameter_file.load(folder / config.params_file)
    return structs.replace(config, params={**values, **config.params}, params_file=None)


def with_plan_file(config: AutopilotConfig, folder: Path) -> AutopilotConfig:
    """Replace ``plan_file``, relative to the scenario's folder, by its contents.

    Raises PlanFileError.
    """
    if config.plan_file is None:
        return config
    if config.plan is not None:
        raise plan_file.PlanFileError("there is autopilot.plan, too; expected one of the two")
    return structs.replace(config, plan=plan_file.load(folder / config.plan_file), plan_file=None)


def with_signing_key(config: LinksConfig, folder: Path) -> LinksConfig:
    """Replace the path of the signing key's file, relative to the scenario's folder, by the absolute one.

    The key itself is not copied to the run folder. Raises ValueError for an invalid file.
    """
    if config.signing_key_file is None:
        return config
    path = (folder / config.signing_key_file).absolute()
    try:
        signing.key_of(path.read_bytes())
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from None
    except signing.SigningKeyError as error:
        raise ValueError(f"{path}: {error}") from None
    return structs.replace(config, signing_key_file=str(path))


PX4_PLACEHOLDERS = frozenset(
    {"build", "i", "sysid", "work", "host", "tcp"}
    | {"gcs_local", "gcs_remote", "companion_local", "companion_remote"}
)
"""Placeholders of ``autopilot.px4_command`` and ``autopilot.px4_env``: see `harness.launch.px4`."""
_EXTERNAL_PARAMETER = re.compile(r"[A-Z][A-Z0-9_]{0,15}")


ARDUPILOT_PLACEHOLDERS = frozenset(
    {"program", "i", "sysid", "work", "parameters", "home", "host", "simulator"}
    | {"gcs_remote", "companion_remote"}
)
"""Placeholders of ``autopilot.ardupilot_command``: see `harness.launch.ardupilot`."""


def check(config: AutopilotConfig, site: Site, agents: int) -> None:
    """Check the settings for all vehicles. Raises ValueError with the field's path."""
    external = [config.is_external(i) for i in range(agents)]
    _check_vehicles(config, agents)
    if any(external):
        _check_external(config)
    check_shared = _check_external_parameters if all(external) else _check_parameters
    check_shared(config.params, "autopilot.params")
    for uav, params in config.per_uav.items():
        if uav not in map(str, range(agents)):
            raise ValueError(f"autopilot.per_uav: there is no UAV {uav!r} among {agents}")
        check_own = _check_external_parameters if external[int(uav)] else _check_parameters
        check_own(params, f"autopilot.per_uav.{uav}")
    try:
        site_plan.plans(config, site)
    except ValueError as error:
        raise ValueError(f"autopilot: {error}") from None


def _check_parameters(params: dict[str, float], path: str) -> None:
    try:
        ParameterSet(Settings(), params)
    except ParameterError as error:
        raise ValueError(f"{path}: {error}") from None


def _check_vehicles(config: AutopilotConfig, agents: int) -> None:
    """Check the numbers of the vehicles with another autopilot."""
    vehicles = {"px4": config.px4_vehicles, "ardupilot": config.ardupilot_vehicles}.get(config.kind)
    for instance in vehicles or ():
        if instance >= agents:
            raise ValueError(f"autopilot.{config.kind}_vehicles: there is no UAV {instance} among {agents}")


def _check_external(config: AutopilotConfig) -> None:
    """Check the settings of a PX4 or ArduPilot, as far as this does not depend on the machine."""
    if config.kind == "px4":
        title, program = "a PX4", config.px4_build
        missing = "px4_build: missing; expected the folder of a PX4 SITL build, as autopilot.kind is px4"
        texts, known = [("px4_command", part) for part in config.px4_command], PX4_PLACEHOLDERS
        texts += [(f"px4_env.{name}", value) for name, value in config.px4_env.items()]
    else:
        title, program = "an ArduPilot", config.ardupilot_program
        missing = (
            "ardupilot_program: missing; expected ArduPilot's SITL program for copters, as autopilot.kind is "
            "ardupilot"
        )
        texts, known = (
            [("ardupilot_command", part) for part in config.ardupilot_command],
            ARDUPILOT_PLACEHOLDERS,
        )
    if program is None:
        raise ValueError(f"autopilot.{missing}")
    given = {
        "fence": config.fence,
        "mission": config.mission,
        "rally": config.rally,
        "plan_file": config.plan,
    }
    for field, value in given.items():
        if value:
            raise ValueError(f"autopilot.{field}: {title} takes its plans from a ground station only")
    for field, named in {
        "controller": config.controller,
        "modes": config.modes,
        "services": config.services,
    }.items():
        if named:
            raise ValueError(
                f"autopilot.{field}: {title} has its own controller, modes and services; expected none of "
                "coflight's beside it"
            )
    for field, text in texts:
        _check_placeholders(field, text, known)


def _check_placeholders(field: str, text: str, known: frozenset[str]) -> None:
    try:
        named = {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}
    except ValueError as error:
        raise ValueError(f"autopilot.{field}: {text!r}: {error}") from None
    if unknown := named - known:
        expected = ", ".join(sorted(known))
        raise ValueError(f"autopilot.{field}: {{{min(unknown)}}} stands for nothing; there are {expected}")


def _check_external_parameters(params: dict[str, float], path: str) -> None:
    """Check the syntax of names; existence and ranges of parameters are left to the autopilot."""
    for name in params:
        if not _EXTERNAL_PARAMETER.fullmatch(name):
            raise ValueError(f"{path}: {name!r} is no parameter's name")
