"""Conversion of nested tables to settings: one line for each wrong field, with its path and the reason."""

import copy
import re
from collections.abc import Mapping
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
) -> str:
    """Return ``wind.mean_n: expected `float` >= 0.0`` for ``Expected `float` >= 0.0 - at `$.wind.mean_n```.

    ``expected`` describes expected values where the type is not sufficient, by a pattern of the whole path,
    which begins with ``root``. With ``kind``, the type of the whole table, the line also has the values of an
    enumeration, and for an unknown key the field that was probably meant.
    """
    reason, path = _split(error)
    where = f"{root}.{path}".strip(".") if root else path
    described = False
    for pattern, description in expected.items():
        if re.fullmatch(pattern, where):
            reason = re.sub(r"^Expected `\w+ \| [^`]*`", f"expected {description}", reason)
            if reason.startswith("Invalid"):
                reason, described = f"{reason}, expected {description}", True
    if kind is not None and not described:
        reason += _hint(reason, path, kind)
    for original, replacement in _WORDS.items():
        reason = reason.replace(original, replacement)
    return f"{where}: {reason}" if where else reason


def _hint(reason: str, path: str, kind: type[Any]) -> str:
    """Return what completes a reason: the right values, or the right name."""
    if reason.startswith("Invalid enum value"):
        values = allowed_values(kind, path)
        return f", expected {'one of ' if len(values) > 1 else ''}{', '.join(values)}" if values else ""
    if unknown := _UNKNOWN.match(reason):
        meant = nearest(kind, path, unknown[1])
        return f"; did you mean `{meant}`?" if meant else f"; expected {', '.join(field_names(kind, path))}"
    return ""


def convert(table: dict[str, Any], kind: type[T], expected: Mapping[str, str]) -> T:
    """Return a table as settings of type ``kind``; raises InvalidTable with all wrong fields.

    A wrong field is removed and the rest converted again. Checks of several fields are reported if no field
    that they may use was removed.
    """
    rest = _Rest(table)
    problems: list[str] = []
    while len(problems) < MOST_PROBLEMS:
        try:
            settings = msgspec.convert(rest.table, kind)
        except msgspec.ValidationError as error:
            reason, path = _split(error)
            if not rest.is_consequence(reason, path):
                problems.append(explain(rest.with_original_path(error), expected, kind=kind))
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
        holder: Any = self.table
        for key in keys[:-1]:
            try:
                holder = holder[key]
            except (KeyError, IndexError, TypeError):
                return False  # msgspec does not name the key, such as of a parameter
        if not keys:
            return False
        last = keys[-1]
        if isinstance(holder, list) and isinstance(last, int) and last < len(holder):
            at = tuple(keys[:-1])
            self._numbers.setdefault(at, list(range(len(holder)))).pop(last)
            moved = (_after_removal(each, at, last) for each in self._removed)
            self._removed = {each for each in moved if each is not None}
        elif not (isinstance(holder, dict) and last in holder):
            return False
        del holder[last]
        self._removed |= {tuple(keys[:depth]) for depth in range(len(keys))}
        return True
