"""Swarms of real PX4s: skipped without the folder of a SITL build in the variable COFLIGHT_PX4_BUILD.

The tests run as a user other than root, or as root with COFLIGHT_PX4_USER, the name of another user.
"""

import json
import os

import psutil
import pytest
from external_swarms import heights_m

from harness.launch import px4
from harness.launch.process_commands import application, uav
from harness.launch.px4_instances import FOLDER, SHELL
from harness.launch.swarm import Swarm, SwarmError
from harness.simulator.messages import ApplicationLost, VehicleLost

BUILD = os.environ.get("COFLIGHT_PX4_BUILD")
USER = os.environ.get("COFLIGHT_PX4_USER")
WALL_LIMIT_S = 240.0
pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(BUILD is None, reason="COFLIGHT_PX4_BUILD is not set: no real PX4"),
    pytest.mark.timeout(600),
]


@pytest.fixture
def folder(tmp_path):
    """Return a folder that PX4's user may enter, and let that user write to those of its PX4s."""
    if USER is None:
        yield tmp_path
        return
    for each in (tmp_path, *tmp_path.parents[:-1]):
        if each.stat().st_uid == os.geteuid():
            each.chmod(each.stat().st_mode | 0o755)
    before = os.umask(0)
    yield tmp_path
    os.umask(before)


@pytest.fixture
def swarm(folder):
    """Return a factory of swarms of real PX4s in the article's wind, in rows of two."""
    overrides = ["autopilot.kind=px4", f"autopilot.px4_build={BUILD}", "formation.columns=2"]
    if USER is not None:
        words = ["setpriv", f"--reuid={USER}", f"--regid={USER}", "--clear-groups", "--pdeathsig=keep"]
        words += ["{build}/bin/px4", "-i", "{i}", "-d", "{build}/etc", "-w", "{work}"]
        overrides.append(f"autopilot.px4_command={json.dumps(words)}")

    def make(agents, *others, name="run"):
        return Swarm(
            "article", agents=agents, out=folder / name, wall_limit_s=WALL_LIMIT_S, port_offset="auto",
            ports="scenario", overrides=[*overrides, *others],
        )  # fmt: skip

    return make


@pytest.mark.parametrize("suited", ["true", "false"])
def test_px4s_hold_the_shape_and_the_heights_with_and_without_parameters_that_suit_them(swarm, suited):
    with swarm(3, f"autopilot.px4_simulation_parameters={suited}") as flown:
        formed_s = flown.run_until_formed(timeout_s=60.0).t_s
        flown.run_for(15.0)
        summary = flown.summary(draw=False)
    assert flown.leftovers() == []
    assert not any((FOLDER / f"{SHELL}{number}").exists() for number in px4.numbers(flown.scenario))
    assert formed_s < 35.0
    assert summary["collisions"] == 0
    assert summary["formation_rms_m"]["shape"] < 0.4
    assert heights_m(flown.path, formed_s + 2.0) == pytest.approx([10.0] * 3, abs=0.6)
    manifest = json.loads((flown.path / "manifest.json").read_text())
    details = {process["name"]: process["details"] for process in manifest["processes"]}
    assert {details[application(i)]["malformed_bytes"] for i in range(3)} == {0}


def test_a_killed_application_is_named_and_its_px4_flies_on(swarm):
    with swarm(3) as flown:
        flown.run_until(lambda truth: min(v.pos_ned_m[2] for v in truth.vehicles) < -3.0, timeout_s=60.0)
        psutil.Process(flown.pids[application(1)]).kill()
        truth = flown.run_for(5.0)
        assert [vehicle.alive for vehicle in truth.vehicles] == [True] * 3
        assert truth.vehicles[1].phase == ""
        summary = flown.summary(draw=False)
    (lost,) = (event for event in flown.events if isinstance(event, ApplicationLost))
    assert lost.instance == 1
    assert [vehicle["application_lost"] is not None for vehicle in summary["vehicles"]] == [
        False,
        True,
        False,
    ]
    manifest = json.loads((flown.path / "manifest.json").read_text())
    assert any(line.startswith("application 1 was lost") for line in manifest["nondeterminism"])


def test_a_killed_px4_is_named_and_the_others_go_on(swarm):
    with swarm(3) as flown:
        flown.run_for(3.0)
        psutil.Process(flown._processes.ready[uav(2)].pid).kill()
        truth = flown.run_for(2.0)
        assert [vehicle.alive for vehicle in truth.vehicles] == [True, True, False]
    (lost,) = (event for event in flown.events if isinstance(event, VehicleLost))
    assert lost.instance == 2
    assert flown.leftovers() == []


def test_two_swarms_of_px4s_fly_at_once(swarm):
    with swarm(2, "onboard.localisation=gps", name="one") as first:
        first.run_for(1.0)
        with swarm(2, "onboard.localisation=gps", name="two") as second:
            assert second.scenario.ports.simulator_tcp != first.scenario.ports.simulator_tcp
            for flown in (second, first):
                flown.run_until(lambda truth: all(v.armed for v in truth.vehicles), timeout_s=30.0)
    assert first.leftovers() == second.leftovers() == []


def test_a_px4_that_ends_at_its_start_is_reported_with_its_error(swarm):
    flown = swarm(1, "autopilot.px4_env.PX4_SIM_MODEL=none_such")
    with pytest.raises(SwarmError, match=r"^uav 0 .*ERROR \[init\] Unknown model none_such"):
        flown.start()
    assert flown.leftovers() == []
