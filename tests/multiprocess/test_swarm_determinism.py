"""The same scenario and seed give the same bytes in every log, under any load of the machine."""

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
"""Covers the ground, take-off and offboard flight; beacons and distances begin at 2 s."""
SQUARE = ["formation.rows=2", "formation.columns=2"]  # a row is localised later


@contextlib.contextmanager
def burners(count):
    """Run ``count`` processes that use all of their processor time."""
    command = [sys.executable, "-c", "print(flush=True)\nwhile True: pass"]
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            process = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE))
            stack.callback(process.kill)
            process.stdout.readline()
        yield


@contextlib.contextmanager
def one_processor():
    """Restrict processes started within the block to one processor."""
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
    overrides = [*SQUARE, f"ports.simulator_link={link}", f"ports.radio_link={link}"]
    with Swarm(ARTICLE, agents=4, seed=seed, overrides=overrides, out=folder, wall_limit_s=280.0) as swarm:
        swarm.run(until_s=4.0)
        swarm.degrade_channel(30.0)  # commands between run calls are part of the run
        truth = swarm.run(until_s=UNTIL_S)
        summary = swarm.summary(draw=False)
    assert {vehicle.phase for vehicle in truth.vehicles} == {"joining"}
    results[folder.name] = summary
    return summary


def hashes(folder):
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in LOGS}


def test_logs_are_equal_under_load_and_on_one_processor(tmp_path):
    results = {}
    fly(tmp_path / "alone", seed=5, results=results)
    with one_processor():  # the emulator yields to the vehicles there
        fly(tmp_path / "confined", seed=5, results=results)
    with burners(3):  # beside the processes of two swarms
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


def fly_with_faults(swarm):
    """Fly with commands of a program at exact times; a killed vehicle leaves whole blocks of its log."""
    with swarm:
        swarm.run(until_s=4.0)
        swarm.degrade_channel(30.0)
        swarm.inject(MotorLoss(uav=1, motor=2, start_s=2.0, effectiveness=0.8))
        swarm.run(until_s=5.5)
        swarm.kill(3)
        swarm.restore_channel()
        truth = swarm.run(until_s=UNTIL_S)
        assert truth.height_m[[0, 2]].min() > 1.0
        return swarm.summary(draw=False)


def test_one_process_writes_the_same_bytes_as_many(tmp_path):
    kinds = {"many": Swarm, "one": OneProcessSwarm}
    results = {
        name: fly_with_faults(
            kind(ARTICLE, agents=4, seed=5, overrides=SQUARE, out=tmp_path / name, wall_limit_s=280.0)
        )
        for name, kind in kinds.items()
    }
    assert hashes(tmp_path / "one") == hashes(tmp_path / "many")
    assert results["one"]["log_sha256"] == results["many"]["log_sha256"]
    assert results["one"]["deterministic"]
    assert b"vehiclelost" in (tmp_path / "one" / "events.jsonl").read_bytes()
    assert results["one"]["ftm"]["completed"] > 30
    assert results["one"]["frames"]["delivered"] > 100
