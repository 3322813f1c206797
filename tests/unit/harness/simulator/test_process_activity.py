"""What a process is found to do while it is waited for, from a script of its states."""

import os
import subprocess
import sys

import psutil
import pytest

from harness.simulator.process_activity import BREAK_S, DEAD, Activity, ProcessState, state_of

PERIOD_S = 0.25
LOOKS = 40


def observed(states):
    """Return the activity after looks at these (status, processor time) every `PERIOD_S`."""
    states = [ProcessState(*state) for state in states]
    activity = Activity.begin(100.0, states[0])
    for k, state in enumerate(states[1:], start=1):
        activity.look(100.0 + k * PERIOD_S, state)
    return activity


TIMES = ("waiting_s", "computing_s", "starved_s", "stopped_s")


def times_of(activity):
    return {name: getattr(activity, name) for name in TIMES}


@pytest.mark.parametrize(
    ("status", "share", "counted"),
    [
        (psutil.STATUS_SLEEPING, 0.0, "waiting_s"),
        (psutil.STATUS_RUNNING, 0.9, "computing_s"),
        (psutil.STATUS_SLEEPING, 0.5, "computing_s"),
        (psutil.STATUS_DISK_SLEEP, 0.0, "computing_s"),
        (psutil.STATUS_STOPPED, 0.0, "stopped_s"),
        (psutil.STATUS_TRACING_STOP, 0.0, "stopped_s"),
    ],
)
def test_time_counts_as_what_the_process_does(status, share, counted):
    activity = observed([(status, share * k * PERIOD_S) for k in range(LOOKS + 1)])
    assert times_of(activity) == pytest.approx(dict.fromkeys(TIMES, 0.0) | {counted: LOOKS * PERIOD_S})
    assert not activity.starved


def test_of_a_process_that_gets_no_processor_its_processor_time_counts():
    activity = observed([(psutil.STATUS_RUNNING, 0.05 * k * PERIOD_S) for k in range(LOOKS + 1)])
    counted = {"computing_s": 0.05 * LOOKS * PERIOD_S, "starved_s": 0.95 * LOOKS * PERIOD_S}
    assert times_of(activity) == pytest.approx(dict.fromkeys(TIMES, 0.0) | counted)
    assert activity.starved
    activity.on_progress()
    assert times_of(activity) == dict.fromkeys(TIMES, 0.0)


def test_a_process_that_is_continued_is_not_stopped_any_more():
    activity = observed([(psutil.STATUS_STOPPED, 0.0)] * LOOKS + [(psutil.STATUS_SLEEPING, 0.0)])
    assert activity.stopped_s == 0.0


def test_the_time_in_which_the_observer_did_not_run_does_not_count():
    activity = observed([(psutil.STATUS_STOPPED, 0.0)] * LOOKS)
    activity.look(activity.wall_s + BREAK_S + 1.0, ProcessState(psutil.STATUS_STOPPED, 0.0))
    assert activity.stopped_s == 0.0
    activity.look(activity.wall_s + PERIOD_S, ProcessState(psutil.STATUS_STOPPED, 0.0))
    assert activity.stopped_s == PERIOD_S


def test_state_of_a_process():
    assert state_of(psutil.Process()).cpu_s > 0.0
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        process = psutil.Process(child.pid)
    assert state_of(process) == DEAD
    assert process.pid != os.getpid()
