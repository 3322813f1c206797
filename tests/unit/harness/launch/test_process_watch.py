"""When a process is found to hold up a run, from scripts of states; no process is started."""

import psutil
import pytest

from harness.launch.process_watch import (
    LOOK_PERIOD_S,
    RUN_STOPPED_LIMIT_S,
    SILENT_LIMIT_S,
    SLOW_LIMIT_S,
    ProcessWatch,
)
from harness.simulator.process_activity import BREAK_S, ProcessState
from harness.simulator.response_watchdog import COMPUTING_LIMIT_S

SLEEPS = ProcessState(psutil.STATUS_SLEEPING, 0.0)
STOPPED = ProcessState(psutil.STATUS_STOPPED, 0.0)
NAMED_WITHIN_S = 10.0


def found_after_s(
    states, *, limit_s, every_s=LOOK_PERIOD_S, progressing=("physics",), progress_s=None, call_limit_s=5.0
):
    """Look periodically; returns the wall time at which a process is given up and the finding, or None.

    ``states(t)`` are those of all processes at a time; physics reports progress every ``progress_s``.
    """
    watch = ProcessWatch(call_limit_s=call_limit_s)
    for k in range(round(limit_s / every_s) + 1):
        t = k * every_s
        if progress_s is not None and t % progress_s == 0.0:
            watch.on_progress("physics")
        found = watch.look(1_000.0 + t, states(t), progressing=progressing)
        if found is not None and found.given_up:
            return t, found
    return None


def slow_findings(cpu_s, *, limit_s, progress_s=None, **names):
    """Look at physics, and a radio that computes, until one is given up; returns what is found slow.

    ``progress_s``: period of the radio's progress.
    """
    watch, found = ProcessWatch(), []
    for k in range(round(limit_s / LOOK_PERIOD_S) + 1):
        t = k * LOOK_PERIOD_S
        if progress_s is not None and t % progress_s == 0.0:
            watch.on_progress("radio")
        states = {"physics": SLEEPS, "radio": ProcessState(psutil.STATUS_RUNNING, cpu_s(t))}
        finding = watch.look(1_000.0 + t, states, **names)
        if finding is not None and finding.given_up:
            break
        if finding is not None:
            found.append((t, finding))
    return found


def test_a_stopped_process_is_named_in_time_whichever_it_is():
    for name in ("physics", "radio", "prefork", "uav 3"):
        at_s, found = found_after_s(
            lambda _, name=name: {"physics": SLEEPS, "radio": SLEEPS, "prefork": SLEEPS} | {name: STOPPED},
            limit_s=60.0, progress_s=0.5,
        )  # fmt: skip
        assert RUN_STOPPED_LIMIT_S <= at_s < NAMED_WITHIN_S
        assert (found.name, found.what, found.is_stopped) == (name, "is stopped (SIGSTOP)", True)


def test_a_process_in_a_debugger_is_named_as_such():
    traced = ProcessState(psutil.STATUS_TRACING_STOP, 0.0)
    _, found = found_after_s(lambda _: {"radio": traced}, limit_s=60.0)
    assert found.what == "is stopped by a debugger"


@pytest.mark.parametrize("stop_s", [0.5, 2.0, 3.5])
def test_a_process_that_is_continued_soon_is_not_found(stop_s):
    stops = lambda t: {"physics": STOPPED if t % 10.0 < stop_s else SLEEPS}  # noqa: E731
    assert found_after_s(stops, limit_s=60.0, progress_s=0.5) is None


def test_nothing_is_found_if_the_launcher_itself_did_not_run():
    """As while a whole group of processes, or a virtual machine, is suspended, again and again."""
    assert found_after_s(lambda _: {"physics": STOPPED}, limit_s=600.0, every_s=BREAK_S + 1.0) is None


