"""Three UAVs with the geometric controller hold the article's formation in its wind."""

import os
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from coflight import OneProcessSwarm, Swarm

FOLDER = Path(__file__).parents[1]
SCENARIO = FOLDER / "formation.toml"


@pytest.fixture(autouse=True)
def _path(monkeypatch):
    """Let the vehicles' processes import the package also if it is not installed."""
    parts = (str(FOLDER), os.environ.get("PYTHONPATH", ""))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, parts)))


def test_three_uavs_hold_their_setpoints_in_wind(swarm, tmp_path):
    flight = swarm(SCENARIO, out=tmp_path / "run")
    flight.run_until_formed(timeout_s=60)
    begin_us = 1e6 * flight.simulated_s
    truth = flight.run_for(15)
    assert truth.alive.all()
    flight.summary(draw=False)
    table = pq.read_table(tmp_path / "run" / "flight.parquet").to_pydict()
    after = np.array(table["time_us"]) > begin_us
    error_m = np.array([
        np.array(table[f"estimator_pos_ned_m.{axis}"]) - np.array(table[f"setpoint_pos_ned_m.{axis}"])
        for axis in "ned"
    ])[:, after]  # fmt: skip
    rms_m = np.sqrt((error_m**2).mean(axis=1))
    assert np.hypot(rms_m[0], rms_m[1]) < 0.2
    assert rms_m[2] < 0.1


def test_the_flight_is_the_same_in_one_process_and_in_many(tmp_path):
    hashes = set()
    for kind in (Swarm, OneProcessSwarm):
        with kind(SCENARIO, seed=2, out=tmp_path / kind.__name__) as flight:
            flight.run(until_s=14.0)
            hashes.add(flight.summary(draw=False)["log_sha256"])
    assert len(hashes) == 1
