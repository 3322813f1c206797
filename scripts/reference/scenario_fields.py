"""The page of all fields of a scenario, and the JSON schema of scenario files for editors."""

import inspect
import json
from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import NODEFAULT, Struct
from msgspec.inspect import (
    AnyType,
    BoolType,
    CollectionType,
    DateTimeType,
    DictType,
    Field,
    FloatType,
    IntType,
    LiteralType,
    Metadata,
    NoneType,
    StrType,
    StructType,
    TupleType,
    Type,
    UnionType,
    VarTupleType,
    type_info,
)

from foundation.docstrings import field_docstrings
from harness.campaign.values import toml_text
from harness.scenario.scenario import Scenario
from reference.markdown import UndocumentedError, one_line, table, unit_and_frame

SCHEMA_FILE = "scenario.schema.json"
NO_BREAK = "\u00a0"
"""A space at which no line is broken."""
INTRODUCTION = f"""# Scenario

A scenario is a TOML file that decides a run; equal scenarios give equal logs. A file holds only what differs
from the defaults; entries of arrays of tables have fields that are required. A field is also set by its path
on the command line, as in `--set wind.mean_n=2` or, of the first fault, `--set faults.0.uav=3`. Unknown
fields and values out of range are refused with a line for each that names the path.

Paths with `[]` belong to arrays of tables, such as `[[faults]]`, those with `NAME` to tables with names of
their own, such as `[vehicle.per_uav.3]`. `optional` fields may be left out: TOML has
no empty value. Units are those that the names end in; NED is north, east, down from the site's origin, FRD
forward, right, down of the vehicle's body. The parameters of `autopilot.params` are in
[Parameters](parameters.md).

Editors complete and check scenario files with the JSON schema [{SCHEMA_FILE}]({SCHEMA_FILE}).
With Taplo, for example, the first line of the file is

```toml
#:schema ../docs/reference/{SCHEMA_FILE}
```

This page is generated from the code by `scripts/write_reference.py`.
"""


def _all_tables() -> list[tuple[str, StructType]]:
    (scenario,), _ = _unwrapped(type_info(Scenario))
    return list(_tables(scenario, ""))


def scenario_page() -> str:
    """Return the page; raises UndocumentedError for a field without a docstring."""
    parts = [INTRODUCTION]
    for path, info in _all_tables():
        parts += [f"## {_heading(path, info)}\n", one_line(inspect.getdoc(info.cls) or "") + "\n"]
        if rows := list(_rows(path, info)):
            parts.append(table(("field", "type", "unit", "range", "default", "meaning"), rows))
    return "\n".join(parts)


def scenario_schema() -> str:
    """Return the JSON schema of scenario files, with the docstrings as descriptions."""
    schema = msgspec.json.schema(Scenario)
    kinds = {info.cls.__name__: info.cls for _, info in _all_tables()}
    for name, definition in schema["$defs"].items():
        texts = field_docstrings(kinds[name])
        for field, property_ in definition["properties"].items():
            if field in texts:
                property_["description"] = " ".join(texts[field].split())
            if "$ref" in property_:
                property_.pop("default", None)  # a whole table: its own fields state their defaults
        definition["description"] = " ".join(definition.get("description", "").split())
    top = schema["$defs"]["Scenario"]
    top["required"].remove("name")  # the file's name stands in for it
    return json.dumps(
        {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "coflight scenario", **schema},
        indent=1, ensure_ascii=False,
    ) + "\n"  # fmt: skip


def _tables(info: StructType, path: str) -> Iterator[tuple[str, StructType]]:
    """Yield every table of the file with its path, a tagged union's variants one after the other."""
    yield path, info
    for each in info.fields:
        inner, suffix = _unwrapped(each.type)
        for variant in inner:
            yield from _tables(variant, _join(path, each.encode_name) + suffix)


_KINDS = {"": "table", "[]": "array of tables", ".NAME": "tables by name"}
"""What a field with tables is, by the suffix of its path."""


def _unwrapped(kind: Type) -> tuple[list[StructType], str]:
    """Return the tables that a field holds, if it holds any, and the suffix of their path."""
    match kind:
        case Metadata(type=inner):
            return _unwrapped(inner)
        case StructType():
            return [kind], ""
        case UnionType(types=types):
            return [each for each in types if isinstance(each, StructType)], ""
        case VarTupleType(item_type=item):
            return _unwrapped(item)[0], "[]"
        case DictType(value_type=value):
            return _unwrapped(value)[0], ".NAME"
    return [], ""


