"""Swarms with the user's controller, mode and service: equal logs in one process and many, and a loss."""

import pytest
from paths import SCENARIOS, SUPPORT

from harness.launch.one_process import OneProcessSwarm
from harness.launch.swarm import Swarm
from harness.simulator.messages import VehicleLost

pytestmark = pytest.mark.multiprocess

ARTICLE = SCENARIOS / "article.toml"
MODES_AND_SERVICES = [
    "autopilot.modes=['user_extensions:ClimbMode']",
    "autopilot.services=['user_extensions:Counter']",
    f"autopilot.folder={SUPPORT}",
]


def fly(kind, folder, controller, *, until_s):
    overrides = ["formation.columns=2", f"autopilot.controller={controller}", *MODES_AND_SERVICES]
    with kind(ARTICLE, agents=3, seed=4, overrides=overrides, out=folder, wall_limit_s=280.0) as swarm:
        truth = swarm.run(until_s=until_s)
        summary = swarm.summary(draw=False)
        return truth, summary, swarm.events, swarm.log_tails(3)


def test_logs_are_equal_in_one_process_and_in_many(tmp_path):
    flights = [
        fly(kind, tmp_path / kind.__name__, "user_extensions:CascadeAgain", until_s=12.0)
        for kind in (Swarm, OneProcessSwarm)
    ]
    assert flights[0][1]["log_sha256"] == flights[1][1]["log_sha256"]
    for truth, _, _, _ in flights:
        assert truth.alive.all()
        assert (-truth.pos_ned_m[:, 2] > 1.0).all()


@pytest.mark.parametrize("kind", [Swarm, OneProcessSwarm])
def test_the_failure_of_a_controller_ends_its_vehicle_only(kind, tmp_path):
    truth, summary, events, _ = fly(kind, tmp_path / "run", "user_extensions:Failing", until_s=14.0)
    assert truth.alive.tolist() == [True, False, True]
    (lost,) = [event for event in events if isinstance(event, VehicleLost)]
    assert lost.instance == 1
    (ended,) = [event for event in events if getattr(event, "returncode", 0)]
    assert ended.name == "uav 1"
    assert ended.returncode == 2
    line = "uav: autopilot.controller user_extensions:Failing: RuntimeError: diverged ("
    assert ended.last_words.startswith(line)
    assert summary["vehicles"][1]["alive"] is False
    log = (tmp_path / "run" / "logs" / "uav-1.log").read_text()
    assert 'raise RuntimeError("diverged")' in log
