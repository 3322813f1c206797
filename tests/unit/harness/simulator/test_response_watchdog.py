"""When a silent vehicle is given up, by the state of its process."""

import subprocess
import sys
import time

import psutil
import pytest

from harness.simulator.process_activity import HELD_UP_LIMIT_S, STOPPED_LIMIT_S, ProcessState, has_work
from harness.simulator.response_watchdog import (
    COMPUTING_LIMIT_S,
    LOOK_AFTER_S,
    STARVED_REPORT_AFTER_S,
    ResponseWatchdog,
)


def given_up_s(watchdog, observations, *, every_s=0.1, starting=False):
    """Check every 0.1 s of wall time; returns when the vehicle was given up, or None.

    ``observations`` are psutil's values for the vehicle at each check: (status, cpu seconds).
    """
    script = iter(observations)
    watchdog._process_state = lambda _instance: ProcessState(*next(script))
    watchdog.begin(100.0)
    for k in range(1, len(observations) + 1):
        if watchdog.check(0, 100.0 + k * every_s, starting=starting).give_up is not None:
            return k * every_s
    return None


def test_a_starved_process_is_awaited_and_a_sleeping_or_spinning_one_is_not():
    checks = 100
    starved = [(psutil.STATUS_RUNNING, 0.001 * k) for k in range(checks)]
    assert given_up_s(ResponseWatchdog(2.0), starved) is None
    sleeping = [(psutil.STATUS_SLEEPING, 0.0)] * checks
    assert given_up_s(ResponseWatchdog(2.0), sleeping) == pytest.approx(2.4, abs=0.25)
    spinning = [(psutil.STATUS_RUNNING, 0.1 * k) for k in range(checks)]
    assert given_up_s(ResponseWatchdog(2.0), spinning) is None  # within these 10 s
    spinning = [(psutil.STATUS_RUNNING, 0.1 * k) for k in range(10 * checks)]
    assert given_up_s(ResponseWatchdog(2.0), spinning) == pytest.approx(COMPUTING_LIMIT_S + 0.3, abs=0.3)
    assert given_up_s(ResponseWatchdog(2.0), sleeping, starting=True) is None
    assert given_up_s(ResponseWatchdog(2.0), [(psutil.STATUS_ZOMBIE, 0.0)] * checks) == pytest.approx(
        LOOK_AFTER_S, abs=0.11
    )


def test_a_starved_process_is_reported_after_some_seconds_and_given_up_after_its_processor_time():
    """It may be an endless loop on a busy machine."""
    watchdog = ResponseWatchdog(2.0)
    watchdog.begin(100.0)
    reported_s, k = [], 0
    while True:
        k += 1
        watchdog._process_state = lambda _: ProcessState(psutil.STATUS_RUNNING, 0.02 * k)  # noqa: B023
        finding = watchdog.check(0, 100.0 + 0.1 * k, starting=False)
        if finding.newly_silent:
            reported_s.append(0.1 * k)
        if finding.give_up is not None:
            break
    assert reported_s == [pytest.approx(STARVED_REPORT_AFTER_S, abs=0.11)]
    assert 0.02 * k == pytest.approx(COMPUTING_LIMIT_S, abs=0.2)


def test_a_stopped_process_is_given_up_after_some_seconds_and_a_continued_one_is_not():
    stopped = [(psutil.STATUS_STOPPED, 0.0)] * 100
    assert given_up_s(ResponseWatchdog(5.0), stopped) == pytest.approx(STOPPED_LIMIT_S + 0.4, abs=0.25)
    continued = ([(psutil.STATUS_STOPPED, 0.0)] * 20 + [(psutil.STATUS_RUNNING, 0.0)]) * 5
    assert given_up_s(ResponseWatchdog(5.0), continued) is None


def test_the_time_in_which_this_process_did_not_run_does_not_count():
    sleeping = [(psutil.STATUS_SLEEPING, 0.0)] * 100
    assert given_up_s(ResponseWatchdog(2.0), sleeping, every_s=10.0) is None


def test_the_sleep_of_a_vehicle_does_not_count_while_the_radio_has_work():
    """Another client of the radio can keep it busy for seconds on a busy machine."""
    watchdog = ResponseWatchdog(2.0)
    watchdog._is_radio_busy = lambda: True
    sleeping = [(psutil.STATUS_SLEEPING, 0.0)]
    assert given_up_s(watchdog, sleeping * 500) is None
    assert given_up_s(watchdog, sleeping * 700) == pytest.approx(HELD_UP_LIMIT_S + 2.4, abs=0.25)
    watchdog._is_radio_busy = lambda: next(busy)
    busy = iter([True] * 100 + [False] * 100)
    assert given_up_s(watchdog, sleeping * 200) == pytest.approx(10.0 + 2.3, abs=0.5)
    watchdog._is_radio_busy = lambda: True
    stopped = [(psutil.STATUS_STOPPED, 0.0)] * 100
    assert given_up_s(watchdog, stopped) == pytest.approx(STOPPED_LIMIT_S + 0.4, abs=0.25)


def test_a_process_has_work_if_any_of_its_threads_has():
    script = (
        "import sys, threading\n"
        "def work():\n"
        "    while working: pass\n"
        "working = True; threading.Thread(target=work).start()\n"
        "print('works', flush=True); sys.stdin.readline(); working = False\n"
        "print('rests', flush=True); sys.stdin.readline()\n"
    )
    command = [sys.executable, "-c", script]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "works\n"
        assert has_work(process.pid)
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.stdout.readline() == "rests\n"
        wall_deadline_s = time.monotonic() + 10.0
        while has_work(process.pid):
            assert time.monotonic() < wall_deadline_s
            time.sleep(0.01)
        process.stdin.write("\n")
    assert not has_work(process.pid)


def test_each_check_is_reported():
    checks = []
    watchdog = ResponseWatchdog(2.0, on_check=checks.append)
    watchdog.begin(100.0)
    watchdog.check(0, 100.1, starting=False)
    watchdog.check(0, 100.2, starting=False)
    assert checks == [100.1, 100.2]
