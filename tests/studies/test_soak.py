"""Tests of the soak study: slopes, judgements of made measurements, and short real ones (20 s)."""

import subprocess
import sys

import numpy as np
import psutil
import pytest
from msgspec.structs import replace

from studies.soak import flight_section, repeats_section, size_section, swarms_section
from studies.soak.flight_section import LongFlight
from studies.soak.growth import slope
from studies.soak.load import MOST_PROCESSES, busy_processors, random_load
from studies.soak.measure import Measured, measure
from studies.soak.plan import QUICK_SOAK, SoakPlan
from studies.soak.repeats_section import Repeat
from studies.soak.size_section import Size
from studies.soak.swarms_section import ManySwarms

PLAN = SoakPlan(hours=2.0)


def measured(**changed):
    usual = {"private_mb": 60.0, "shared_mb": 80.0, "descriptors": 12, "threads": 3, "cpu_s": 0.0}
    return Measured(**usual | changed)


def failed(section):
    return {check.name for check in section.checks if not check.passed}


def test_slope_is_that_of_the_line_whatever_the_start_and_some_outliers():
    rng = np.random.default_rng(3)
    places = np.linspace(0.0, 2.0, 200)
    values = 5.0 + 0.7 * places + 0.01 * rng.standard_normal(200)
    values[:50] -= 40.0 * (1.0 - places[:50])  # the warm-up
    values[60::9] += 30.0
    assert slope(places, values) == pytest.approx(0.7, abs=0.02)
    with pytest.raises(ValueError, match="3 measurements"):
        slope([0.0, 1.0, 2.0], [0.0, 0.0, 0.0])


def long_flight(*, leaked_mb_per_hour=0.0, opened_per_hour=0.0, slower_per_hour=0.0, process="uav 1"):
    """An hour's flight of two vehicles and the physics, of which one process grows."""
    times_s = [60.0 * (i + 1) for i in range(60)]
    processes = {}
    for name in ("physics", "uav 0", "uav 1"):
        grows = name == process
        hours = np.array(times_s) / 3_600.0 * grows
        cpu_s = np.cumsum(60.0 * 0.05 * (1.0 + slower_per_hour * hours))
        processes[name] = [
            measured(
                private_mb=60.0 + leaked_mb_per_hour * hours[i], cpu_s=cpu_s[i],
                descriptors=12 + int(opened_per_hour * hours[i]),
            )
            for i in range(60)
        ]  # fmt: skip
    return LongFlight(times_s=times_s, processes=processes)


@pytest.mark.parametrize(
    ("growth", "found"),
    [
        ({}, set()),
        ({"leaked_mb_per_hour": 0.9}, set()),
        ({"leaked_mb_per_hour": 1.1}, {"uav: private memory"}),
        ({"leaked_mb_per_hour": 1.1, "process": "physics"}, {"physics: private memory"}),
        ({"opened_per_hour": 6.0}, {"uav: descriptors"}),
        ({"slower_per_hour": 0.1}, {"uav: processor time of a simulated second"}),
    ],
)
def test_a_process_that_grows_is_found_among_those_that_do_not(growth, found):
    flights = [long_flight(**growth) for _ in range(2)]
    section = flight_section.judge(PLAN, {"flights": flights})
    named = {name.replace("vehicles", "uav") for name in failed(section)}
    assert named == found


def many(**changed):
    usual = {"measured": [measured() for _ in range(100)], "left_processes": 0, "left_folders": 0}
    return ManySwarms(**usual | changed)


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({}, set()),
        ({"measured": [measured(private_mb=60.0 + 0.01 * i) for i in range(100)]}, {"private memory"}),
        ({"measured": [measured(threads=3 + i // 10) for i in range(100)]}, {"threads"}),
        ({"left_processes": 1}, {"processes left"}),
        ({"left_folders": 2}, {"temporary folders left"}),
    ],
)
def test_what_swarms_leave_is_found(changed, found):
    assert failed(swarms_section.judge(PLAN, {"swarms": [many(**changed)]})) == found


def test_short_runs_judge_neither_memory_nor_processor_time():
    flights = [long_flight(leaked_mb_per_hour=50.0, slower_per_hour=1.0)]
    section = flight_section.judge(replace(PLAN, piece_s=90.0), {"flights": flights})
    assert {check.name.partition(": ")[2] for check in section.checks} == {"descriptors", "threads"}
    few = many(measured=[measured(private_mb=60.0 + i) for i in range(6)])
    assert failed(swarms_section.judge(PLAN, {"swarms": [few]})) == set()


def test_one_other_hash_is_found():
    same = [Repeat(log_sha256="a", deterministic=True, load="none") for _ in range(9)]
    assert failed(repeats_section.judge(PLAN, {"repeats": same})) == set()
    other = Repeat(log_sha256="b", deterministic=True, load="compute")
    assert failed(repeats_section.judge(PLAN, {"repeats": [*same, other]})) == {"different hashes"}


def test_a_slow_start_is_found():
    sizes = [
        Size(agents=n, load=0, start_s=s, real_time_factor=0.5, memory_gb=1.0, most_descriptors=99)
        for n, s in ((64, 20.0), (254, 301.0))
    ]
    assert failed(size_section.judge(PLAN, {"sizes": [sizes]})) == {"254 UAVs, 0 busy processes: start"}


GROWING = """
print(flush=True)
input()
block, file = bytearray(b"1") * 30_000_000, open("/dev/null")
print(flush=True)
input()
"""


def test_a_process_is_measured():
    command = [sys.executable, "-I", "-c", GROWING]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        begin = measure(process.pid)
        process.stdin.write(b"\n")
        process.stdin.flush()
        process.stdout.readline()
        end = measure(process.pid)
        process.communicate(b"\n")
    assert end.descriptors == begin.descriptors + 1
    assert end.private_mb - begin.private_mb == pytest.approx(30.0, abs=3.0)
    assert end.cpu_s >= begin.cpu_s


def test_loads_end_with_their_block():
    others = {*psutil.Process().children()}
    seen = set()
    for number in range(6):
        with random_load(np.random.default_rng(number)) as load:
            children = {*psutil.Process().children()} - others
            assert len(children) == (0 if load == "none" else load.count(",") + 1) <= MOST_PROCESSES
            seen.add(load)
        assert not any(child.is_running() for child in children)
    assert len(seen) > 2
    with busy_processors(2):
        assert len({*psutil.Process().children()} - others) == 2
    assert {*psutil.Process().children()} <= others


@pytest.mark.multiprocess
def test_short_soak_of_real_swarms():
    many_swarms = swarms_section.start_many(3)
    assert (many_swarms.left_processes, many_swarms.left_folders) == (0, 0)
    assert many_swarms.measured[-1].descriptors == many_swarms.measured[1].descriptors
    flight = flight_section.fly(QUICK_SOAK.agents, 3.0, 0.5, seed=1)
    assert set(flight.processes) == {"launcher", "physics", "radio", "prefork", "uav 0", "uav 1", "uav 2"}
    assert len(flight.times_s) == 6
    for name in flight.processes:
        assert flight_section.growth(flight, name).descriptors == 0.0
