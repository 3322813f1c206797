"""The chaos study: its plan and its judgement, and a few of its flights."""

import re
import signal

import pytest

from studies.chaos.faults import KINDS, PHASES, TARGETS, Fault, is_possible, named, plan, statuses
from studies.chaos.flight import Outcome, fly_in_temporary_folder
from studies.chaos.page import page

COMBINATIONS = [(t, k, p) for t in TARGETS for k in KINDS for p in PHASES if is_possible(t, k, p)]


def test_equal_seeds_give_equal_plans_and_longer_ones_begin_alike() -> None:
    assert plan(30, 3) == plan(200, 3)[:30]
    assert plan(30, 3) != plan(30, 4)


def test_every_combination_comes_once_before_any_comes_twice() -> None:
    drawn = [(fault.target, fault.kind, fault.phase) for fault in plan(len(COMBINATIONS), 1)]
    assert sorted(drawn) == sorted(COMBINATIONS)


def test_every_fault_has_a_documented_status() -> None:
    for target, kind, phase in COMBINATIONS:
        assert statuses(Fault(target=target, kind=kind, phase=phase, delay_s=0.0))


def test_a_killed_process_is_named_with_its_id_and_signal() -> None:
    fault = Fault(target="physics", kind="SIGKILL", phase="flight", delay_s=0.0)
    (pattern,) = named(fault)
    assert re.search(pattern, "coflight: physics (pid 12) was killed by SIGKILL at 2.000 s")
    assert not re.search(pattern, "physics (pid 12) was killed by SIGSEGV (segmentation fault) at 2.000 s")
    assert not re.search(pattern, "physics computes")
    assert not named(Fault(target="launcher", kind="SIGKILL", phase="flight", delay_s=0.0))


def test_a_killed_launcher_has_the_status_of_its_signal() -> None:
    for kind in ("SIGKILL", "SIGSEGV"):
        fault = Fault(target="launcher", kind=kind, phase="flight", delay_s=0.0)
        assert statuses(fault) == [-signal.Signals[kind]]


def test_the_page_counts_and_lists_what_is_not_as_required() -> None:
    fault = Fault(target="radio", kind="SIGSTOP", phase="flight", delay_s=0.5)
    fine = Outcome(fault=fault, status=1, ended_s=6.0, last_line="", complaints=())
    slow = Outcome(fault=fault, status=1, ended_s=20.0, last_line="", complaints=("it ends after 20.0 s",))
    missed = Outcome(fault=fault, status=0, ended_s=0.0, last_line="", complaints=(), reached=False)
    text = page([fine, slow, missed], flights=3, seed=1)
    assert "| radio | SIGSTOP | 2 | 1 | flight | 1 | 20.0 s |" in text
    assert "2 flights, 1 not as required. 1 more ended before their fault." in text
    assert "- SIGSTOP of radio in flight after 0.5 s: it ends after 20.0 s" in text
    assert "Not as required" not in page([fine], flights=1, seed=1)


@pytest.mark.multiprocess
@pytest.mark.parametrize(
    "fault",
    [
        Fault(target="launcher", kind="SIGKILL", phase="start", delay_s=0.1),
        Fault(target="physics", kind="SIGSEGV", phase="flight", delay_s=0.5),
        Fault(target="prefork", kind="SIGSTOP", phase="imports", delay_s=0.2),
        Fault(target="launcher", kind="SIGTERM", phase="pause", delay_s=0.1),
    ],
    ids=lambda fault: fault.title.replace(" ", "-"),
)
def test_flights_end_as_required(fault: Fault) -> None:
    outcome = fly_in_temporary_folder(fault)
    assert outcome.reached
    # a busy machine may take longer than the study allows
    assert [each for each in outcome.complaints if not each.startswith("it ends after")] == []