def test_a_process_without_progress_is_found_by_what_it_does():
    at_s, found = found_after_s(lambda _: {"physics": SLEEPS}, limit_s=60.0)
    assert SILENT_LIMIT_S <= at_s < NAMED_WITHIN_S
    assert (found.name, found.is_stopped) == ("physics", False)
    assert found.what.startswith("has made no progress for ")
    computing = lambda t: {"physics": ProcessState(psutil.STATUS_RUNNING, t)}  # noqa: E731
    at_s, found = found_after_s(computing, limit_s=60.0)
    assert COMPUTING_LIMIT_S <= at_s < COMPUTING_LIMIT_S + 1.0
    starved = lambda t: {"physics": ProcessState(psutil.STATUS_RUNNING, 0.01 * t)}  # noqa: E731
    assert found_after_s(starved, limit_s=600.0) is None  # 6 s of processor time


@pytest.mark.parametrize("names", [{"progressing": ("radio",)}, {"stepping": ("radio",)}])
def test_a_process_that_computes_without_progress_is_named_once_long_before_it_is_given_up(names):
    ((at_s, finding),) = slow_findings(lambda t: t, limit_s=100.0, **names)
    assert SLOW_LIMIT_S <= at_s < NAMED_WITHIN_S
    assert (finding.name, finding.what) == ("radio", "has worked for 8 s without progress")


def test_an_endless_loop_is_named_and_given_up_on_a_busy_machine_too():
    """It gets a tenth of a processor: as long as it has not computed much, it may only be starved."""
    ((at_s, finding),) = slow_findings(lambda t: 0.1 * t, limit_s=100.0, stepping=("radio",))
    assert SLOW_LIMIT_S <= at_s < NAMED_WITHIN_S
    assert finding.what == "has worked for 8 s without progress, with 10 % of a processor"
    starved = lambda t: {"physics": ProcessState(psutil.STATUS_RUNNING, 0.1 * t)}  # noqa: E731
    at_s, found = found_after_s(starved, limit_s=600.0)
    assert 10.0 * COMPUTING_LIMIT_S <= at_s < 10.0 * COMPUTING_LIMIT_S + 10.0
    assert found.name == "physics"


def test_a_process_that_computes_is_named_again_only_after_it_made_progress():
    found = slow_findings(lambda t: t, limit_s=60.0, progress_s=20.0, stepping=("radio",))
    assert len(found) == 3
    for k, (at_s, _) in enumerate(found):
        assert SLOW_LIMIT_S <= at_s - 20.0 * k < NAMED_WITHIN_S
    assert slow_findings(lambda t: t, limit_s=60.0, progress_s=4.0, stepping=("radio",)) == []
    assert slow_findings(lambda t: t, limit_s=60.0) == []


def test_a_process_that_waits_for_steps_is_not_given_up():
    """A vehicle may keep the steps from being made, and the radio computes for guests meanwhile."""
    found = slow_findings(lambda t: t, limit_s=600.0, stepping=("radio",))
    assert len(found) == 1


def test_only_processes_that_are_to_report_progress_are_found_without_it():
    assert found_after_s(lambda _: {"physics": SLEEPS}, limit_s=600.0, progressing=()) is None
    assert found_after_s(lambda _: {"physics": SLEEPS}, limit_s=600.0, progress_s=5.0) is None


def test_a_process_that_has_ended_is_forgotten():
    watch = ProcessWatch()
    watch.look(0.0, {"radio": STOPPED})
    watch.look(1.0, {})
    watch.look(2.0, {"radio": STOPPED})
    assert watch.look(3.0, {"radio": STOPPED}) is None


def test_a_users_model_is_named_by_its_own_process_first():
    """As that process ends when the call has taken its limit."""
    computing = lambda t: {"physics": ProcessState(psutil.STATUS_RUNNING, t)}  # noqa: E731
    for states in (lambda _: {"physics": SLEEPS}, computing):
        at_s, _ = found_after_s(states, limit_s=200.0, call_limit_s=120.0)
        assert 121.0 <= at_s < 123.0
    at_s, _ = found_after_s(lambda _: {"physics": SLEEPS}, limit_s=60.0, call_limit_s=0.5)
    assert SILENT_LIMIT_S <= at_s < NAMED_WITHIN_S
