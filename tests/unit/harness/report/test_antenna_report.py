"""The antenna's part of a run's report: its numbers, its files, and decks of any instant (5 s)."""

import hashlib
import json
import re
import shutil

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
import xarray as xr
from paths import SCENARIOS

from antenna.model.config import AntennaConfig
from foundation import exit_status
from harness.cli import export_deck
from harness.cli.export_deck import DeckRefused, deck_at
from harness.launch.one_process import fly
from harness.records.flight import Flight
from harness.records.run_folder import RunFolder
from harness.report import antenna_report
from harness.report.report import LOGS
from harness.scenario.scenario_file import load

ARTICLE = SCENARIOS / "article.toml"
SMALL = (
    "agents=2", "formation.columns=2", "formation.rows=1", "formation.height_m=2", "onboard.localisation=gps",
    "run.duration_s=1", "antenna.snapshot_rate_hz=4", "antenna.keep_patterns=true",
)  # fmt: skip
LENGTH_M = 0.05


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One flight of two vehicles with all files of its antenna."""
    path = tmp_path_factory.mktemp("flown")
    fly(load(ARTICLE, SMALL), path)
    return RunFolder(path)


def _json(path):
    return json.loads(path.read_text())


def _wires_m(deck):
    """Return the ends (n, 2, 3) of a deck's wires."""
    cards = [line.split() for line in deck.splitlines() if line.startswith("GW")]
    return np.array([card[3:9] for card in cards], float).reshape(-1, 2, 3)


# ---- files of a run


def test_the_gains_of_a_run_are_a_table_that_is_not_part_of_its_hash(run):
    """The angle between +y and (theta, phi) is arccos(sin theta sin phi)."""
    gains = pq.read_table(run.gains).to_pydict()
    reported = _json(run.summary)["max_gain_dbi"]
    assert np.mean(gains["max_gain_dbi"]) == pytest.approx(reported["mean"], abs=1e-4)
    assert len(gains["time_us"]) == reported["patterns"] >= 4
    assert gains["missing"] == [None] * reported["patterns"]
    theta, phi = np.radians(gains["max_theta_deg"]), np.radians(gains["max_phi_deg"])
    away_deg = np.degrees(np.arccos(np.sin(theta) * np.sin(phi)))
    np.testing.assert_allclose(gains["pointing_error_deg"], away_deg, atol=1e-4)
    hashes = [hashlib.sha256((run.path / name).read_bytes()).hexdigest() for name in LOGS]
    assert hashlib.sha256("".join(hashes).encode()).hexdigest() == _json(run.summary)["log_sha256"]


def test_manifest_and_summary_name_the_solver_and_its_accuracy(run):
    reported = _json(run.manifest)["antenna"]
    assert reported["backend"] == "batch"
    assert "0.01 dB" in reported["accuracy"]  # of small elements
    numbers = _json(run.summary)["max_gain_dbi"]
    assert {name: numbers[name] for name in reported} == reported


def test_patterns_are_stored_on_request(run):
    kept = xr.load_dataset(run.patterns, engine="h5netcdf")
    gains = pq.read_table(run.gains).to_pydict()
    assert kept["time"].values.tolist() == gains["time_us"]
    np.testing.assert_array_equal(kept["max_gain_dbi"].values, gains["max_gain_dbi"])
    assert msgspec.json.decode(kept["settings"].item(), type=AntennaConfig) == load(ARTICLE, SMALL).antenna


def test_a_deck_has_the_vehicles_true_positions(run):
    """Dipoles at true positions: x is east and y north of the centre of the places, z is up."""
    flight = pq.read_table(run.flight).to_pandas()
    time_us = flight["time_us"][400]
    at = flight[flight["time_us"] == time_us]
    wires_m = _wires_m(deck_at(run.path, time_us * 1e-6 + 0.004))  # nearest to this instant
    north_east_m = at[["pos_ned_m.n", "pos_ned_m.e"]].to_numpy()
    np.testing.assert_allclose(wires_m.mean(axis=1)[:, [1, 0]], north_east_m, atol=1e-6)
    np.testing.assert_allclose(wires_m.mean(axis=1)[:, 2], -at["pos_ned_m.d"].to_numpy() - 2.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(np.diff(wires_m, axis=1)[:, 0], axis=1), LENGTH_M, atol=1e-6)


def test_every_run_has_the_deck_of_its_median_instant(run):
    deck = run.deck.read_text()
    assert deck.startswith("CM t = ")
    time_s = float(deck.split()[3])
    gains = pq.read_table(run.gains).to_pandas().set_index("time_us")["max_gain_dbi"]
    below = int((gains < gains[round(time_s * 1e6)]).sum())
    assert below == (len(gains) - 1) // 2
    assert deck.splitlines()[1:] == deck_at(run.path, time_s).splitlines()[1:]


# ---- decks of any instant, refused


