"""What of a scenario differs from the defaults of its fields."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import msgspec
from msgspec import Struct

from foundation.docstrings import field_docstrings

MOST_LETTERS = 600
"""Letters of a value that are shown; the manifest has all"""


@dataclass(frozen=True, slots=True)
class Change:
    """A field with another value than its default."""

    path: str
    value: str
    default: str
    description: str


def changes(settings: Struct, above: str = "") -> Iterator[Change]:
    """Yield the fields of settings that differ from their defaults, nested ones by their dotted paths.

    A field without a default, such as a name, is left out.
    """
    for each in msgspec.structs.fields(settings):
        if each.default is not msgspec.NODEFAULT:
            default = each.default
        elif each.default_factory is not msgspec.NODEFAULT:
            default = each.default_factory()
        else:
            continue
        value = getattr(settings, each.name)
        yield from _compared(settings, each.name, value, default, f"{above}{each.name}")


def _compared(owner: Struct, name: str, value: Any, default: Any, path: str) -> Iterator[Change]:  # noqa: ANN401
    if value == default:
        return
    if isinstance(value, Struct) and type(value) is type(default):
        yield from _between(value, default, path)
        return
    description = " ".join(field_docstrings(type(owner)).get(name, "").split())
    yield Change(path, _text(value), _text(default), description)


def _between(value: Struct, default: Struct, path: str) -> Iterator[Change]:
    """Yield the fields in which two objects of one type differ."""
    for each in msgspec.structs.fields(value):
        own, usual = getattr(value, each.name), getattr(default, each.name)
        yield from _compared(value, each.name, own, usual, f"{path}.{each.name}")


def _text(value: Any) -> str:  # noqa: ANN401  any value of a scenario
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]} …"