def _rows(path: str, info: StructType) -> Iterator[tuple[str, ...]]:
    texts = field_docstrings(info.cls)
    if info.tag_field is not None:
        meaning = "Which of the kinds of table it is."
        yield f"`{_join(path, info.tag_field)}`", f'`"{info.tag}"`', "", "", "required", meaning
    for each in info.fields:
        if not texts.get(each.name, "").strip():
            raise UndocumentedError(
                f"{info.cls.__module__}.{info.cls.__name__}.{each.name}: a field of the scenario without a "
                "docstring"
            )
        inner, suffix = _unwrapped(each.type)
        is_text = _may_be_text(each.type)
        kind = "text or table" if inner and is_text else _KINDS[suffix] if inner else _type(each.type)
        unit = "" if inner else unit_and_frame(each.name)
        yield (
            f"`{_join(path, each.encode_name)}`", kind, unit, "" if inner else _range(each.type),
            _default(each, info, is_table=bool(inner) and not is_text), one_line(texts[each.name]),
        )  # fmt: skip


def _may_be_text(kind: Type) -> bool:
    """Whether a text may stand instead of a table."""
    types = kind.types if isinstance(kind, UnionType) else (kind,)
    return any(isinstance(each.type if isinstance(each, Metadata) else each, StrType) for each in types)


def _heading(path: str, info: StructType) -> str:
    if not path:
        return "Top of the file"
    brackets = f"[[{path.replace('[]', '')}]]" if path.endswith("[]") else f"[{path}]"
    return f'`{brackets}`, {info.tag_field} "{info.tag}"' if info.tag_field is not None else f"`{brackets}`"


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _type(kind: Type) -> str:
    match kind:
        case Metadata(type=inner):
            return _type(inner)
        case BoolType():
            return "true or false"
        case IntType():
            return "integer"
        case FloatType():
            return "number"
        case StrType():
            return "text"
        case DateTimeType():
            return "date and time"
        case LiteralType(values=values):
            return ", ".join(f"`{toml_text(value)}`" for value in values)
        case UnionType(types=types):
            known = [_type(each) for each in types if not isinstance(each, NoneType)]
            return " or ".join(known)
        case TupleType(item_types=items):
            return f"array of {len(items)} {_plural(_type(items[0]))}"
        case VarTupleType(item_type=item) | CollectionType(item_type=item):
            return f"array of {_plural(_type(item))}"
        case DictType(key_type=key, value_type=value):
            return f"table, {_type(key)} → {_type(value)}"
        case AnyType():
            return "any value"
    raise TypeError(f"{kind}: no description of such a type")


def _plural(name: str) -> str:
    if name.startswith("array "):
        return name.replace("array", "arrays", 1)
    return name if name in {"text", "true or false"} or "`" in name else f"{name}s"


def _range(kind: Type) -> str:
    """Return the bounds that the type states, those of an array's elements included."""
    match kind:
        case Metadata(type=inner):
            return _range(inner)
        case UnionType(types=types):
            return "; ".join(filter(None, map(_range, types)))
        case TupleType(item_types=items):
            return _range(items[0])
        case VarTupleType(item_type=item, min_length=least, max_length=most):
            return "; ".join(filter(None, [_length(least, most), _range(item)]))
        case StrType(pattern=pattern, min_length=least, max_length=most):
            return "; ".join(filter(None, [f"`{pattern}`" if pattern else "", _length(least, most)]))
        case (
            IntType(gt=gt, ge=ge, lt=lt, le=le, multiple_of=step)
            | FloatType(gt=gt, ge=ge, lt=lt, le=le, multiple_of=step)
        ):
            low = f">{NO_BREAK}{gt:g}" if gt is not None else _number(ge)
            high = f"<{NO_BREAK}{lt:g}" if lt is not None else _number(le)
            if low == high and low:
                text = f"{low} only"
            elif low and high:
                text = f"{low}{NO_BREAK}..{NO_BREAK}{high}"
            else:
                text = f"≥{NO_BREAK}{low}" if low else f"≤{NO_BREAK}{high}" if high else ""
            return f"{text}, multiple of {step}" if step is not None else text
    return ""


def _length(least: int | None, most: int | None) -> str:
    ends = [f"at least {least}" if least is not None else "", f"at most {most}" if most is not None else ""]
    return " and ".join(filter(None, ends)) + (" long" if any(ends) else "")


def _number(value: float | None) -> str:
    if value is None:
        return ""
    powers = {2**63 - 1: "2^63 - 1", 2**31: "2^31"}
    return powers.get(int(value), f"{value:.10g}") if isinstance(value, int) else f"{value:.10g}"


def _default(each: Field, info: StructType, *, is_table: bool) -> str:
    if info.cls is Scenario and each.name == "name":
        return "the file's name"
    if each.required:
        return "required"
    value: Any = each.default if each.default is not NODEFAULT else each.default_factory()
    if value is None:
        return "optional"
    if is_table or isinstance(value, Struct):
        return ""
    return f"`{toml_text(list(value) if isinstance(value, tuple) else value)}`"
