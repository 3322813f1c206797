"""On-board applications of the user in whole swarms: equal logs, programs with ports, and misbehaviour."""

import os
import re
import sys
import threading
import time

import numpy as np
import pyarrow.parquet as pq
import pytest
from paths import SUPPORT

from harness.launch.one_process import OneProcessSwarm
from harness.launch.run_messages import SwarmError
from harness.launch.swarm import Swarm
from harness.simulator.messages import ApplicationText, VehicleLost

pytestmark = pytest.mark.multiprocess

KINDS = (Swarm, OneProcessSwarm)
SCENARIO = """
agents = {agents}
[formation]
shape = "line"
[onboard]
application = "{application}"
"""
BESIDE = """
[[onboard.programs]]
name = "echo"
application = "user_applications:Echo"
port = 4000
uavs = [0, 2]
settings = {{ prefix = ".", greets = true }}
"""


@pytest.fixture(autouse=True)
def _path(monkeypatch):
    """Let child processes import the user's modules."""
    inherited = os.environ.get("PYTHONPATH", "")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(SUPPORT), inherited))))


def scenario(tmp_path, application, *, agents=2, beside=""):
    path = tmp_path / "user.toml"
    path.write_text(SCENARIO.format(application=application, agents=agents) + beside.format())
    return path


def await_end(swarm):
    """Return the event of the process that has failed; its end may be noticed after the vehicle's loss."""
    deadline_s = time.monotonic() + 60.0
    while True:
        ended = [event for event in swarm.events if getattr(event, "returncode", 0)]
        if ended or time.monotonic() > deadline_s:
            return ended[0]
        swarm.run(until_s=swarm.truth.t_s + 0.04)


def test_an_application_with_a_program_beside_it_flies_equally_in_one_process_and_in_many(tmp_path):
    path, hashes = scenario(tmp_path, "user_applications:Hop", agents=3, beside=BESIDE), []
    for kind in KINDS:
        folder = tmp_path / kind.__name__
        with kind(path, seed=2, out=folder, wall_limit_s=280.0) as swarm:
            truth = swarm.run_until_formed(timeout_s=30.0)
            assert [vehicle.phase for vehicle in truth.vehicles] == ["met"] * 3
            truth = swarm.run(until_s=truth.t_s + 2.0)
            apart_m = np.linalg.norm(truth.pos_ned_m - np.roll(truth.pos_ned_m, -1, axis=0), axis=1)
            measured_m = [vehicle.values["distance_m"] for vehicle in truth.vehicles]
            np.testing.assert_allclose(measured_m, apart_m, atol=1.0)
            echoes = [vehicle.values.get("echo_echoes") for vehicle in truth.vehicles]
            assert echoes[1] is None
            assert min(echoes[0], echoes[2]) > 50  # each echo of an echo, within two iterations of the loop
            assert any(isinstance(event, ApplicationText) for event in swarm.events)
            hashes.append(swarm.summary(draw=False)["log_sha256"])
        flight = pq.read_table(folder / "flight.parquet").to_pandas()
        last = flight.groupby("uav").tail(1).set_index("uav")
        assert (last["app_distance_m"] > 0.0).all()
        assert last["app_echo_echoes"].isna().tolist() == [False, True, False]
    assert hashes[0] == hashes[1]


