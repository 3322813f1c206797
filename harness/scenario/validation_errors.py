"""Conversion of nested tables to settings: one line for each wrong field, with its path and the reason."""

import copy
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar

import msgspec

from harness.scenario.field_names import allowed_values, field_names, keys_of, nearest

T = TypeVar("T")
Keys = tuple[str | int, ...]

MOST_PROBLEMS = 20
"""Wrong fields that are reported at once."""
_WORDS = {
    "Object contains unknown field": "unknown key",
    "Object missing": "object missing",
    "Expected": "expected",
    "Invalid": "invalid",
    " | null`": "`",
}
"""Replacements in msgspec's texts. TOML has no null: an optional field is omitted."""
_OF_ONE_FIELD = ("Expected ", "Invalid ", "Object ")
"""How msgspec's own texts begin; others are those of a table's checks of several fields."""
_UNNAMED = "[...]"
"""Instead of a key in msgspec's paths, in tables whose keys are not fields."""
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`")


class InvalidTable(ValueError):
    """Settings with wrong fields; ``problems`` has one line for each."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__(problems[0] if len(problems) == 1 else "\n  ".join(_counted(problems)))
        self.problems = problems


def _counted(problems: list[str]) -> list[str]:
    more = " or more" if len(problems) == MOST_PROBLEMS else ""
    return [f"{len(problems)}{more} fields are wrong:", *problems]


def _split(error: msgspec.ValidationError) -> tuple[str, str]:
    """Return reason and path of an error; the path of the whole table is empty."""
    reason, at, where = str(error).rpartition(" - at `$")
    return (reason, where.rstrip("`").lstrip(".")) if at else (str(error), "")


def explain(
    error: msgspec.ValidationError,
    expected: Mapping[str, str],
    *,
    root: str = "",
    kind: type[Any] | None = None,
    table: Mapping[str, Any] = MappingProxyType({}),
) -> str:
    """Return ``wind.mean_n: expected `float` >= 0.0`` for ``Expected `float` >= 0.0 - at `$.wind.mean_n```.

    ``expected`` describes expected values where the type is not sufficient, or the reason of an upper limit,
    by a pattern of the whole path, which begins with ``root``. With ``kind``, the type of the whole
    ``table``, the line also has the values of an enumeration, and for an unknown key the field that was
    probably meant.
    """
    reason, path = _split(error)
    where = f"{root}.{path}".strip(".") if root else path
    described = False
    for pattern, description in expected.items():
        if re.fullmatch(pattern, where):
            reason = re.sub(r"^Expected `\w+ \| [^`]*`", f"expected {description}", reason)
            if " <= " in reason:
                reason, described = f"{reason}: {description}", True
            elif reason.startswith("Invalid"):
                reason, described = f"{reason}, expected {description}", True
    if kind is not None and not described:
        reason += _hint(reason, path, kind, table)
    for original, replacement in _WORDS.items():
        reason = reason.replace(original, replacement)
    return f"{where}: {reason}" if where else reason


def _hint(reason: str, path: str, kind: type[Any], table: Mapping[str, Any]) -> str:
    """Return what completes a reason: the right values, or the right name."""
    if unknown := _UNKNOWN.match(reason):
        meant = nearest(kind, path, unknown[1], table)
        names = ", ".join(field_names(kind, path, table))
        return f"; did you mean `{meant}`?" if meant else f"; expected {names}"
    values = allowed_values(kind, path)
    if not values or reason.startswith("Object"):
        return ""
    return f", expected {'one of ' if len(values) > 1 else ''}{', '.join(values)}"


def convert(table: dict[str, Any], kind: type[T], expected: Mapping[str, str]) -> T:
    """Return a table as settings of type ``kind``; raises InvalidTable with all wrong fields.

    A wrong field is removed and the rest converted again. Checks of several fields are reported if no field
    that they may use was removed, and of an array of values the first error.
    """
    rest = _Rest(table)
    problems: list[str] = []
    while len(problems) < MOST_PROBLEMS:
        try:
            settings = msgspec.convert(rest.table, kind)
        except msgspec.ValidationError as unnamed:
            error = rest.with_key(unnamed, kind)
            reason, path = _split(error)
            if not rest.is_consequence(reason, path):
                named = rest.with_original_path(error)
                problems.append(explain(named, expected, kind=kind, table=table))
            if not rest.remove(reason, path):
                break
        else:
            if not problems:
                return settings
            break
    raise InvalidTable(problems)


