"""Values of a campaign file: conversion of nested tables to paths, of ranges to lists, and to TOML text.

Errors are ValueErrors with one line that begins with the path.
"""

import json
from collections.abc import Iterator, Mapping
from decimal import Decimal
from typing import Any

MOST_VALUES = 100_000
"""Largest number of values of one range"""
_RANGE_KEYS = {"from", "to", "step", "count"}
_RANGE = "{from=, to=, step=} or {from=, to=, count=}"


def flat(table: Mapping[str, Any], *, ranges: bool = False, above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value with its path, such as ``wind.mean_n``, in the table's order.

    TOML's ``wind.mean_n = 2``, ``"wind.mean_n" = 2`` and ``wind = {mean_n = 2}`` are equivalent.
    With ``ranges`` a table with ``from`` is a value. Raises ValueError for an empty table.
    """
    for key, value in table.items():
        path = f"{above}.{key}" if above else key
        if not isinstance(value, dict) or (ranges and "from" in value):
            yield path, value
        elif value:
            yield from flat(value, ranges=ranges, above=path)
        else:
            raise ValueError(f"{path}: an empty table sets nothing")


def spread(path: str, value: object) -> tuple[Any, ...]:
    """Return the values of a list or range; raises ValueError."""
    if isinstance(value, dict):
        return _range(path, value)
    if not isinstance(value, list | tuple):
        raise ValueError(f"{path}: expected a list of values, {_RANGE}")  # noqa: TRY004  an error of the file
    if not value:
        raise ValueError(f"{path}: an empty list flies nothing")
    seen: set[tuple[type, str]] = set()
    for each in value:
        value_text = type(each), toml_text(each)
        if value_text in seen:
            raise ValueError(f"{path}: {value_text[1]} stands twice")
        seen.add(value_text)
    return tuple(value)


def _range(path: str, table: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the values of a range including ``to``, computed with decimals to get 0.1, 0.2, 0.3."""
    if unknown := sorted(set(table) - _RANGE_KEYS):
        raise ValueError(f"{path}: unknown key `{unknown[0]}`; expected {_RANGE}")
    if "to" not in table or ("step" in table) == ("count" in table):
        raise ValueError(f"{path}: expected {_RANGE}")
    numbers = {key: _decimal(f"{path}.{key}", value) for key, value in table.items()}
    first, last = numbers["from"], numbers["to"]
    if "step" in numbers:
        step = numbers["step"]
        if step == 0 or (last - first) / step < 0:
            raise ValueError(f"{path}.step: {step} never comes from {first} to {last}")
        count, divisor = (last - first) // step + 1, Decimal(1)
    else:
        count = numbers["count"]
        if not isinstance(table["count"], int) or count < 2:
            raise ValueError(f"{path}.count: {count}: expected an `int` >= 2")
        if first == last:
            raise ValueError(f"{path}.to: {last}: expected another number than that of from")
        step, divisor = last - first, count - 1
    if count > MOST_VALUES:
        raise ValueError(f"{path}: {count} values; expected at most {MOST_VALUES}")
    values = [first + step * k / divisor for k in range(int(count))]
    whole = all(isinstance(value, int) for value in table.values()) and all(v == int(v) for v in values)
    return tuple(int(value) if whole else float(value) for value in values)


def _decimal(path: str, value: object) -> Decimal:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{path}: expected a number")  # noqa: TRY004  likewise
    number = Decimal(repr(value))
    if not number.is_finite():
        raise ValueError(f"{path}: {value}: expected a finite number")
    return number


def plain(path: str, value: object) -> Any:  # noqa: ANN401  any value of a file
    """Convert a program's value to a file's form: NumPy's numbers and arrays, ranges and tuples.

    Raises ValueError for types that a file cannot contain.
    """
    match value:
        case bool():
            return value
        case str():
            return str(value)
        case list() | tuple() | range():
            return [plain(f"{path}[{number}]", each) for number, each in enumerate(value)]
        case dict():
            return {key: plain(f"{path}.{key}", each) for key, each in value.items()}
        case _ if hasattr(value, "tolist"):  # numpy's
            return plain(path, value.tolist())
        case int():
            return int(value)
        case float():
            return float(value)
        case _ if hasattr(value, "isoformat"):
            return value
    raise ValueError(f"{path}: a value of the kind {type(value).__name__} cannot be in a campaign")


def toml_text(value: object) -> str:
    """Return a `plain` value as TOML text for `scenario.load`; dates and times as ISO 8601."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case list() | tuple():
            return f"[{', '.join(map(toml_text, value))}]"
        case dict():
            return f"{{{', '.join(f'{toml_text(key)} = {toml_text(each)}' for key, each in value.items())}}}"
        case int() | float():
            return repr(value)  # also inf and nan, which are valid TOML
        case _ if hasattr(value, "isoformat"):
            return str(value.isoformat())
    raise TypeError(f"{type(value).__name__}: TOML has no such value")