def test_a_refused_deck_is_one_line_and_status_2(run, tmp_path, capsys):
    def refused(*arguments):
        assert export_deck.main([str(argument) for argument in arguments]) == exit_status.BAD_INPUT
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        return line

    assert "the run has t = 0.040 to" in refused(run.path, "--time", 1e4)
    assert "the run has t = 0.040 to" in refused(run.path, "--time", "nan")
    assert "it has no manifest.json" in refused(tmp_path, "--time", 1)
    assert "No such file" in refused(run.path, "--time", 5, "--out", tmp_path / "nowhere" / "x")
    other = RunFolder(tmp_path)
    for file in (run.flight, run.events):
        shutil.copy(file, tmp_path)
    other.manifest.write_text("{")
    assert "not JSON" in refused(tmp_path, "--time", 5)
    manifest = _json(run.manifest)
    manifest["scenario"]["antenna"]["element_length_m"] = 10.0  # at places 2 m over the ground
    manifest["scenario"]["antenna"] |= {"ground": "perfect", "element_radius_m": 0.001}
    other.manifest.write_text(json.dumps(manifest))
    assert re.search(
        r"t = 5\.000 s: the antenna of UAV \d touches the ground", refused(tmp_path, "--time", 5)
    )
    manifest["scenario"]["antenna"]["wires"] = 1
    other.manifest.write_text(json.dumps(manifest))
    assert "of another version: scenario.antenna: unknown key `wires`" in refused(tmp_path, "--time", 5)
    assert export_deck.main([str(run.path), "--time", "5"]) == exit_status.FINE
    assert capsys.readouterr().out == deck_at(run.path, 5.0)


def test_lost_vehicles_have_no_wire(run, tmp_path):
    """A record in which one of two is lost at the end; with both lost there is no deck."""
    shutil.copy(run.manifest, tmp_path)
    shutil.copy(run.events, tmp_path)
    table = pq.read_table(run.flight)
    alive = np.ones((table.num_rows // 2, 2), bool)
    alive[-20:, 0] = alive[-5:, 1] = False
    column = table.schema.get_field_index("alive")
    pq.write_table(table.set_column(column, "alive", [alive.ravel()]), tmp_path / "flight.parquet")
    times_s = np.array(table["time_us"])[::2] * 1e-6
    assert len(_wires_m(deck_at(tmp_path, times_s[-21]))) == 2
    deck = deck_at(tmp_path, times_s[-20])
    assert len(_wires_m(deck)) == 1
    assert deck.splitlines()[0].endswith("UAVs 1")
    with pytest.raises(DeckRefused, match="no vehicle is alive"):
        deck_at(tmp_path, times_s[-1])


# ---- files without patterns


def _standing(scenario, instants):
    """Return a flight with all vehicles upright in their places."""
    places_ned_m = scenario.places_ned_m()
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    return Flight(
        time_us=np.arange(instants, dtype=np.int64) * 500_000,
        pos_ned_m=np.tile(places_ned_m, (instants, 1, 1)),
        q_ned_frd=np.tile(upright, (instants, len(places_ned_m), 1)),
        desired_pos_ned_m=np.tile(places_ned_m, (instants, 1, 1)),
        heading_rad=np.zeros(instants),
        alive=np.ones((instants, len(places_ned_m)), bool),
    )


@pytest.mark.parametrize(
    ("settings", "note"),
    [
        (("antenna.excitation=hansen_woodyard", "formation.rows=1", "formation.columns=8"), "need two rows"),
        (  # loops of 1.6 m radius in places 2.5 m apart
            ("antenna.element_kind=loop", "antenna.element_length_m=10", "antenna.segments=24"),
            "antennas of UAVs 0 and 4 touch",
        ),
    ],
)
def test_a_formation_that_is_no_antenna_has_only_no_gains(tmp_path, settings, note):
    """Every instant is missing with a reason; the summary's note has that of the ideal formation."""
    scenario = load(ARTICLE, settings)
    found = antenna_report.measure(_standing(scenario, 3), scenario)
    numbers = antenna_report.numbers(found)
    assert (numbers["ideal"], numbers["mean"], numbers["patterns"], numbers["missing"]) == (None, None, 0, 3)
    assert numbers["note"].startswith("the ideal formation: ")
    assert note in numbers["note"]
    folder = RunFolder(tmp_path)
    antenna_report.write(folder, found, scenario.antenna)
    gains = pq.read_table(folder.gains)
    assert all(note in reason for reason in gains["missing"].to_pylist())
    assert gains["max_gain_dbi"].to_pylist() == gains["pointing_error_deg"].to_pylist() == [None] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["gains.parquet"]


def test_without_the_solver_there_is_a_note_and_no_file(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    scenario = load(ARTICLE, ["antenna.backend=nec2c"])
    found = antenna_report.measure(_standing(scenario, 3), scenario)
    numbers = antenna_report.numbers(found)
    assert (numbers["ideal"], numbers["backend"], numbers["accuracy"]) == (None, None, None)
    assert "nec2c" in numbers["note"]
    antenna_report.write(RunFolder(tmp_path), found, scenario.antenna)
    assert not list(tmp_path.iterdir())


def test_a_formation_that_was_not_reached_has_an_ideal_pattern_and_a_table_without_rows(tmp_path):
    scenario = load(ARTICLE)
    found = antenna_report.measure(_standing(scenario, 0), scenario)
    numbers = antenna_report.numbers(found)
    assert numbers["ideal"] == pytest.approx(13.262, abs=0.001)
    assert numbers["note"] == "the formation was not reached"
    antenna_report.write(
        RunFolder(tmp_path), found, msgspec.structs.replace(AntennaConfig(), keep_patterns=True)
    )
    assert pq.read_table(tmp_path / "gains.parquet").num_rows == 0
    assert [path.name for path in tmp_path.iterdir()] == ["gains.parquet"]
