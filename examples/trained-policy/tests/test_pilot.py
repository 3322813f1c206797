"""The searched policy flies in runs as it does in its environment, without the environment."""

from pathlib import Path

import numpy as np
import pytest

from coflight import OneProcessSwarm, Swarm

SCENARIO = Path(__file__).parents[1] / "follow.toml"
NONE = ["onboard.settings.weights=[0, 0, 0, 0]"]


def mean_error_m(swarm, duration_s=10.0, every_s=0.2):
    """Return the follower's error against its place beside the leader, from the leader's start on."""
    truth = swarm.run_until_formed(timeout_s=60.0)
    place_from_leader_m = np.subtract(*swarm.scenario.places_ned_m()[[1, 0]])
    errors_m = []
    for _ in range(round(duration_s / every_s)):
        truth = swarm.run(until_s=truth.t_s + every_s)
        errors_m.append(np.linalg.norm(np.subtract(*truth.pos_ned_m[[1, 0]]) - place_from_leader_m))
    assert np.linalg.norm(truth.vel_ned_m_s[0]) > 1.0  # the leader flies its circle
    return float(np.mean(errors_m))


@pytest.mark.parametrize("seed", [1, 2])
def test_the_policy_follows_in_a_run(swarm, seed, tmp_path):
    searched_m = mean_error_m(swarm(SCENARIO, seed=seed, out=tmp_path / "searched"))
    none_m = mean_error_m(swarm(SCENARIO, seed=seed, overrides=NONE, out=tmp_path / "none"))
    assert searched_m < 0.7 * none_m


def test_one_process_and_many_write_the_same_logs(tmp_path):
    hashes = []
    for kind in (OneProcessSwarm, Swarm):
        with kind(SCENARIO, seed=1, out=tmp_path / kind.__name__) as swarm:
            swarm.run(until_s=20.0)
            hashes.append(swarm.summary(draw=False)["log_sha256"])
    assert hashes[0] == hashes[1]
