"""A run that looks where its time goes: every process tells, and nothing else changes."""

import pytest

from harness.swarm import Swarm

pytestmark = pytest.mark.multiprocess
SECONDS = 3.0


def test_every_process_tells_where_its_time_went_and_the_logs_are_those_of_any_run(tmp_path):
    hashes = []
    for name, profile_from_s in (("plain", None), ("profiled", 1.0)):
        with Swarm(
            "scenarios/article.toml", agents=2, out=tmp_path / name, profile_from_s=profile_from_s
        ) as swarm:
            swarm.run(until_s=SECONDS)
        summary = swarm.summary(draw=False)
        hashes.append(summary["log_sha256"])
        assert ("profile" in summary) == (profile_from_s is not None)
    assert hashes[0] == hashes[1]
    profile = swarm.profile
    assert set(profile) <= {"physics", "radio", "vehicles"}  # one that did all but nothing has no samples
    assert profile["vehicles"].processes == 2
    for kind in profile.values():
        parts = kind.parts_cpu_s_per_simulated_s
        assert sum(parts.values()) == pytest.approx(kind.cpu_s_per_simulated_s)
        assert 0.0 <= kind.waiting_fraction + kind.queueing_fraction <= 1.0
    assert {"physics", "sensors", "link"} <= set(profile["physics"].parts_cpu_s_per_simulated_s)
    assert {"estimator", "control"} <= set(profile["vehicles"].parts_cpu_s_per_simulated_s)
