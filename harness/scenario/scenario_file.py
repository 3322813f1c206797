"""Reads scenario files: TOML and ``--set`` overrides become one validated `Scenario`."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from autopilot.navigation.plan_file import PlanFileError
from autopilot.parameters.parameter_file import ParameterFileError
from foundation.airframe.files import AirframeError
from foundation.text_file import TextFileError, read_text
from harness.scenario import (
    airframe_choice,
    autopilot_settings,
    element_file,
    formation_shape,
    packaged,
)
from harness.scenario import programs as vehicle_programs
from harness.scenario.element_file import ElementFileError
from harness.scenario.formation_shape import FormationFileError
from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.user_code import with_code
from harness.scenario.validation_errors import InvalidTable, convert
from harness.world.faults import EXPECTED
from netsim.radio_models import registry

ARRAYS_OF_TABLES = (
    "faults", "wind.gusts", "sensors.extra", "sensors.boxes", "onboard.programs", "programs", "stations",
)  # fmt: skip
_EXPECTED = {
    **EXPECTED,
    **registry.EXPECTED,
    r"formation\.motion\.kind": "one of track, racetrack",
    r"agents": "MAVLink numbers systems 1 to 255, and 255 is a ground station",
}


def read_table(path: Path) -> dict[str, Any]:
    """Return the table of a TOML file that is not empty. Raises TextFileError."""
    text = read_text(path)
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TextFileError(f"{path}: not TOML: {error}") from None
    if not table:
        raise TextFileError(f"{path}: it has no settings")
    return table


def load(path: str | Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario file and apply ``path=value`` overrides.

    Values are in TOML's notation (bare words are strings); ``faults.0.uav`` is a field of the first fault.

    Raises ScenarioError with a line for each wrong field, which names the file or override, the field's path
    and the error.
    """
    path = packaged.find(path)
    try:
        table = read_table(path)
    except TextFileError as error:
        names = ", ".join(name for name in packaged.names() if "/" not in name)
        advice = "" if path.is_file() else f"; scenarios by name: {names}"
        raise ScenarioError(f"{error}{advice}") from None
    if isinstance(table.get("scenario"), str):
        raise ScenarioError(f"{path}: it is a campaign: coflight campaign flies it")
    table.setdefault("name", path.stem)
    for override in overrides:
        _override(table, override)
    try:
        if isinstance(formation := table.get("formation"), dict):
            table["formation"] = formation_shape.with_points(formation, path.parent)
        if isinstance(antenna := table.get("antenna"), dict):
            table["antenna"] = element_file.with_deck(antenna, path.parent)
        if isinstance(vehicle := table.get("vehicle"), dict):
            table["vehicle"] = airframe_choice.with_files(vehicle, path.parent)
        scenario = convert(table, Scenario, _EXPECTED)
        autopilot = autopilot_settings.with_parameter_file(scenario.autopilot, path.parent)
        autopilot = autopilot_settings.with_plan_file(autopilot, path.parent)
    except InvalidTable as error:
        raise ScenarioError(f"{path}: {error}") from None
    except AirframeError as error:
        raise ScenarioError(f"{path}: {error}") from None
    except FormationFileError as error:
        raise ScenarioError(f"{path}: formation.file: {error}") from None
    except ElementFileError as error:
        raise ScenarioError(f"{path}: antenna.element_file: {error}") from None
    except PlanFileError as error:
        raise ScenarioError(f"{path}: autopilot.plan_file: {error}") from None
    except ParameterFileError as error:
        raise ScenarioError(f"{path}: autopilot.params_file: {error}") from None
    try:
        links = autopilot_settings.with_signing_key(scenario.links, path.parent)
    except ValueError as error:
        raise ScenarioError(f"{path}: links.signing_key_file: {error}") from None
    # an override of a packaged scenario names a module or file of the current folder
    folder = Path() if packaged.FOLDER in path.parents else path.parent
    try:
        programs = vehicle_programs.with_folder(scenario.programs, folder)
        return with_code(
            msgspec.structs.replace(scenario, autopilot=autopilot, links=links, programs=programs), folder
        )
    except ValueError as error:  # code of the user, or contents of the files conflict with other settings
        raise ScenarioError(f"{path}: {error}") from None


def _override(table: dict[str, Any], override: str) -> None:
    """Set one field in the nested table and create missing tables; entries of arrays count from 0."""
    path, equals, text = override.partition("=")
    keys = [key.strip() for key in path.split(".")]
    if not equals or not all(keys):
        raise ScenarioError(f"--set {override}: expected PATH=VALUE, such as wind.mean_n=2")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    container: Any = table
    for depth, key in enumerate(keys):
        where = ".".join(keys[:depth])
        if isinstance(container, list):
            index = _index(container, key, where, override)
            if depth == len(keys) - 1:
                container[index] = value
            else:
                container = container[index]
        elif not isinstance(container, dict):
            raise ScenarioError(f"--set {override}: {where} is a value, not a table")
        elif depth == len(keys) - 1:
            container[key] = value
        else:
            missing: Any = [] if ".".join(keys[: depth + 1]) in ARRAYS_OF_TABLES else {}
            container = container.setdefault(key, missing)


def _index(entries: list[Any], key: str, where: str, override: str) -> int:
    """Parse a path's key as the index of an existing entry."""
    if not (key.isdecimal() and int(key) < len(entries)):
        numbers = f"numbers 0 to {len(entries) - 1}" if entries else "none"
        raise ScenarioError(f"--set {override}: {where} has no entry {key}; there are {numbers}")
    return int(key)
