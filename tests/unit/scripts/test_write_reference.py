"""The generated reference against the code that it describes, and the schema against the scenarios."""

import dataclasses
import json
import re
import subprocess
import sys
import tomllib
from datetime import datetime

import msgspec
import pytest
from msgspec import Struct
from paths import ROOT

from harness.records.columns import AIR
from harness.records.tables import FLIGHT_RECORD, GAIN_TYPES
from harness.scenario.scenario import Scenario
from harness.simulator.truth_record import AIR_RECORD
from netsim.emulator.log_layout import FRAME_LOG
from reference import run_tables, scenario_fields
from reference.markdown import UndocumentedError, paragraphs, table, unit_and_frame
from reference.run_tables import tables_page
from reference.scenario_fields import scenario_page, scenario_schema
from write_reference import outdated

FOLDER = ROOT / "docs" / "reference"
SCHEMA = json.loads(scenario_schema())
SCENARIOS = sorted((ROOT / "scenarios").glob("*.toml"))
TYPES = {
    "object": dict, "array": list, "string": (str, datetime), "boolean": bool, "integer": int,
    "number": (int, float), "null": type(None),
}  # fmt: skip
BOUNDS = {
    "minimum": lambda value, bound: value >= bound,
    "maximum": lambda value, bound: value <= bound,
    "exclusiveMinimum": lambda value, bound: value > bound,
    "exclusiveMaximum": lambda value, bound: value < bound,
    "multipleOf": lambda value, bound: value % bound == 0,
    "minItems": lambda value, bound: len(value) >= bound,
    "maxItems": lambda value, bound: len(value) <= bound,
    "minLength": lambda value, bound: len(value) >= bound,
    "maxLength": lambda value, bound: len(value) <= bound,
    "pattern": lambda value, pattern: re.search(pattern, value) is not None,
    "enum": lambda value, values: value in values,
}
NOTES = {"title", "description", "default", "$schema", "$defs", "format", "discriminator", "type"}


def errors(value, schema, path="file"):
    """Return what a JSON schema refuses in a value, for the keywords that the scenario's schema uses."""
    if "type" in schema and (
        not isinstance(value, TYPES[schema["type"]])
        or (isinstance(value, bool) and schema["type"] != "boolean")
    ):
        return [f"{path}: expected {schema['type']}"]
    found = []
    for keyword, stated in schema.items():
        if keyword == "$ref":
            found += errors(value, SCHEMA["$defs"][stated.rpartition("/")[2]], path)
        elif keyword == "anyOf":
            if all(errors(value, each, path) for each in stated):
                found.append(f"{path}: {value!r} is none of the alternatives")
        elif keyword == "properties":
            for name in set(stated) & set(value):
                found += errors(value[name], stated[name], f"{path}.{name}")
        elif keyword == "required":
            found += [f"{path}.{name}: missing" for name in stated if name not in value]
        elif keyword == "additionalProperties":
            for name in set(value) - set(schema.get("properties", ())):
                found += (
                    errors(value[name], stated, f"{path}.{name}") if stated else [f"{path}.{name}: unknown"]
                )
        elif keyword == "prefixItems":
            for each, kind in zip(value, stated, strict=False):
                found += errors(each, kind, f"{path}[]")
        elif keyword == "items":
            for each in value if stated else ():
                found += errors(each, stated, f"{path}[]")
        elif keyword in BOUNDS:
            if not BOUNDS[keyword](value, stated):
                found.append(f"{path}: {value!r} against {keyword} {stated!r}")
        else:
            assert keyword in NOTES, keyword
    return found


def test_the_pages_are_current():
    check = [sys.executable, "scripts/write_reference.py", "--check"]
    result = subprocess.run(check, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, f"run scripts/write_reference.py: {result.stdout}{result.stderr}"
    assert not any(str(ROOT) in page.read_text() for page in FOLDER.glob("*.md"))


def test_every_field_of_the_scenario_has_a_row():
    paths = re.findall(r"^\| `([^`]+)` \|", scenario_page(), re.MULTILINE)
    assert len(paths) > 150
    assert {"run.seed", "radio.ftm.clock_ppm", "formation.motion.radius_m", "faults[].offset_m"} <= set(paths)
    flat = {name for name, _ in _leaves(msgspec.to_builtins(Scenario(name="x")))}
    assert flat <= set(paths)


def _leaves(table_, above=""):
    for name, value in table_.items():
        yield above + name, value
        if isinstance(value, dict) and name not in {"params", "per_uav", "px4_env"}:
            yield from _leaves(value, f"{above}{name}.")


class Undescribed(Struct, kw_only=True):
    """A table whose field has no docstring."""

    count: int = 1


def test_a_field_without_a_docstring_is_an_error(monkeypatch):
    monkeypatch.setattr(scenario_fields, "Scenario", Undescribed)
    with pytest.raises(UndocumentedError, match=r"Undescribed\.count"):
        scenario_page()


@pytest.mark.parametrize("path", SCENARIOS, ids=[path.stem for path in SCENARIOS])
def test_the_schema_accepts_the_scenarios(path):
    assert errors(tomllib.loads(path.read_text()), SCHEMA) == []


@pytest.mark.parametrize(
    "text",
    [
        "agentz = 3", "[radio]\nchannle = 1", "[radio.ftm]\nx = 1", '[[faults]]\nkind = "gps_loss"\nx = 1',
        "agents = 0", "agents = true", 'agents = "3"',
        '[wind]\nkind = "gale"', "[formation.motion]\nspeed_m_s = 1",
    ],
)  # fmt: skip
def test_the_schema_refuses_what_the_scenario_refuses(text):
    assert errors(tomllib.loads(text), SCHEMA) != []


def test_every_column_has_a_row():
    page = tables_page()
    for name in (*FLIGHT_RECORD.names, *GAIN_TYPES, *FRAME_LOG.names):
        assert f"| `{name}`" in page


def test_a_column_without_a_description_is_an_error(monkeypatch):
    columns = {name: column for name, column in AIR.columns.items() if name != "busy_ns"}
    layouts = ((dataclasses.replace(AIR, columns=columns), AIR_RECORD),)
    monkeypatch.setattr(run_tables, "LAYOUTS", layouts)
    with pytest.raises(UndocumentedError, match="air: busy_ns"):
        tables_page()


def test_outdated_pages(tmp_path):
    pages = {"a.md": "text\n", "b.md": "more\n"}
    assert outdated(pages, tmp_path / "missing") == ["a.md", "b.md"]
    for name, text in pages.items():
        (tmp_path / name).write_text(text)
    assert outdated(pages, tmp_path) == []
    (tmp_path / "b.md").write_text("other\n")
    assert outdated(pages, tmp_path) == ["b.md"]


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("duration_s", "s"), ("speed_m_s", "m/s"), ("pos_ned_m", "m, NED"), ("offset_frd_m_s2", "m/s², FRD"),
        ("ground_conductivity_s_m", "S/m"), ("odometry_drift_m_sqrt_s", "m/√s"), ("rows", ""),
        ("tx_power_dbm", "dBm"),
        ("bandwidth_bytes_s", "byte/s"), ("columns", ""),
    ],
)  # fmt: skip
def test_units(name, unit):
    assert unit_and_frame(name) == unit


def test_markdown():
    assert table(("a",), [("x|y",)]) == "| a |\n| --- |\n| x\\|y |\n"
    text = paragraphs(
        "One\n    line with ``code``.\n\nArgs:\n    name: what it\n        is.\n\n    print(1)\n"
    )
    assert text == "One line with `code`.\n\nArgs:\n\n- `name`: what it is.\n\n```python\nprint(1)\n```"
