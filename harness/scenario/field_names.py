"""Names and allowed values of the fields of nested settings, for error messages.

Works on any tree of msgspec structs; paths are those of msgspec's errors, such as ``faults[0].kind``.
"""

import difflib
import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import msgspec

_KEYS = re.compile(r"[^.\[\]]+|\[\d+\]")
_LEAST_SIMILARITY = 0.72
"""Of two names, by difflib: ``heigth_m`` and ``height_m`` have 0.88, ``seed`` and ``speed`` 0.67."""
_SYNONYMS = {
    "altitude": "formation.height_m",
    "channel_width": "radio.bandwidth_mhz",
    "count": "agents",
    "drones": "agents",
    "force": "wind.mean_n",
    "mcs": "radio.broadcast_mode",
    "n": "agents",
    "rate": "radio.broadcast_mode",
    "time": "run.duration_s",
    "uavs": "agents",
    "vehicles": "agents",
}
"""Fields by other words for them, which are used in the field's table or in none."""


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


def _types_at(
    root: type[Any], path: str, table: Mapping[str, Any] = MappingProxyType({})
) -> list[msgspec.inspect.Type]:
    """Return the types of the field at a path; none if there is no such field.

    Of a union of tagged tables it is the one that the tag selects in ``table``, or all without it.
    """
    found = [msgspec.inspect.type_info(root)]
    value: Any = table
    for key in keys_of(path):
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            value = None
        reached: list[msgspec.inspect.Type] = []
        for kind in found:
            if isinstance(kind, msgspec.inspect.StructType):
                reached += [field.type for field in kind.fields if field.encode_name == key]
            elif isinstance(kind, msgspec.inspect.VarTupleType | msgspec.inspect.ListType):
                reached.append(kind.item_type)
            elif isinstance(kind, msgspec.inspect.DictType):
                reached.append(kind.value_type)
        found = [each for kind in reached for each in _alternatives(kind)]
        found = [each for each in found if _is_selected(each, value)] or found
    return found


def _is_selected(kind: msgspec.inspect.Type, value: object) -> bool:
    """Whether a value has the tag of a type; always if the type has none."""
    if not isinstance(kind, msgspec.inspect.StructType) or kind.tag_field is None:
        return True
    return isinstance(value, dict) and value.get(kind.tag_field) == kind.tag


def allowed_values(root: type[Any], path: str) -> tuple[str, ...]:
    """Return the values of an enumeration at a path, as in TOML; none if the field has another type."""
    kinds = _types_at(root, path)
    values = [
        str(value) for kind in kinds if isinstance(kind, msgspec.inspect.LiteralType) for value in kind.values
    ]
    if values and any(isinstance(kind, msgspec.inspect.BoolType) for kind in kinds):
        values += ["true", "false"]
    return tuple(values)


def field_names(
    root: type[Any], path: str, table: Mapping[str, Any] = MappingProxyType({})
) -> tuple[str, ...]:
    """Return the names of the fields of the table at a path, in order; see `_types_at` for ``table``."""
    return tuple(
        dict.fromkeys(
            field.encode_name
            for kind in _types_at(root, path, table)
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


def nearest(
    root: type[Any], path: str, key: str, table: Mapping[str, Any] = MappingProxyType({})
) -> str | None:
    """Return the path of the field that was probably meant by an unknown key of the table at a path.

    That is the most similar name of the same table, or the only field of this name elsewhere; None if there
    is nothing similar.
    """
    meant = _SYNONYMS.get(key.lower())
    if meant is not None and path in {"", meant.rpartition(".")[0]}:
        return meant
    similar = difflib.get_close_matches(key, field_names(root, path, table), 1, _LEAST_SIMILARITY)
    if similar:
        return f"{path}.{similar[0]}" if path else similar[0]
    elsewhere = [each for each in all_fields(root) if each.rpartition(".")[2] == key]
    return elsewhere[0] if len(elsewhere) == 1 else None
