"""A profiled run: every process reports its parts, and the logs do not change."""

import pytest

from autopilot.process import profile_groups as vehicle_parts
from foundation.profiling.profiler import REST, THREADS
from harness.launch.swarm import Swarm
from harness.simulator import profile_groups as physics_parts
from netsim.transport import profile_groups as radio_parts

pytestmark = pytest.mark.multiprocess
SECONDS = 3.0


def test_every_process_reports_its_parts_and_logs_do_not_change(tmp_path):
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
    assert set(profile) <= {"physics", "radio", "vehicles"}  # a nearly idle process has no samples
    assert profile["vehicles"].processes == 2
    tables = {"physics": physics_parts, "radio": radio_parts, "vehicles": vehicle_parts}
    for name, kind in profile.items():
        parts = kind.parts_cpu_s_per_simulated_s
        assert sum(parts.values()) == pytest.approx(kind.cpu_s_per_simulated_s)
        assert 0.0 <= kind.waiting_fraction + kind.queueing_fraction <= 1.0
        # the sampled parts of so short a flight vary
        assert set(parts) <= {*tables[name].PROFILE_GROUPS.values(), REST, THREADS}
        assert set(parts) & set(tables[name].PROFILE_GROUPS.values())
