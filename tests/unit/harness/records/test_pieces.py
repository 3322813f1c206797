"""Records in pieces: those of the tables and those of the raw logs, record by record, also as logs grow."""

import json
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS

from autopilot.logs.vehicle_record import vehicle_record
from foundation.records.record_log import RecordLog
from harness.records.live_pieces import PATIENCE_US, LivePieces
from harness.records.pieces import flight_layout, pieces_of_tables
from harness.records.run_folder import NotARun, RunFolder
from harness.records.tables import GAIN_TYPES, write_tables
from harness.scenario.scenario_file import load
from harness.simulator.motion_start import since_start_s
from harness.simulator.truth_record import AIR_RECORD, SENSOR_RECORD, truth_record
from netsim.emulator.log_layout import FRAME_LOG, SESSION_LOG

AGENTS, PERIOD_US, INSTANTS, STEP_US = 3, 40_000, 130, 200_000
LOST, LOST_FROM_US = 2, 2_000_000
"""A vehicle, and the time of its loss"""
START_US = 1_000_000
"""Start of the formation's motion, which is an event of 1.2 s"""
TABLES = ("flight", "frames", "sessions", "air", "sensors")


def filled(layout, rows, generator):
    """Return records with random bytes of numbers, and some of few strings."""
    records = np.empty(rows, layout)
    for name in layout.names:
        kind = layout[name].base
        shape = (rows, *layout[name].shape)
        if kind.kind == "S":
            records[name] = generator.choice([b"ok", b"data", b"timeout"], shape)
        elif kind.kind == "b":
            records[name] = generator.integers(0, 2, shape)
        else:
            records[name] = generator.integers(0, 100, shape)
    return records


def written(folder, scenario):
    """Write raw logs of a flight with a lost vehicle and out-of-order ranging; return the logs' bytes."""
    generator = np.random.default_rng(5)
    times_us = PERIOD_US * np.arange(1, INSTANTS + 1)
    truth = filled(truth_record(scenario.most_rotors), INSTANTS * AGENTS, generator)
    truth["time_us"], truth["uav"] = np.repeat(times_us, AGENTS), np.tile(np.arange(AGENTS), INSTANTS)
    truth["alive"] = (truth["uav"] != LOST) | (truth["time_us"] < LOST_FROM_US)
    own = vehicle_record(folder.applications().columns)
    logs = {folder.raw_truth: truth}
    for i in range(AGENTS):
        rows = filled(own, INSTANTS, generator)
        rows["time_us"] = times_us
        logs[folder.raw_vehicle(i)] = rows if i != LOST else rows[times_us < LOST_FROM_US]
    air = filled(AIR_RECORD, INSTANTS, generator)
    air["time_us"] = times_us
    end_us = int(times_us[-1])
    frames = filled(FRAME_LOG, 3_000, generator)
    frames["end_ns"] = np.sort(generator.integers(1, end_us * 1_000, len(frames)))
    frames["end_ns"][100:105] = 600_000_000  # at the end of a piece
    frames["end_ns"] = np.sort(frames["end_ns"])
    sessions = filled(SESSION_LOG, 300, generator)
    ended_ns = np.sort(generator.integers(1, end_us * 1_000, len(sessions)))
    sessions["measured_ns"] = np.maximum(ended_ns - generator.integers(0, 90_000_000, len(sessions)), 1)
    sensors = filled(SENSOR_RECORD, 200, generator)
    sensors["time_us"] = np.sort(generator.integers(1, end_us, len(sensors)))
    logs |= {folder.raw_air: air, folder.raw_frames: frames, folder.raw_sessions: sessions}
    logs[folder.raw_sensors] = sensors
    for path, rows in logs.items():
        log = RecordLog(path, rows.dtype)
        log.append_array(rows)
        log.close()
    events = [
        {"event": "formationmoves", "time_us": 1_200_000, "start_us": START_US},
        {"event": "vehiclelost", "time_us": LOST_FROM_US, "instance": LOST, "reason": "a test"},
        {"event": "formed", "time_us": 3_000_001},
    ]
    folder.events.write_text("".join(json.dumps(event) + "\n" for event in events) + '{"event":"for')
    return {path: path.read_bytes() for path in [*logs, folder.events]}


def made(path, scenario):
    folder = RunFolder(path).create()
    folder.write_physics_config(scenario, run_id="test")
    return folder


@pytest.fixture(scope="module")
def scenario():
    return load(
        SCENARIOS / "article.toml",
        [f"agents={AGENTS}", "formation.columns=3", 'sensors.extra=[{model="range_finder"}]'],
    )


