"""Tables of one short flight: what their metadata state, against the values (10 s)."""

import hashlib
import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS

from autopilot.logs.vehicle_record import NO_PHASE
from autopilot.onboard.factory import layout_of
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.parameters.onboard_config import OnboardConfig
from foundation import exit_status
from harness.cli import export
from harness.launch.one_process import fly
from harness.records import columns
from harness.records.run_folder import RunFolder
from harness.records.wide import widen
from harness.scenario.scenario_file import load
from netsim.phy.frames import FrameKind
from netsim.phy.modes import MODE_NAMES
from netsim.phy.receptions import OUTCOMES, STATES

SETTINGS = (
    "agents=4", "formation.columns=2", "formation.rows=2", "formation.height_m=2", "run.duration_s=1",
    "antenna.snapshot_rate_hz=4", "run.seed=7", "site.latitude_deg=50.5",
    "radio.log_receptions=true", "run.epoch_utc=2027-01-01T01:00:00+01:00",
)  # fmt: skip
TABLES = ("flight", "radio", "receptions", "ftm", "air", "gains")

FLIGHT = columns.flight_kind(layout_of(OnboardConfig()))


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
    [
        ("radio", "kind"),
        ("radio", "mode"),
        ("receptions", "outcome"),
        ("receptions", "reception"),
        ("ftm", "status"),
        ("flight", "mode"),
        ("flight", "phase"),
    ],
)
def test_every_value_of_an_enumeration_has_a_meaning(run, name, field):
    table = pq.read_table(run.path / f"{name}.parquet", columns=[field])
    values = json.loads(stated(table.schema, field)["values"])
    found = {str(value) for value in table[field].unique().to_pylist()}
    assert found
    assert found <= set(values)
    assert all(values.values())


@pytest.mark.parametrize(
    ("table", "field", "values"),
    [
        (columns.RECEPTIONS, "outcome", OUTCOMES),
        (columns.RECEPTIONS, "reception", STATES),
        (columns.RADIO, "mode", MODE_NAMES),
        (columns.RADIO, "kind", [kind.value for kind in FrameKind]),
        (
            columns.flight_kind(layout_of(OnboardConfig())),
            "phase",
            [str(int(phase)) for phase in FlightPhase] + [str(NO_PHASE)],
        ),
    ],
)
def test_all_possible_values_of_an_enumeration_have_a_meaning(table, field, values):
    assert set(table.columns[field].values) == set(values)


def test_bits_of_causes_are_all_described(run):
    bits = [int(bit) for bit in json.loads(stated(pq.read_schema(run.flight), "causes")["values"])]
    assert bits == [2**k for k in range(len(bits))]
    causes = pq.read_table(run.flight)["causes"].to_numpy()
    assert not np.any(causes & ~np.uint32(sum(bits)))


def test_receptions_join_with_their_frames(run):
    """One row per frame and other station, with the counts and times of the frame's row."""
    radio, receptions = pq.read_table(run.radio).to_pandas(), pq.read_table(run.receptions).to_pandas()
    assert len(receptions) == 3 * len(radio)
    joined = receptions.merge(radio, left_on="frame", right_index=True, suffixes=("", "_of_frame"))
    assert (joined["start_ns"] == joined["start_ns_of_frame"]).all()
    assert (joined["source"] == joined["source_of_frame"]).all()
    for outcome in ("delivered", "collided", "lost_to_noise"):
        counted = receptions[receptions["outcome"] == outcome].groupby("frame").size()
        assert (counted.reindex(radio.index, fill_value=0) == radio[outcome]).all()
    unicast = joined[(joined["destination"] >= 0) & (joined["outcome"] != "not_addressed")]
    assert (unicast["receiver"] == unicast["destination"]).all()
    hashes = json.loads(run.manifest.read_text())["logs_sha256"]
    assert hashes["receptions.parquet"] == hashlib.sha256(run.receptions.read_bytes()).hexdigest()


# ---- the wide form


def exported(run, target, capsys):
    """Return status and error line of an export in wide form."""
    status = export.main([str(run.path), "--wide", str(target)])
    return status, capsys.readouterr().err


def test_the_wide_form_has_every_value_of_every_vehicle(run, tmp_path, capsys):
    flight, path = pq.read_table(run.flight).to_pandas(), tmp_path / "wide.parquet"
    assert exported(run, path, capsys) == (exit_status.FINE, "")
    wide = pq.read_table(path).to_pandas()
    assert len(wide.columns) == 1 + 4 * (len(flight.columns) - 2)
    for uav, group in flight.groupby("uav"):
        of_vehicle = wide[["time_us", *(name for name in wide if name.startswith(f"uav{uav}."))]]
        of_vehicle.columns = [name.removeprefix(f"uav{uav}.") for name in of_vehicle]
        pd.testing.assert_frame_equal(of_vehicle, group.drop(columns="uav").reset_index(drop=True))


def test_the_wide_form_keeps_the_metadata_in_parquet(run, tmp_path, capsys):
    exported(run, tmp_path / "wide.parquet", capsys)
    schema, long = pq.read_schema(tmp_path / "wide.parquet"), pq.read_schema(run.flight)
    assert schema.metadata == long.metadata | {b"row": b"a recorded instant (`run.record_rate_hz`)"}
    assert stated(schema, "uav3.vel_ned_m_s.e") == stated(long, "vel_ned_m_s.e")


def test_the_wide_form_as_csv_has_the_same_numbers(run, tmp_path, capsys):
    for name in ("wide.csv", "wide.parquet"):
        assert exported(run, tmp_path / name, capsys)[0] == exit_status.FINE
    wide = pq.read_table(tmp_path / "wide.parquet").to_pandas()
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "wide.csv"), wide, check_dtype=False)


@pytest.mark.parametrize(
    "rows",
    [[(0, 0), (0, 1), (4, 0)], [(0, 1), (0, 0)], [(0, 0), (4, 1)], [(0, 0), (0, 0), (4, 0)]],
    ids=["incomplete", "out of order", "of two instants", "twice"],
)
def test_a_table_whose_instants_lack_vehicles_has_no_wide_form(rows):
    time_us, uav = zip(*rows, strict=True)
    with pytest.raises(ValueError, match="an instant lacks a vehicle"):
        widen(pa.table({"time_us": time_us, "uav": pa.array(uav, pa.int16()), "alive": [True] * len(rows)}))


def test_an_empty_flight_has_an_empty_wide_form(run):
    wide = widen(pq.read_table(run.flight).slice(0, 0))
    assert (wide.num_rows, wide.column_names) == (0, ["time_us"])


def test_a_refused_export_is_one_line_and_status_2(run, tmp_path, capsys):
    def refused(*arguments):
        assert export.main([str(argument) for argument in arguments]) == exit_status.BAD_INPUT
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        return line

    before = run.flight.read_bytes()
    assert "ends in .parquet or .csv" in refused(run.path, "--wide", tmp_path / "wide.xlsx")
    assert "the run's own table" in refused(run.path, "--wide", run.flight)
    assert "no run that has ended" in refused(tmp_path, "--wide", tmp_path / "wide.csv")
    assert "No such file" in refused(run.path, "--wide", tmp_path / "nowhere" / "wide.csv")
    assert "one of --time" in refused(run.path)
    assert "one of --time" in refused(run.path, "--time", 5, "--wide", tmp_path / "wide.csv")
    assert "--out" in refused(run.path, "--wide", tmp_path / "wide.csv", "--out", tmp_path / "x")
    assert run.flight.read_bytes() == before
