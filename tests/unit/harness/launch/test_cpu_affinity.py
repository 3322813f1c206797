"""CPU affinities of a swarm's processes: real processes, scripted measurements."""

import collections
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from harness.launch.cpu_affinity import (
    OTHERS_MAX,
    CpuAffinity,
    Times,
    assign_processors,
    measure,
    others_idle,
    usable_processors,
)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are pinned on Linux only")
UAVS = [f"uav {i}" for i in range(9)]
DEADLINE_S = 30.0


def wait_for(fact):
    deadline_s = time.monotonic() + DEADLINE_S
    while not fact():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


@pytest.mark.parametrize(
    ("vehicles", "processors"), [(8, [0, 1]), (9, [2, 5]), (9, [0, 1, 2, 3]), (4, [0, 1])]
)
def test_each_processor_has_its_share_of_vehicles(vehicles, processors):
    assignment = assign_processors(UAVS[:vehicles], processors, first="radio", last="physics")
    assert assignment.keys() == {*UAVS[:vehicles], "radio", "physics"}
    counts = collections.Counter(assignment[name] for name in UAVS[:vehicles])
    assert counts.keys() == set(processors)
    assert max(counts.values()) - min(counts.values()) <= 1
    # the emulator sends to vehicles on its own processor last, and assumes that these are the first vehicles
    assert [assignment[name] for name in UAVS[:vehicles]] == sorted(
        assignment[name] for name in UAVS[:vehicles]
    )
    # these two run in parallel with the vehicles and with each other
    assert assignment["radio"] == processors[0]
    assert assignment["physics"] == processors[-1]


@pytest.mark.parametrize(("vehicles", "processors"), [(9, [0]), (3, [0, 1]), (7, [0, 1, 2, 3]), (9, [])])
def test_few_vehicles_or_a_single_processor_are_left_to_the_scheduler(vehicles, processors):
    assert assign_processors(UAVS[:vehicles], processors, first="radio", last="physics") is None


def test_the_load_of_others_is_the_busy_time_less_that_of_own_processes():
    before = Times(100.0, 50.0, 20.0)
    for wall_s in (0.5, 4.0):
        most_s = OTHERS_MAX * wall_s
        assert others_idle(before, Times(100.0 + wall_s, 51.0 + 0.99 * most_s, 21.0))
        assert not others_idle(before, Times(100.0 + wall_s, 51.0 + 1.01 * most_s, 21.0))
    # the time of an own process that has ended is missing: it counts as others' once
    assert not others_idle(before, Times(100.5, 50.9, 5.0))


def test_the_time_of_processes_is_measured_and_ended_ones_are_skipped():
    spin = [sys.executable, "-c", "while True: pass"]
    with subprocess.Popen(spin) as busy, subprocess.Popen([sys.executable, "-c", ""]) as gone:
        gone.wait()
        pids, processors = [busy.pid, gone.pid], usable_processors() or sorted(os.sched_getaffinity(0))
        try:
            before = measure(processors, pids)
            wait_for(lambda: measure(processors, pids).own_cpu_s > before.own_cpu_s + 0.2)
            now = measure(processors, pids)
        finally:
            busy.kill()
    assert now.machine_cpu_s - before.machine_cpu_s > 0.1
    assert now.wall_s > before.wall_s


class Machine:
    """Scripted measurements: ``others`` processors are busy with other processes."""

    def __init__(self):
        self.others = 0.0
        self.measurements = threading.Semaphore(0)
        self._wall_s = self._cpu_s = 0.0

    def count(self, _processors, _pids):
        self._wall_s += 1.0
        self._cpu_s += 1.0 + self.others
        self.measurements.release()
        return Times(self._wall_s, self._cpu_s, self._wall_s)


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="there is one processor")
def test_processes_are_pinned_while_others_are_idle():
    processors = sorted(os.sched_getaffinity(0))
    # input from the test starts a second thread, which inherits the present affinity of the first
    wait = [sys.executable, "-c", "import threading; input(); threading.Thread(target=input).start()"]
    children = {name: subprocess.Popen(wait, stdin=subprocess.PIPE) for name in ("uav 0", "uav 1", "prefork")}
    assignment = {"uav 0": processors[0], "uav 1": processors[1], "physics": processors[1]}
    machine = Machine()
    machine.others = 1.0
    affinity = CpuAffinity(
        lambda: {name: child.pid for name, child in children.items()},
        assignment,
        processors,
        count=machine.count,
        period_s=0.01,
    )

    def threads(name):
        return [int(thread.name) for thread in Path(f"/proc/{children[name].pid}/task").iterdir()]

    def allowed(name):
        return sorted(os.sched_getaffinity(children[name].pid))

    try:
        for _ in range(4):
            assert machine.measurements.acquire(timeout=DEADLINE_S)
        assert not affinity.pinned
        assert allowed("uav 0") == allowed("uav 1") == processors
        machine.others = 0.0
        wait_for(lambda: allowed("uav 1") == [processors[1]])
        assert allowed("uav 0") == [processors[0]]
        assert allowed("prefork") == processors  # it has no assigned processor
        children["uav 0"].stdin.write(b"\n")
        children["uav 0"].stdin.flush()
        wait_for(lambda: len(threads("uav 0")) == 2)
        children["uav 1"].kill()
        children["uav 1"].wait()
        machine.others = 0.5
        wait_for(lambda: all(sorted(os.sched_getaffinity(each)) == processors for each in threads("uav 0")))
        affinity.end()
        affinity.end()
        machine.others = 0.0
        assert allowed("uav 0") == processors
    finally:
        affinity.end()
        for child in children.values():
            child.kill()
            child.communicate()
    assert "cpu affinity" not in [thread.name for thread in threading.enumerate()]


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="there is one processor")
def test_of_programs_with_threads_all_threads_are_pinned_and_of_others_the_main_one():
    processors = sorted(os.sched_getaffinity(0))
    two = [
        sys.executable,
        "-c",
        "import threading; threading.Thread(target=input).start(); print(flush=True)",
    ]
    names = ("uav 0", "application 0")
    children = {name: subprocess.Popen(two, stdin=subprocess.PIPE, stdout=subprocess.PIPE) for name in names}
    affinity = None
    try:
        for child in children.values():
            child.stdout.readline()
        affinity = CpuAffinity(
            lambda: {name: child.pid for name, child in children.items()},
            dict.fromkeys(names, processors[0]),
            processors,
            threaded=("uav 0",),
            count=Machine().count,
            period_s=0.01,
        )

        def allowed(name):
            """Processors of each thread, the main one first."""
            pids = sorted(int(thread.name) for thread in Path(f"/proc/{children[name].pid}/task").iterdir())
            return [sorted(os.sched_getaffinity(pid)) for pid in pids]

        wait_for(lambda: allowed("uav 0") == 2 * [processors[:1]])
        wait_for(lambda: allowed("application 0") == [processors[:1], processors])
    finally:
        if affinity is not None:
            affinity.end()
        for child in children.values():
            child.kill()
            child.communicate()
