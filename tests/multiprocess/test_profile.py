"""A run that looks where its time goes: every process tells, and nothing else changes."""

import pytest

from autopilot.process import profile_groups as vehicle_parts
from foundation.profiling.profiler import REST, THREADS
from harness.launch.swarm import Swarm
from harness.simulator import profile_groups as physics_parts
from netsim.transport import profile_groups as radio_parts

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
    tables = {"physics": physics_parts, "radio": radio_parts, "vehicles": vehicle_parts}
    for name, kind in profile.items():
        parts = kind.parts_cpu_s_per_simulated_s
        assert sum(parts.values()) == pytest.approx(kind.cpu_s_per_simulated_s)
        assert 0.0 <= kind.waiting_fraction + kind.queueing_fraction <= 1.0
        # which of them were met in so short a flight is chance
        assert set(parts) <= {*tables[name].PROFILE_GROUPS.values(), REST, THREADS}
        assert set(parts) & set(tables[name].PROFILE_GROUPS.values())