@pytest.fixture(scope="module")
def flown(scenario, tmp_path_factory):
    """Return a folder with raw logs and tables, and the bytes of the logs."""
    folder = made(tmp_path_factory.mktemp("run") / "run", scenario)
    logs = written(folder, scenario)
    plan = scenario.plan()
    write_tables(folder, scenario, lambda times_us: plan.places(since_start_s(times_us, START_US))).close()
    return SimpleNamespace(folder=folder, logs=logs)


def same(first, second):
    """Return whether records are equal; NaN equals NaN."""
    return first.dtype == second.dtype and all(
        np.array_equal(first[name], second[name], equal_nan=first[name].dtype.kind == "f")
        for name in first.dtype.names
    )


def joined(pieces, name):
    return np.concatenate([getattr(piece, name) for piece in pieces])


def test_pieces_of_tables_and_of_logs_are_the_same_record_by_record(flown, scenario):
    with LivePieces(flown.folder, scenario, step_us=STEP_US) as live:
        of_logs = list(live.advance(ended=True))
    of_tables = list(pieces_of_tables(flown.folder, scenario, step_us=STEP_US))
    assert len(of_logs) == len(of_tables) == INSTANTS * PERIOD_US // STEP_US
    for first, second in zip(of_logs, of_tables, strict=True):
        assert (first.after_us, first.until_us) == (second.after_us, second.until_us)
        assert all(same(getattr(first, name), getattr(second, name)) for name in TABLES)
        assert first.events == second.events
    assert of_tables[0].flight.dtype == flight_layout(flown.folder, scenario)


