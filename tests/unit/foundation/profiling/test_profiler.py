"""Sampling profiler: samples of the stack are attributed to the parts of modules."""

import importlib.util
import signal
import sys
import time
from types import ModuleType

import msgspec
import pytest

from autopilot.process import profile_groups as vehicle_parts
from foundation.profiling.profiler import (
    KEY,
    LINK,
    REST,
    THREADS,
    Profile,
    Profiler,
    part_of,
    profiled,
    shares_s,
)
from harness.launch.profiling import VEHICLES, by_kind, profile_table
from harness.simulator import profile_groups as physics_parts
from netsim.transport import profile_groups as radio_parts

PROFILE_GROUPS = {"swarm": "all", "swarm.flight": "flight", "swarm.flight.codec": "codec"}


@pytest.mark.parametrize(
    "parts", [vehicle_parts.PROFILE_GROUPS, physics_parts.PROFILE_GROUPS, radio_parts.PROFILE_GROUPS]
)
def test_profile_groups_name_existing_modules_and_include_the_link(parts):
    for module in parts:
        assert importlib.util.find_spec(module) is not None, module
    assert LINK in parts.values()


def test_module_belongs_to_the_part_of_its_nearest_package():
    assert part_of("swarm.flight.codec", PROFILE_GROUPS) == "codec"
    assert part_of("swarm.flight.control.inner", PROFILE_GROUPS) == "flight"
    assert part_of("swarm.radio", PROFILE_GROUPS) == "all"
    assert part_of("swarms", PROFILE_GROUPS) is None


def test_shares_sum_to_the_cpu_time_and_threads_are_subtracted_from_the_link():
    # 4 of 10 s are other threads': 40 of 100 samples were taken while those worked and the main one waited
    shares = shares_s({"work": 50, LINK: 45, "codec": 5}, cpu_s=10.0, threads_s=4.0)
    assert sum(shares.values()) == pytest.approx(10.0)
    assert shares == {
        "work": pytest.approx(5.0),
        THREADS: 4.0,
        LINK: pytest.approx(0.5),
        "codec": pytest.approx(0.5),
    }
    assert list(shares)[:2] == ["work", THREADS]


def test_concurrent_threads_do_not_reduce_the_parts_of_the_main_thread():
    shares = shares_s({"work": 90, LINK: 10}, cpu_s=10.0, threads_s=5.0)
    assert shares == {"work": pytest.approx(5.0), THREADS: 5.0, LINK: 0.0}


def test_time_without_samples_belongs_to_no_part():
    assert shares_s({}, cpu_s=0.5, threads_s=0.1) == {REST: 0.5}


def _module(name: str, source: str) -> ModuleType:
    module = ModuleType(name)
    exec(source, module.__dict__)  # noqa: S102  a module of that name is what is needed
    return module


BUSY = """
import time
def work(cpu_s, then=None):
    until = time.process_time() + cpu_s
    while time.process_time() < until:
        sum(range(100))
    if then is not None:
        then()
"""


def test_time_is_attributed_to_the_innermost_module_with_a_part():
    flight, codec = _module("swarm.flight", BUSY), _module("swarm.flight.codec", BUSY)
    helper = _module("helper", BUSY)
    now_us = 0
    profiler = Profiler(PROFILE_GROUPS, now_us=lambda: now_us, from_us=4_000)
    profiler.start()
    try:
        flight.work(0.1)  # before the time from which it counts
        now_us = 4_000
        began_s = time.process_time()
        flight.work(0.3, lambda: codec.work(0.6, lambda: helper.work(0.3)))
        spent_s = time.process_time() - began_s
        now_us = 1_004_000
        flight.work(0.02)
    finally:
        profiler.stop()
    profile = profiler.profile()
    assert profile is not None
    assert profile.simulated_s == pytest.approx(1.0)
    assert profile.cpu_s == pytest.approx(spent_s, abs=0.1)
    assert sum(profile.parts_cpu_s.values()) == pytest.approx(profile.cpu_s)
    assert profile.parts_cpu_s["codec"] == pytest.approx(
        0.9, abs=0.15
    )  # what the helper does is its caller's
    assert profile.parts_cpu_s["flight"] == pytest.approx(0.3, abs=0.15)
    assert profile.wall_s >= profile.waiting_s + profile.queueing_s


def test_a_run_that_is_not_profiled_is_not_interrupted():
    before = signal.getsignal(signal.SIGPROF)
    with profiled(PROFILE_GROUPS, now_us=lambda: 0, from_us=None) as details:
        assert signal.getsignal(signal.SIGPROF) is before
        assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
    assert details == {}


def test_profile_is_available_at_the_end_and_sampling_stops():
    busy = _module("swarm.radio", BUSY)
    with profiled(PROFILE_GROUPS, now_us=lambda: 1, from_us=0) as details:
        busy.work(0.1)
        assert details == {}
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
    assert msgspec.convert(details[KEY], Profile).parts_cpu_s["all"] > 0.0


def test_profile_without_simulated_time_is_empty():
    with profiled(PROFILE_GROUPS, now_us=lambda: 0, from_us=4_000) as details:
        _module("swarm", BUSY).work(0.05)
    assert details == {}


def _told(**changes: object) -> dict[str, object]:
    profile = Profile(
        simulated_s=2.0,
        wall_s=1.0,
        cpu_s=0.4,
        parts_cpu_s={"control": 0.3, LINK: 0.1},
        waiting_s=0.5,
        queueing_s=0.1,
        samples=100,
    )
    return {KEY: msgspec.to_builtins(msgspec.structs.replace(profile, **changes))}


def test_profiles_of_vehicles_are_summed_over_their_own_times():
    profiles = by_kind(
        {
            "uav 0": _told(),
            "uav 1": _told(simulated_s=1.0, waiting_s=0.7),
            "uav 2": {"ground_messages": 0},
            "radio": _told(),
        }
    )
    assert set(profiles) == {"radio", VEHICLES}
    vehicles = profiles[VEHICLES]
    assert vehicles.processes == 2
    assert vehicles.cpu_s_per_simulated_s == pytest.approx(0.2 + 0.4)
    assert vehicles.parts_cpu_s_per_simulated_s == {
        "control": pytest.approx(0.15 + 0.3),
        LINK: pytest.approx(0.05 + 0.1),
    }
    assert vehicles.waiting_fraction == pytest.approx(0.6)
    table = profile_table(profiles, step_us=4_000)
    assert table.row_count == 2 * (1 + 2 + 1) + 1  # kinds, their two parts, how they wait; and all


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc of Linux")
def test_queueing_is_separate_from_waiting():
    busy = _module("swarm", BUSY)
    with profiled(PROFILE_GROUPS, now_us=lambda: 1, from_us=0) as details:
        busy.work(0.05)
        time.sleep(0.2)
        busy.work(0.05)
    profile = msgspec.convert(details[KEY], Profile)
    assert 0.15 < profile.waiting_s + profile.queueing_s < profile.wall_s