def test_a_velocity_and_a_height_are_flown_together(tmp_path):
    path = scenario(tmp_path, "user_applications:Slide", agents=1)
    with OneProcessSwarm(path, out=tmp_path / "run") as swarm:
        before = swarm.run(until_s=15.0)
        after = swarm.run(until_s=20.0)
    north_m, east_m, _ = (after.pos_ned_m - before.pos_ned_m)[0]
    assert north_m == pytest.approx(5.0, abs=0.5)
    assert east_m == pytest.approx(0.0, abs=0.5)
    assert after.pos_ned_m[0, 2] == pytest.approx(-4.0, abs=0.6)  # the barometer's error is in it


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("application", "line"),
    [
        ("Raises", "RuntimeError: as written ("),
        ("Loops", "CallEnded: the call has not returned for 3."),
        ("FloodsWithoutBound", "ValueError: more than 10000 transmissions in one iteration of the loop ("),
        ("SendsText", "TypeError: 'take off'; expected a MAVLink message ("),
    ],
)
def test_an_application_that_fails_ends_its_vehicle_only(kind, application, line, tmp_path):
    path = scenario(tmp_path, f"bad_applications:{application}")
    with kind(path, out=tmp_path / "run", wall_limit_s=280.0) as swarm:
        truth = swarm.run(until_s=3.0)
        ended, events = await_end(swarm), swarm.events
    assert truth.alive.tolist() == [True, False]
    assert [event.instance for event in events if isinstance(event, VehicleLost)] == [1]
    title = f"uav: onboard.application bad_applications:{application}: "
    assert (ended.name, ended.last_words[: len(title + line)]) == ("uav 1", title + line)
    assert "bad_applications.py" in ended.last_words


def test_a_call_that_blocks_ends_its_vehicle_with_its_name(tmp_path):
    with Swarm(
        scenario(tmp_path, "bad_applications:Blocks"), out=tmp_path / "run", wall_limit_s=280.0
    ) as swarm:
        truth = swarm.run(until_s=3.0)
        ended = await_end(swarm)
    assert truth.alive.tolist() == [True, False]
    title = "uav: onboard.application bad_applications:Blocks"
    line = rf"{re.escape(title)}: a call has not returned for 4\.[5-9] s, and cannot be ended"
    assert re.fullmatch(line, ended.last_words)
    assert "in misbehave" in (tmp_path / "run" / "logs" / "uav-1.log").read_text()


def test_in_one_process_a_call_that_blocks_ends_the_run_with_its_name(tmp_path):
    swarm = OneProcessSwarm(scenario(tmp_path, "bad_applications:Blocks"), out=tmp_path / "run")
    line = r"onboard\.application bad_applications:Blocks: a call has not returned for 4"
    before = set(threading.enumerate())
    with swarm, pytest.raises(SwarmError, match=line):
        swarm.run(until_s=3.0)
    (abandoned,) = set(threading.enumerate()) - before
    sys.modules["bad_applications"].Blocks.released.set()
    abandoned.join(60.0)
    assert not abandoned.is_alive()


def test_memory_without_bound_ends_the_vehicle(tmp_path):
    path = scenario(tmp_path, "bad_applications:Allocates")
    with Swarm(path, out=tmp_path / "run", wall_limit_s=280.0) as swarm:
        truth = swarm.run(until_s=3.0)
        ended = await_end(swarm)
    assert truth.alive.tolist() == [True, False]
    assert ended.last_words.startswith("uav: onboard.application bad_applications:Allocates: CallEnded: ")


def test_a_flood_of_datagrams_is_bounded_by_the_queue_and_reported(tmp_path):
    path = scenario(tmp_path, "bad_applications:Floods")
    hashes = []
    for kind in KINDS:
        with kind(path, out=tmp_path / kind.__name__, wall_limit_s=280.0) as swarm:
            truth = swarm.run(until_s=1.5)
            (warned,) = {event.text for event in swarm.events if "4000 items" in getattr(event, "text", "")}
            hashes.append(swarm.summary(draw=False)["log_sha256"])
        assert truth.alive.all()
        assert (
            warned == "onboard.application bad_applications:Floods sends 4000 items at once: most are dropped"
        )
    assert hashes[0] == hashes[1]


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_value_before_the_flight_is_the_error_of_the_start(kind, tmp_path):
    path = scenario(tmp_path, "bad_applications:ReturnsText")
    line = "onboard.application bad_applications:ReturnsText: status returned a str; expected a Status"
    with pytest.raises(SwarmError, match=line), kind(path, out=tmp_path / "run", wall_limit_s=280.0):
        pass


def test_a_swarm_whose_application_has_no_aim_cannot_be_awaited(tmp_path):
    swarm = OneProcessSwarm(scenario(tmp_path, "bad_applications:Raises"), out=tmp_path / "run")
    with swarm, pytest.raises(SwarmError, match="reports no phase in which it has formed"):
        swarm.run_until_formed(timeout_s=1.0)
