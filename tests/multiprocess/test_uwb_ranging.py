"""Flights whose distances are measured by UWB radios beside the 802.11 channel."""

import json

import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS

from harness.launch.one_process import OneProcessSwarm
from harness.launch.swarm import Swarm

pytestmark = pytest.mark.multiprocess

ARTICLE = SCENARIOS / "article.toml"
UWB = ["formation.rows=2", "formation.columns=2", "onboard.ranging_radio=uwb"]
LIMIT_S = 280.0


def test_a_formation_forms_by_uwb_distances(tmp_path):
    folder = tmp_path / "run"
    with OneProcessSwarm(ARTICLE, agents=4, seed=3, overrides=UWB, out=folder, wall_limit_s=LIMIT_S) as swarm:
        swarm.run_until_formed(timeout_s=60.0)
        swarm.run_for(1.0)
        swarm.cut_channel()
        swarm.run_for(0.6)
        summary = swarm.summary(draw=False)
    assert summary["formed_s"] is not None
    assert summary["deterministic"]
    ranging = summary["ftm"]
    assert ranging["completed"] > 100
    # by time stamps 2.4 cm, by antenna delays 3.2 cm
    assert abs(ranging["error_mean_m"]) < 0.1
    assert 0.015 < ranging["error_std_m"] < 0.08
    # requests on the cut channel are not answered, and no frame of ranging is on the 802.11 channel
    sessions = pq.read_table(folder / "ftm.parquet").to_pandas()
    assert set(sessions["status"].astype(str)) == {"ok", "no_response"}
    kinds = set(pq.read_table(folder / "radio.parquet")["kind"].to_pandas().astype(str))
    assert kinds
    assert not any(kind.startswith("ftm") for kind in kinds)
    processes = json.loads((folder / "manifest.json").read_text())["processes"]
    (physics,) = [each["details"] for each in processes if each["name"] == "physics"]
    counters = physics["radio"]["counters"]["uwb"]
    assert counters["frames_sent"]["report"] >= ranging["completed"]
    assert counters["outcomes"]["collided"] == 0


def test_one_process_ranges_as_many_processes(tmp_path):
    results = []
    for name, kind in (("many", Swarm), ("one", OneProcessSwarm)):
        flight = kind(ARTICLE, agents=4, seed=5, overrides=UWB, out=tmp_path / name, wall_limit_s=LIMIT_S)
        with flight as swarm:
            swarm.run(until_s=3.0)
            results.append(swarm.summary(draw=False))
    assert results[0]["ftm"]["completed"] > 10
    assert results[0]["log_sha256"] == results[1]["log_sha256"]
