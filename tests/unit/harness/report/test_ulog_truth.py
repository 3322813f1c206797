"""The ground truth that a report adds to ULogs: flights in one process, with and without them. 5 s."""

import io
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS
from pyulog import ULog

from autopilot.logs.ulog_topics import TOPICS, TRUTH_TOPICS
from harness.launch.one_process import OneProcessSwarm
from harness.records.run_folder import RunFolder
from harness.report import report
from harness.report.ulog_truth import _TruthEncoder, add_truth
from harness.scenario.scenario_file import load
from harness.simulator.truth_record import truth_record

UNTIL_S = 6.0
SCENARIO = SCENARIOS / "article.toml"
FORMATION = ["formation.rows=1", "formation.columns=2"]
SINGLE = 2.0**-23
"""Relative spacing of float32, that of the positions in a ULog."""


def fly(folder, *overrides):
    with OneProcessSwarm(SCENARIO, agents=2, overrides=[*FORMATION, *overrides], out=folder) as swarm:
        swarm.run(until_s=UNTIL_S)
        return swarm.summary(draw=False)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return the folder of a flight with ULogs, its summary, and its raw logs and ULogs before the report."""
    folder = tmp_path_factory.mktemp("runs") / "with"
    kept = {}
    delete_raw = report.delete_raw

    def keep(run):
        kept["truth"] = run.raw_truth.read_bytes()
        delete_raw(run)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "delete_raw", keep)
        summary = fly(folder, "logging.ulog=true")
    return folder, summary, kept["truth"]


def test_a_flight_is_the_same_without_ulogs(flown, tmp_path):
    assert fly(tmp_path / "without")["log_sha256"] == flown[1]["log_sha256"]
    assert not list((tmp_path / "without").glob("*.ulg"))


@pytest.mark.parametrize("uav", [0, 1])
def test_the_truth_is_that_of_the_table_within_the_rounding_of_its_type(flown, uav):
    folder, *_ = flown
    log = ULog(str(folder / f"uav-{uav}.ulg"))
    assert not log.file_corruption
    table = pq.read_table(folder / "flight.parquet", filters=[("uav", "=", uav)])
    true = log.get_dataset("vehicle_local_position_groundtruth").data
    assert np.array_equal(true["timestamp"], table["time_us"].to_numpy())
    for axis, of in (("x", "n"), ("y", "e"), ("z", "d")):
        expected_m = table[f"pos_ned_m.{of}"].to_numpy()
        offset_m = expected_m - true[axis].astype(float)  # of the vehicle's local frame, which is constant
        most_m = np.max(np.abs(true[axis])) * SINGLE
        assert np.ptp(offset_m) <= most_m + 1e-12, axis
        velocity = table[f"vel_ned_m_s.{of}"].to_numpy()
        assert np.array_equal(true[f"v{axis}"], velocity.astype(np.float32))
    attitude = log.get_dataset("vehicle_attitude_groundtruth").data
    for k, of in enumerate("wxyz"):
        assert np.array_equal(attitude[f"q[{k}]"], table[f"q_ned_frd.{of}"].to_numpy().astype(np.float32))


@pytest.mark.parametrize("uav", [0, 1])
def test_estimates_and_truth_are_in_one_frame(flown, uav):
    """What differs is the error of the estimate, the same as in the table."""
    folder, *_ = flown
    log = ULog(str(folder / f"uav-{uav}.ulg"))
    true = log.get_dataset("vehicle_local_position_groundtruth").data
    estimate = log.get_dataset("vehicle_local_position").data
    table = pq.read_table(folder / "flight.parquet", filters=[("uav", "=", uav)])
    at = {time_us: i for i, time_us in enumerate(table["time_us"].to_numpy().tolist())}
    pairs = [
        (i, at[time_us])
        for i, time_us in enumerate(estimate["timestamp"].tolist())
        if time_us in at and estimate["xy_global"][i]
    ]
    assert len(pairs) > 10
    for axis, of, standing_m in (("x", "n", 0.0), ("y", "e", 0.0), ("z", "d", 0.055)):
        for i, row in pairs:
            error_m = float(estimate[axis][i]) - float(true[axis][row])
            expected_m = (
                table[f"estimator_pos_ned_m.{of}"][row].as_py() - table[f"pos_ned_m.{of}"][row].as_py()
            ) - standing_m
            assert error_m == pytest.approx(expected_m, abs=2e-5)


def test_a_torn_end_is_removed_and_a_second_report_replaces_the_first(flown, tmp_path):
    folder, _, truth = flown
    whole = (folder / "uav-1.ulg").read_bytes()
    log = ULog(io.BytesIO(whole))
    subscribed = log.get_dataset("vehicle_angular_velocity_groundtruth").msg_id
    assert subscribed == len(TOPICS)
    run = RunFolder(tmp_path)
    run.raw.mkdir()
    run.raw_truth.write_bytes(truth)
    scenario = load(SCENARIO, ["agents=2", *FORMATION])
    for data in (whole, whole[:-7]):  # a report that was broken off
        run.ulog(1).write_bytes(data)
        add_truth(run, scenario)
        assert run.ulog(1).read_bytes() == whole
    begin = whole.index(b"A", whole.index(b"vehicle_angular_velocity_groundtruth", len(whole) // 2) - 8)
    torn = whole[: begin - 2 - 5]  # within the last message of the vehicle
    run.ulog(1).write_bytes(torn)
    add_truth(run, scenario)
    again = ULog(io.BytesIO(run.ulog(1).read_bytes()))
    assert not again.file_corruption
    for topic in TRUTH_TOPICS:
        for field, values in log.get_dataset(topic.name).data.items():
            np.testing.assert_array_equal(values, again.get_dataset(topic.name).data[field])


@pytest.mark.parametrize("rows", range(1, 9))
def test_blocks_of_any_length_give_the_samples_of_one_block(rows):
    """Also of 3 and 4 rows, the numbers of elements of a vector and of a quaternion."""
    scenario = load(SCENARIO, ["agents=2", *FORMATION])
    truth = np.zeros(24, truth_record(4))
    truth["time_us"] = 40_000 * np.arange(1, 25)
    truth["q_ned_frd"] = np.random.default_rng(1).normal(size=(24, 4))

    def samples(size):
        encoder = _TruthEncoder(scenario.site, None, 0.055)
        data = b"".join(encoder.encode(truth[at : at + size]) for at in range(0, 24, size))
        found = []
        at = 0
        while at < len(data):
            end = at + 3 + int.from_bytes(data[at : at + 2], "little")
            found.append(data[at:end])
            at = end
        return sorted(found)

    assert samples(rows) == samples(24)


@pytest.mark.parametrize("content", [b"", b"ULog", b"no log of PX4, but longer than its header"])
def test_a_file_that_is_no_ulog_is_left_as_it_is(tmp_path, content):
    run = RunFolder(tmp_path)
    run.raw.mkdir()
    run.raw_truth.write_bytes(b"")
    run.ulog(0).write_bytes(content)
    add_truth(run, load(SCENARIO, ["agents=2", *FORMATION]))
    assert run.ulog(0).read_bytes() == content


@pytest.mark.parametrize("program", ["info", "messages", "params"])
def test_pyulogs_programs_accept_the_log(flown, program):
    folder, *_ = flown
    code = f"from pyulog.{program} import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder / "uav-0.ulg")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout or program == "messages"