def _after_removal(path: Keys, array: Keys, number: int) -> Keys | None:
    """Return a path after the removal of an entry of an array; None if it led into the entry."""
    depth = len(array)
    if path[:depth] != array or len(path) == depth:
        return path
    at = int(path[depth])
    return None if at == number else (*array, at - (at > number), *path[depth + 1 :])


class _Rest:
    """What is left of a table from which wrong fields are removed."""

    def __init__(self, table: dict[str, Any]) -> None:
        self.table = copy.deepcopy(table)
        self._removed: set[Keys] = set()
        """Paths of the tables that have lost a field, and of all around them."""
        self._numbers: dict[Keys, list[int]] = {}
        """Original numbers of the remaining entries of arrays that have lost one, by path."""

    def is_consequence(self, reason: str, path: str) -> bool:
        """Whether an error may result from an earlier removal: a table's own check, or a missing field."""
        is_local = reason.startswith(_OF_ONE_FIELD) and not reason.startswith("Object missing")
        return not is_local and tuple(keys_of(path)) in self._removed

    def with_key(self, error: msgspec.ValidationError, kind: type[Any]) -> msgspec.ValidationError:
        """Return the error with the key of the wrong value if msgspec does not name it, as of a parameter."""
        reason, path = _split(error)
        before, unnamed, after = path.partition(_UNNAMED)
        if not unnamed:
            return error
        values = self._at(keys_of(before))
        if not isinstance(values, dict):
            return error
        all_values = dict(values)
        for key, value in all_values.items():
            values.clear()
            values[key] = value
            try:
                msgspec.convert(self.table, kind)
            except msgspec.ValidationError as same:
                if str(same) == str(error):
                    error = msgspec.ValidationError(f"{reason} - at `$.{before}.{key}{after}`")
                    break
        values.clear()
        values.update(all_values)
        return error

    def with_original_path(self, error: msgspec.ValidationError) -> msgspec.ValidationError:
        """Return the error with the numbers that entries of arrays have in the file."""
        reason, path = _split(error)
        parts: list[str] = []
        keys = keys_of(path)
        for depth, key in enumerate(keys):
            if isinstance(key, int):
                numbers = self._numbers.get(tuple(keys[:depth]))
                parts.append(f"[{numbers[key] if numbers else key}]")
            else:
                parts.append(f".{key}")
        return msgspec.ValidationError(f"{reason} - at `${''.join(parts)}`") if parts else error

    def remove(self, reason: str, path: str) -> bool:
        """Remove the field of an error; returns whether there is one."""
        keys = keys_of(path)
        if unknown := _UNKNOWN.match(reason):
            keys.append(unknown[1])
        while keys and isinstance(keys[-1], int) and not _holds_tables(self._at(keys[:-1])):
            keys.pop()  # without one of its values an array has another length
        if not keys:
            return False
        holder, last, at = self._at(keys[:-1]), keys[-1], tuple(keys[:-1])
        if isinstance(holder, list) and isinstance(last, int) and last < len(holder):
            self._renumber(at, last, len(holder))
            del holder[last]
        elif isinstance(holder, dict) and last in holder:
            del holder[last]
        else:
            return False  # a key with a dot or a bracket
        self._removed |= {at[:depth] for depth in range(len(keys))}
        return True

    def _renumber(self, array: Keys, number: int, length: int) -> None:
        """Apply the removal of an entry of an array to the paths that lead into it."""
        self._removed = {
            moved for path in self._removed if (moved := _after_removal(path, array, number)) is not None
        }
        self._numbers = {
            moved: numbers
            for path, numbers in self._numbers.items()
            if (moved := _after_removal(path, array, number)) is not None
        }
        self._numbers.setdefault(array, list(range(length))).pop(number)

    def _at(self, keys: Sequence[str | int]) -> object:
        """Return the value at a path; None if there is none."""
        value: Any = self.table
        for key in keys:
            try:
                value = value[key]
            except (KeyError, IndexError, TypeError):
                return None
        return value


def _holds_tables(array: object) -> bool:
    return isinstance(array, list) and any(isinstance(entry, dict) for entry in array)
