"""The same scenario and seed give the same bytes in every log, whatever else the machine has to do."""

import contextlib
import hashlib
import os
import subprocess
import sys
import threading

import pytest
from paths import SCENARIOS

from harness.launch.one_process import OneProcessSwarm
from harness.launch.swarm import Swarm
from harness.report.report import LOGS
from harness.world.faults import MotorLoss

pytestmark = pytest.mark.multiprocess

ARTICLE = SCENARIOS / "article.toml"
UNTIL_S = 9.0
"""On the ground, take-off, and under way in offboard; beacons and distances from second two."""


@contextlib.contextmanager
def burners(count):
    """Processes that want every processor all the time."""
    command = [sys.executable, "-c", "print(flush=True)\nwhile True: pass"]
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            process = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE))
            stack.callback(process.kill)
            process.stdout.readline()
        yield


@contextlib.contextmanager
def one_processor():
    """Processes that are started meanwhile may use one processor only."""
    if sys.platform != "linux":
        yield
        return
    processors = os.sched_getaffinity(0)
    os.sched_setaffinity(0, [min(processors)])
    try:
        yield
    finally:
        os.sched_setaffinity(0, processors)


def fly(folder, *, seed, results, link="unix"):
    overrides = [f"ports.simulator_link={link}"]
    with Swarm(ARTICLE, agents=4, seed=seed, overrides=overrides, out=folder, wall_limit_s=280.0) as swarm:
        swarm.run(until_s=4.0)
        swarm.degrade_channel(30.0)  # what a program does between run calls belongs to the run
        swarm.run(until_s=UNTIL_S)
        summary = swarm.summary(draw=False)
    results[folder.name] = summary
    return summary


def hashes(folder):
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in LOGS}


def test_equal_runs_are_equal_byte_for_byte_and_two_at_once_do_not_disturb_each_other(tmp_path):
    results = {}
    fly(tmp_path / "alone", seed=5, results=results)
    with one_processor():  # the emulator gives way to the vehicles there
        fly(tmp_path / "confined", seed=5, results=results)
    with burners(3):  # on two processors, with twelve processes of ours
        threads = [
            threading.Thread(
                target=fly, args=(tmp_path / name,), kwargs={"seed": seed, "results": results, "link": link}
            )
            for name, seed, link in (("loaded", 5, "tcp"), ("other", 6, "unix"))
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert results["alone"]["deterministic"]
    assert results["loaded"]["deterministic"]
    assert hashes(tmp_path / "alone") == hashes(tmp_path / "loaded") == hashes(tmp_path / "confined")
    assert results["alone"]["log_sha256"] == results["loaded"]["log_sha256"]
    assert results["alone"]["frames"]["sent"] > 100
    other = hashes(tmp_path / "other")
    assert all(
        other[name] != value for name, value in hashes(tmp_path / "alone").items() if "events" not in name
    )


def fly_with_troubles(swarm):
    """What a program can do to a flight, at exact times; who is killed leaves whole blocks of its log."""
    with swarm:
        swarm.run(until_s=4.0)
        swarm.degrade_channel(30.0)
        swarm.inject(MotorLoss(uav=1, motor=2, start_s=2.0, effectiveness=0.8))
        swarm.run(until_s=5.5)
        swarm.kill(3)
        swarm.restore_channel()
        swarm.run(until_s=UNTIL_S)
        return swarm.summary(draw=False)


def test_one_process_writes_the_bytes_of_many(tmp_path):
    kinds = {"many": Swarm, "one": OneProcessSwarm}
    results = {
        name: fly_with_troubles(kind(ARTICLE, agents=4, seed=5, out=tmp_path / name, wall_limit_s=280.0))
        for name, kind in kinds.items()
    }
    assert hashes(tmp_path / "one") == hashes(tmp_path / "many")
    assert results["one"]["log_sha256"] == results["many"]["log_sha256"]
    assert results["one"]["deterministic"]
    assert b"vehiclelost" in (tmp_path / "one" / "events.jsonl").read_bytes()
    assert results["one"]["ftm"]["completed"] > 30
    assert results["one"]["frames"]["delivered"] > 100
