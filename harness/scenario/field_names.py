"""Names and allowed values of the fields of nested settings, for error messages.

Works on any tree of msgspec structs; paths are those of msgspec's errors, such as ``faults[0].kind``.
"""

import difflib
import re
from collections.abc import Iterator
from typing import Any

import msgspec

_KEYS = re.compile(r"[^.\[\]]+|\[\d+\]")
_LEAST_SIMILARITY = 0.72
"""Of two names, by difflib: ``heigth_m`` and ``height_m`` have 0.88, ``seed`` and ``speed`` 0.67."""
_SYNONYMS = {
    "altitude": "height_m",
    "channel_width": "bandwidth_mhz",
    "count": "agents",
    "drones": "agents",
    "force": "mean_n",
    "mcs": "broadcast_mode",
    "n": "agents",
    "rate": "broadcast_mode",
    "time": "duration_s",
    "uavs": "agents",
    "vehicles": "agents",
}
"""Other words for a field's name; ``radio`` for example has no ``mcs``."""


def keys_of(path: str) -> list[str | int]:
    """Return the keys of a path: ``faults[0].kind`` gives ``["faults", 0, "kind"]``."""
    return [int(key[1:-1]) if key.startswith("[") else key for key in _KEYS.findall(path)]


def _alternatives(kind: msgspec.inspect.Type) -> list[msgspec.inspect.Type]:
    """Return the types that a value may have, without annotations and None."""
    if isinstance(kind, msgspec.inspect.Metadata):
        return _alternatives(kind.type)
    if isinstance(kind, msgspec.inspect.UnionType):
        return [each for member in kind.types for each in _alternatives(member)]
    return [] if isinstance(kind, msgspec.inspect.NoneType) else [kind]


def _types_at(root: type[Any], path: str) -> list[msgspec.inspect.Type]:
    """Return the types of the field at a path; none if there is no such field."""
    found = [msgspec.inspect.type_info(root)]
    for key in keys_of(path):
        reached: list[msgspec.inspect.Type] = []
        for kind in found:
            if isinstance(kind, msgspec.inspect.StructType):
                reached += [field.type for field in kind.fields if field.encode_name == key]
            elif isinstance(kind, msgspec.inspect.VarTupleType | msgspec.inspect.ListType):
                reached.append(kind.item_type)
            elif isinstance(kind, msgspec.inspect.DictType):
                reached.append(kind.value_type)
        found = [each for kind in reached for each in _alternatives(kind)]
    return found


def allowed_values(root: type[Any], path: str) -> tuple[str, ...]:
    """Return the values of an enumeration at a path; none if the field has another type."""
    return tuple(
        str(value)
        for kind in _types_at(root, path)
        if isinstance(kind, msgspec.inspect.LiteralType)
        for value in kind.values
    )


def field_names(root: type[Any], path: str) -> tuple[str, ...]:
    """Return the names of the fields of the table at a path, in order."""
    return tuple(
        dict.fromkeys(
            field.encode_name
            for kind in _types_at(root, path)
            if isinstance(kind, msgspec.inspect.StructType)
            for field in kind.fields
        )
    )


def all_fields(root: type[Any]) -> tuple[str, ...]:
    """Return the paths of all fields of nested tables, without those of tables in arrays."""

    def below(kind: msgspec.inspect.Type, path: str) -> Iterator[str]:
        for each in _alternatives(kind):
            if isinstance(each, msgspec.inspect.StructType):
                for field in each.fields:
                    name = f"{path}.{field.encode_name}".lstrip(".")
                    yield name
                    yield from below(field.type, name)

    return tuple(dict.fromkeys(below(msgspec.inspect.type_info(root), "")))


def nearest(root: type[Any], path: str, key: str) -> str | None:
    """Return the path of the field that was probably meant by an unknown key of the table at a path.

    That is the most similar name of the same table, or a field of this name elsewhere, or the most similar
    one; None if there is nothing similar.
    """
    table = field_names(root, path)
    prefix = f"{path}." if path else ""
    synonym = _SYNONYMS.get(key.lower())
    if synonym in table:
        return prefix + synonym
    similar = difflib.get_close_matches(key, table, 1, _LEAST_SIMILARITY)
    if similar:
        return prefix + similar[0]
    last_names: dict[str, str] = {}
    for each in all_fields(root):
        last_names.setdefault(each.rpartition(".")[2], each)
    for name in (key, synonym):
        if name in last_names:
            return last_names[name]
    similar = difflib.get_close_matches(key, last_names, 1, _LEAST_SIMILARITY)
    return last_names[similar[0]] if similar else None
