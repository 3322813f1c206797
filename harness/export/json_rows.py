"""Rows of a table as JSON messages, and their JSON schemas.

A column's name, description, unit and frame are those of the table. A vector is an object with its components
(``pos_ned_m``: ``n``, ``e``, ``d``), one without names an array. JSON has no NaN and no infinity, and viewers
reject a field of two types: such a value is left out, so a field of numbers is never required.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.export.messages import Content
from harness.records.columns import Column, TableKind
from harness.records.tables import column_names

Schema = dict[str, Any]
DIALECT = "https://json-schema.org/draft/2020-12/schema"
_TYPES = {"b": "boolean", "i": "integer", "u": "integer", "f": "number", "S": "string", "O": "string"}


def schema_of(
    name: str, kind: TableKind, layout: np.dtype[Any], *, more: Mapping[str, Schema] | None = None
) -> Schema:
    """Return the JSON schema of a row of a table, of the fields of a layout; ``more``: further fields."""
    properties: dict[str, Schema] = {}
    required = []
    for field in layout.names or ():
        column, of_field = kind.columns[field], layout[field]
        single = {"type": _TYPES[of_field.base.kind]}
        components = labels(field, of_field)
        if components is None and of_field.shape:
            described: Schema = {"type": "array", "items": single}
        elif components is not None:
            described = {"type": "object", "properties": dict.fromkeys(components, single)}
        else:
            described = single
        properties[field] = described | {"description": _text(column, field)}
        if not of_field.shape and of_field.kind not in "fO":
            required.append(field)
    return {
        "$schema": DIALECT,
        "title": name,
        "description": f"{kind.description} A message is {kind.row}.",
        "type": "object",
        "properties": properties | dict(more or {}),
        "required": required,
    }


def _text(column: Column, name: str) -> str:
    facts = [f"Unit: {unit}." if (unit := column.unit_of(name)) else ""]
    facts.append(f"Frame: {frame}." if (frame := column.frame_of(name)) else "")
    if column.values:
        facts.append("Values: " + "; ".join(f"{value} {text}" for value, text in column.values.items()) + ".")
    return " ".join([column.description, *filter(None, facts)])


def labels(name: str, layout: np.dtype[Any]) -> list[str] | None:
    """Return the names of a vector's components; None for a single value, or components that are numbered."""
    if not layout.shape:
        return None
    found = [column.rpartition(".")[2] for column in column_names(name, layout)]
    return None if found[0] == "0" else found


def row_contents(rows: NDArray[Any], fields: Sequence[str]) -> list[Content]:
    """Return rows (n,) of a structured dtype as contents of messages, without what is not finite."""
    columns = [_values(name, rows[name], rows.dtype[name]) for name in fields]
    return [
        {name: value for name, value in zip(fields, row, strict=True) if value is not None}
        for row in zip(*columns, strict=True)
    ]


def _values(name: str, values: NDArray[Any], layout: np.dtype[Any]) -> list[Any]:
    """Return the values of a field by row; None: left out."""
    kind = layout.base.kind
    if kind == "S":
        return [text.decode("ascii") for text in values.tolist()]
    if kind == "O":
        return [text or None for text in values.tolist()]
    found: list[Any] = values.tolist()
    is_whole = kind != "f" or bool(np.isfinite(values).all())
    components = labels(name, layout)
    if components is None:
        return (
            found if is_whole or layout.shape else [each if math.isfinite(each) else None for each in found]
        )
    if is_whole:
        return [dict(zip(components, row, strict=True)) for row in found]
    return [
        {label: value for label, value in zip(components, row, strict=True) if math.isfinite(value)} or None
        for row in found
    ]