def test_each_record_is_in_the_one_piece_of_its_time(flown, scenario):
    pieces = list(pieces_of_tables(flown.folder, scenario, step_us=STEP_US))
    begins = [piece.after_us for piece in pieces]
    assert begins == list(range(0, INSTANTS * PERIOD_US, STEP_US))
    for piece in pieces:
        assert piece.until_us == piece.after_us + STEP_US
        assert piece.gains is None
        for time_us in (
            piece.flight["time_us"],
            piece.air["time_us"],
            piece.sensors["time_us"],
            piece.frames["end_ns"] / 1e3,
            piece.sessions["measured_ns"] / 1e3,
            np.array([event["time_us"] for event in piece.events]),
        ):
            assert np.all((piece.after_us < time_us) & (time_us <= piece.until_us))
    logs = flown.logs
    whole = {
        "frames": np.frombuffer(logs[flown.folder.raw_frames], FRAME_LOG),
        "air": np.frombuffer(logs[flown.folder.raw_air], AIR_RECORD),
        "sensors": np.frombuffer(logs[flown.folder.raw_sensors], SENSOR_RECORD),
    }
    assert all(same(joined(pieces, name), rows) for name, rows in whole.items())
    sessions = np.frombuffer(logs[flown.folder.raw_sessions], SESSION_LOG)
    assert np.any(np.diff(sessions["measured_ns"]) < 0)
    piece_of = -(-sessions["measured_ns"] // (STEP_US * 1_000))
    assert same(joined(pieces, "sessions"), sessions[np.argsort(piece_of, kind="stable")])
    assert [event["event"] for piece in pieces for event in piece.events] == [
        "formationmoves",
        "vehiclelost",
        "formed",
    ]


def test_estimates_of_a_lost_vehicle_are_missing_and_places_follow_the_plan(flown, scenario):
    flight = joined(list(pieces_of_tables(flown.folder, scenario, step_us=STEP_US)), "flight")
    assert flight.shape == (INSTANTS, AGENTS)
    lost = flight["time_us"] >= LOST_FROM_US
    assert np.array_equal(np.isnan(flight["estimator_pos_ned_m"]).all(axis=2), lost & (flight["uav"] == LOST))
    expected = scenario.plan().places(since_start_s(flight["time_us"][:, 0], START_US))
    assert np.array_equal(flight["desired_pos_ned_m"], expected)


def test_rows_of_gains_are_in_the_pieces_of_reported_runs(flown, scenario, tmp_path):
    folder = made(tmp_path / "run", scenario)
    for path in flown.folder.path.glob("*.parquet"):
        (folder.path / path.name).write_bytes(path.read_bytes())
    folder.events.write_bytes(flown.folder.events.read_bytes())
    columns = [[400_000, 400_001], [13.0, None], [90.0, None], [1.0, None], [2.0, None], [None, "touch"]]
    arrays = [pa.array(values, kind) for values, kind in zip(columns, GAIN_TYPES.values(), strict=True)]
    pq.write_table(pa.table(dict(zip(GAIN_TYPES, arrays, strict=True))), folder.gains)
    gains = [piece.gains for piece in pieces_of_tables(folder, scenario, step_us=STEP_US)][:4]
    assert [len(rows) for rows in gains] == [0, 1, 1, 0]
    assert gains[1][0].tolist() == (400_000, 13.0, 90.0, 1.0, 2.0, "")
    assert np.isnan(gains[2]["max_gain_dbi"][0])
    assert gains[2]["missing"][0] == "touch"


def test_a_table_of_another_version_is_named(flown, scenario, tmp_path):
    folder = made(tmp_path / "run", scenario)
    folder.events.write_bytes(b"")
    pq.write_table(pq.read_table(flown.folder.flight).drop_columns(["vel_ned_m_s.e"]), folder.flight)
    with pytest.raises(
        NotARun, match=r"flight\.parquet: of another version: it has no column vel_ned_m_s\.e"
    ):
        list(pieces_of_tables(folder, scenario, step_us=STEP_US))


@pytest.mark.parametrize("step_us", [0, -5])
def test_a_step_must_be_positive(flown, scenario, step_us):
    with pytest.raises(ValueError, match=f"step_us {step_us}"):
        next(pieces_of_tables(flown.folder, scenario, step_us=step_us))
    with pytest.raises(ValueError, match=f"step_us {step_us}"):
        LivePieces(flown.folder, scenario, step_us=step_us)


class Growing:
    """Logs that get the bytes of others bit by bit."""

    def __init__(self, path, flown, scenario):
        self.folder = made(path / "run", scenario)
        root = flown.folder.path
        self._left = {self.folder.path / path.relative_to(root): data for path, data in flown.logs.items()}
        self._length = {path: len(data) for path, data in self._left.items()}

    def grow(self, path, fraction):
        """Write a log up to a fraction of its final length, at any byte."""
        size = round(fraction * self._length[path]) - (self._length[path] - len(self._left[path]))
        if size > 0:
            with path.open("ab") as file:
                file.write(self._left[path][:size])
            self._left[path] = self._left[path][size:]

    def paths(self):
        return [*self._left]


def test_growing_logs_give_the_same_records_in_the_same_order(flown, scenario, tmp_path):
    growing, generator = Growing(tmp_path, flown, scenario), np.random.default_rng(3)
    pieces = []
    with LivePieces(growing.folder, scenario, step_us=STEP_US) as live:
        assert list(live.advance()) == []  # no log exists
        for fraction in np.linspace(0.0, 1.0, 41):
            for path in growing.paths():
                # a vehicle has written its records before the truth states its loss
                ahead = 3.0 if path == growing.folder.raw_vehicle(LOST) else 1.0
                growing.grow(path, min(1.0, ahead * fraction + 0.05 * generator.random()))
            pieces += live.advance()
        before_end = len(pieces)
        for path in growing.paths():
            growing.grow(path, 1.0)
            path.unlink()  # open logs stay readable
        pieces += live.advance(ended=True)
        assert not list(live.advance(ended=True))
    expected = list(pieces_of_tables(flown.folder, scenario, step_us=STEP_US))
    assert before_end >= len(expected) - PATIENCE_US // STEP_US - 2
    assert [piece.until_us for piece in pieces] == [piece.until_us for piece in expected]
    for name in ("frames", "air", "sensors"):
        assert same(joined(pieces, name), joined(expected, name)), name
    sessions = joined(pieces, "sessions")
    assert sorted(sessions.tolist()) == sorted(joined(expected, "sessions").tolist())
    flight, whole = joined(pieces, "flight"), joined(expected, "flight")
    names = [name for name in flight.dtype.names if name != "desired_pos_ned_m"]
    assert same(flight[names], whole[names])


def test_a_lost_vehicle_is_not_waited_for_and_a_living_one_for_a_second(flown, scenario, tmp_path):
    growing = Growing(tmp_path, flown, scenario)
    silent = growing.folder.raw_vehicle(0)
    for path in growing.paths():
        growing.grow(path, 0.1 if path == silent else 1.0)
    end_us = INSTANTS * PERIOD_US
    with LivePieces(growing.folder, scenario, step_us=STEP_US) as live:
        pieces = list(live.advance())
        assert pieces[-1].until_us == (end_us - PATIENCE_US) // STEP_US * STEP_US
        growing.grow(silent, 1.0)
        pieces += live.advance()
        assert pieces[-1].until_us == (end_us - PERIOD_US) // STEP_US * STEP_US
    assert pieces[-1].flight["time_us"][-1, 0] > LOST_FROM_US
    assert not np.isnan(pieces[-1].flight["estimator_pos_ned_m"][:, 0]).any()
