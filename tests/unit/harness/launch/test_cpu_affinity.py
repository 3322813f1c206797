"""Which processors a swarm's processes keep to, and when: real processes, scripted counts."""

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
    counted,
    homes,
    leaves_room,
    own_processors,
)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are placed on Linux only")
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
    places = homes(UAVS[:vehicles], processors, first="radio", last="physics")
    assert places.keys() == {*UAVS[:vehicles], "radio", "physics"}
    counts = collections.Counter(places[name] for name in UAVS[:vehicles])
    assert counts.keys() == set(processors)
    assert max(counts.values()) - min(counts.values()) <= 1
    # the emulator sends to its neighbours last, and takes the first vehicles for them
    assert [places[name] for name in UAVS[:vehicles]] == sorted(places[name] for name in UAVS[:vehicles])
    # the two that work beside the vehicles and beside each other
    assert places["radio"] == processors[0]
    assert places["physics"] == processors[-1]


@pytest.mark.parametrize(("vehicles", "processors"), [(9, [0]), (3, [0, 1]), (7, [0, 1, 2, 3]), (9, [])])
def test_the_scheduler_places_few_vehicles_and_those_that_have_no_choice(vehicles, processors):
    assert homes(UAVS[:vehicles], processors, first="radio", last="physics") is None


def test_what_others_take_is_what_the_processors_did_less_what_was_ones_own():
    before = Times(100.0, 50.0, 20.0)
    for wall_s in (0.5, 4.0):
        most_s = OTHERS_MAX * wall_s
        assert leaves_room(before, Times(100.0 + wall_s, 51.0 + 0.99 * most_s, 21.0))
        assert not leaves_room(before, Times(100.0 + wall_s, 51.0 + 1.01 * most_s, 21.0))
    # a process of one's own that has ended is missing from the count: taken for others for once
    assert not leaves_room(before, Times(100.5, 50.9, 5.0))


def test_what_a_process_has_used_is_counted_and_one_that_is_gone_is_left_out():
    spin = [sys.executable, "-c", "while True: pass"]
    with subprocess.Popen(spin) as busy, subprocess.Popen([sys.executable, "-c", ""]) as gone:
        gone.wait()
        pids, processors = [busy.pid, gone.pid], own_processors() or sorted(os.sched_getaffinity(0))
        try:
            before = counted(processors, pids)
            wait_for(lambda: counted(processors, pids).own_cpu_s > before.own_cpu_s + 0.2)
            now = counted(processors, pids)
        finally:
            busy.kill()
    assert now.machine_cpu_s - before.machine_cpu_s > 0.1
    assert now.wall_s > before.wall_s


class Machine:
    """Counts as the test says: ``others`` processors are busy with other things."""

    def __init__(self):
        self.others = 0.0
        self.looks = threading.Semaphore(0)
        self._wall_s = self._cpu_s = 0.0

    def count(self, _processors, _pids):
        self._wall_s += 1.0
        self._cpu_s += 1.0 + self.others
        self.looks.release()
        return Times(self._wall_s, self._cpu_s, self._wall_s)


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="there is one processor")
def test_processes_keep_to_their_processors_while_nobody_else_works():
    processors = sorted(os.sched_getaffinity(0))
    # a word from the test starts a second thread, which has the affinity that the first has then
    wait = [sys.executable, "-c", "import threading; input(); threading.Thread(target=input).start()"]
    children = {name: subprocess.Popen(wait, stdin=subprocess.PIPE) for name in ("uav 0", "uav 1", "prefork")}
    places = {"uav 0": processors[0], "uav 1": processors[1], "physics": processors[1]}
    machine = Machine()
    machine.others = 1.0
    placement = CpuAffinity(
        lambda: {name: child.pid for name, child in children.items()},
        places,
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
            assert machine.looks.acquire(timeout=DEADLINE_S)
        assert not placement.placed
        assert allowed("uav 0") == allowed("uav 1") == processors
        machine.others = 0.0
        wait_for(lambda: allowed("uav 1") == [processors[1]])
        assert allowed("uav 0") == [processors[0]]
        assert allowed("prefork") == processors  # it is none of those that have a place
        children["uav 0"].stdin.write(b"\n")
        children["uav 0"].stdin.flush()
        wait_for(lambda: len(threads("uav 0")) == 2)
        children["uav 1"].kill()
        children["uav 1"].wait()
        machine.others = 0.5
        wait_for(lambda: all(sorted(os.sched_getaffinity(each)) == processors for each in threads("uav 0")))
        placement.end()
        placement.end()
        machine.others = 0.0
        assert allowed("uav 0") == processors
    finally:
        placement.end()
        for child in children.values():
            child.kill()
            child.communicate()
    assert "placement" not in [thread.name for thread in threading.enumerate()]
