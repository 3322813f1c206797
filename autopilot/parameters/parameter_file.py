"""Parameter files: the text that QGroundControl saves and loads, one parameter to a line.

    # Vehicle-Id Component-Id Name Value Type
    1	1	MPC_XY_P	0.95	9

Fields are separated by tabs (spaces are accepted), type 6 is INT32 and 9 is REAL32, and ``#`` begins a
comment line. A number is read as the double that was written. One that a ground station printed from a
float32, with 18 decimals, is read as the shortest decimal of that float32, as are values over MAVLink.
Read-only parameters (such as MAV_SYS_ID) are neither written nor read. `parse` and `dumps` are pure; `load`,
`load_known` and `save` access files.
"""

import math
import os
import re
from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.parameters.inert import STATED
from autopilot.parameters.table import (
    ROW_INDEX_OF,
    ROWS,
    TABLE,
    Parameter,
    ParameterError,
    ParameterSet,
    Row,
    check_range,
)
from foundation.text_file import TextFileError, read_text

INT32, REAL32 = "6", "9"
FIELDS = ("vehicle", "component", "name", "value", "type")
HEADER = "# Vehicle-Id Component-Id Name Value Type"


class ParameterFileError(ValueError):
    """An unreadable or invalid parameter file; the text is one line with file and line number."""


class ParsedParameters(NamedTuple):
    """Contents of a file."""

    values: dict[str, float]
    """In PX4's units, within their ranges"""
    unknown: dict[str, int]
    """Unknown parameters and those of other components, with their line numbers"""


def parse(text: str, name: str) -> ParsedParameters:
    """Parse a file's text; ``name`` is used in errors. Raises ParameterFileError."""
    values: dict[str, float] = {}
    unknown: dict[str, int] = {}
    line_of: dict[str, int] = {}
    for number, line in enumerate(text.removeprefix("\ufeff").split("\n"), 1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            component, parameter_name = _heading(fields)
            if component != AUTOPILOT_COMPONENT or parameter_name not in ROW_INDEX_OF:
                unknown.setdefault(parameter_name, number)
                continue
            if parameter_name in _READ_ONLY:
                continue
            if parameter_name in line_of:
                raise ParameterError(f"{parameter_name} was set already in line {line_of[parameter_name]}")  # noqa: TRY301  # one handler adds file and line
            line_of[parameter_name] = number
            values[parameter_name] = _value(parameter_name, *fields[3:])
        except ParameterError as error:
            raise ParameterFileError(f"{name}:{number}: {error}") from None
    return ParsedParameters(values, unknown)


def load(path: Path) -> dict[str, float]:
    """Values of a file without unknown parameters. Raises ParameterFileError."""
    values, unknown = load_known(path)
    for parameter_name, number in unknown.items():
        raise ParameterFileError(f"{path}:{number}: the autopilot has no parameter {parameter_name!r}")
    return values


def load_known(path: Path) -> ParsedParameters:
    """Values of a file that may contain unknown parameters. Raises ParameterFileError."""
    try:
        text = read_text(path)
    except TextFileError as error:
        raise ParameterFileError(str(error)) from None
    return parse(text, str(path))


def values_of(parameters: ParameterSet) -> dict[str, float]:
    """Values of a set by name; setting them reproduces the same settings to the last bit."""
    settings = parameters.settings
    values = {each.name: _value_of(each, attrgetter(each.path)(settings)) for each in TABLE}
    values |= {row.name: parameters.stated[row.name] for row in STATED if not row.read_only}
    return dict(sorted(values.items()))


def dumps(values: Mapping[str, float], *, system_id: int = 1) -> str:
    """Text of a file with these values, in PX4's units; `parse` returns the same values.

    Values must be finite. Raises KeyError for an unknown parameter.
    """
    lines = [f"# Onboard parameters for Vehicle {system_id}", "#", HEADER]
    for name, value in values.items():
        kind, text = _text(ROWS[ROW_INDEX_OF[name]], value)
        lines.append("\t".join((str(system_id), str(AUTOPILOT_COMPONENT), name, text, kind)))
    return "\n".join(lines) + "\n"


def save(path: Path, parameters: ParameterSet, *, system_id: int = 1) -> None:
    """Write a set's values atomically. Raises OSError."""
    text = dumps(values_of(parameters), system_id=system_id)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8", newline="\n")
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _heading(fields: list[str]) -> tuple[int, str]:
    """Component and name of a line. Raises ParameterError."""
    if len(fields) != len(FIELDS):
        raise ParameterError(f"{len(fields)} fields, not {len(FIELDS)}: {', '.join(FIELDS)}")
    for what, field in zip(FIELDS[:2], fields[:2], strict=True):
        if not re.fullmatch(r"[0-9]{1,3}", field):
            raise ParameterError(f"{field!r} is not a {what} id")
    return int(fields[1]), fields[2]


def _value(name: str, text: str, kind: str) -> float:
    """Value of a line, within the parameter's range. Raises ParameterError."""
    pattern = {INT32: _WHOLE, REAL32: _REAL}.get(kind)
    if pattern is None:
        raise ParameterError(f"{name}: type {kind!r} is neither {INT32} (INT32) nor {REAL32} (REAL32)")
    if not pattern.fullmatch(text):
        raise ParameterError(f"{name}: {text!r} is not {'an integer' if kind == INT32 else 'a number'}")
    value = _real(text)
    check_range(name, value)
    return value


_READ_ONLY = frozenset(row.name for row in STATED if row.read_only)
_WHOLE = re.compile(r"[+-]?[0-9]{1,10}")
_REAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


def _real(text: str) -> float:
    """Double of a decimal; for a float32 printed with 18 decimals, its shortest decimal."""
    value = float(text)
    if abs(value) > np.finfo(np.float32).max:
        return value
    single = np.float32(value)
    return float(str(single)) if f"{float(single):.18f}" == text else value


def _text(parameter: Row, value: float) -> tuple[str, str]:
    """Type and decimal of a value, which `_real` reads as the same double."""
    if parameter.is_integer:
        return INT32, str(round(value))
    text = f"{value:.0f}" if value == round(value) and abs(value) < 1e15 else repr(value)
    return REAL32, text if _real(text) == value else f"{value:.16e}"


def _value_of(parameter: Parameter, setting: float) -> float:
    """Return the shortest value in PX4's unit that gives exactly this setting."""
    factor = parameter.setting_per_unit
    value = setting / factor
    neighbours = (value, math.nextafter(value, math.inf), math.nextafter(value, -math.inf))
    for candidate in (float(f"{value:.12g}"), *neighbours):
        made = candidate * factor
        is_made = (round(made) if isinstance(setting, int) else made) == setting
        if is_made and parameter.minimum <= candidate <= parameter.maximum:
            return candidate
    return value
