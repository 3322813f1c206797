"""Tables of one short flight: what their metadata state, against the values (10 s)."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS

from harness.launch.one_process import fly
from harness.records.run_folder import RunFolder
from harness.scenario.scenario_file import load

SETTINGS = (
    "agents=4", "formation.columns=2", "formation.rows=2", "formation.height_m=2", "run.duration_s=1",
    "antenna.snapshot_rate_hz=4", "run.seed=7", "site.latitude_deg=50.5",
    "run.epoch_utc=2027-01-01T01:00:00+01:00",
)  # fmt: skip
TABLES = ("flight", "radio", "ftm", "air", "gains")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("flown")
    fly(load(SCENARIOS / "article.toml", SETTINGS), path)
    return RunFolder(path)


def stated(schema, name):
    """Return the metadata of a field as text, without Parquet's own."""
    metadata = schema.field(name).metadata
    return {key.decode(): text.decode() for key, text in metadata.items() if not key.startswith(b"PARQUET:")}


@pytest.mark.parametrize("name", TABLES)
def test_every_table_states_its_run_and_every_field_its_meaning(run, name):
    schema = pq.read_schema(run.path / f"{name}.parquet")
    about = {key.decode(): text.decode() for key, text in schema.metadata.items()}
    assert about["table"] == name
    assert about["description"]
    assert about["row"].startswith("a")
    assert (about["scenario"], about["seed"], about["origin_latitude_deg"]) == ("article", "7", "50.5")
    assert about["time_origin_utc"] == "2027-01-01T00:00:00+00:00"
    assert str(run.path) not in str(about)
    for field in schema.names:
        assert stated(schema, field)["description"].endswith("."), field


def test_fields_state_units_and_frames(run):
    schema = pq.read_schema(run.flight)
    assert stated(schema, "vel_ned_m_s.e") == {
        "description": "True velocity over ground. Component: east.",
        "unit": "m/s",
        "frame": "NED",
    }
    assert stated(schema, "q_ned_frd.w")["frame"] == "FRD to NED"
    assert stated(schema, "onboard_pos_std_m.n")["frame"] == "NED"
    assert set(stated(schema, "alive")) == {"description"}
    assert stated(pq.read_schema(run.ftm), "rssi_dbm")["unit"] == "dBm"
    assert stated(pq.read_schema(run.radio), "bytes")["unit"] == "byte"


@pytest.mark.parametrize(
    ("name", "field"),
    [("radio", "kind"), ("radio", "mode"), ("ftm", "status"), ("flight", "mode"), ("flight", "phase")],
)
def test_every_value_of_an_enumeration_has_a_meaning(run, name, field):
    table = pq.read_table(run.path / f"{name}.parquet", columns=[field])
    values = json.loads(stated(table.schema, field)["values"])
    found = {str(value) for value in table[field].unique().to_pylist()}
    assert found
    assert found <= set(values)
    assert all(values.values())


def test_bits_of_causes_are_all_described(run):
    bits = [int(bit) for bit in json.loads(stated(pq.read_schema(run.flight), "causes")["values"])]
    assert bits == [2**k for k in range(len(bits))]
    causes = pq.read_table(run.flight)["causes"].to_numpy()
    assert not np.any(causes & ~np.uint32(sum(bits)))
