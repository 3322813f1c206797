"""The chaos study: its plan and its judgement, and a few of its flights."""

import contextlib
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import psutil
import pytest
from typer.testing import CliRunner

from foundation.exit_status import FAILED, FINE, INTERRUPTED
from studies.chaos import cli, flight, records, small_disk
from studies.chaos.faults import (
    KINDS,
    PHASES,
    SINGLES,
    TARGETS,
    Fault,
    Kind,
    Phase,
    Second,
    Target,
    is_possible,
    plan,
)
from studies.chaos.flight import Cancelled, Outcome, fly, fly_in_temporary_folder
from studies.chaos.launcher import MARK
from studies.chaos.page import page
from studies.chaos.records import FlightRecord
from studies.chaos.requirements import END_LIMIT_S, end_limit_s, named, statuses
from studies.chaos.side_by_side import fly_all
from studies.common.record_lines import RecordsError, append_record

COMBINATIONS = [(t, k, p) for t in TARGETS for k in KINDS for p in PHASES if is_possible(t, k, p)]


def test_equal_seeds_give_equal_plans_and_longer_ones_begin_alike() -> None:
    assert plan(30, 3) == plan(200, 3)[:30]
    assert plan(30, 3) != plan(30, 4)


def test_every_combination_comes_once_before_any_comes_twice() -> None:
    flights = len(COMBINATIONS) * (SINGLES + 1) // SINGLES
    single = [fault for fault in plan(flights, 1) if fault.second is None]
    drawn = [(fault.target, fault.kind, fault.phase) for fault in single]
    assert len(drawn) == len(COMBINATIONS)
    assert sorted(drawn) == sorted(COMBINATIONS)


def test_each_fifth_flight_has_two_possible_faults_of_different_processes() -> None:
    faults = plan(500, 2)
    double = [fault for fault in faults if fault.second is not None]
    assert len(double) == 100
    for fault in double:
        first, second = fault.parts
        assert first.target != second.target
        assert is_possible(first.target, first.kind, fault.phase)
        assert is_possible(second.target, second.kind, fault.phase)
        assert second.delay_s >= first.delay_s


def test_two_faults_permit_what_either_permits_and_completion_if_both_do() -> None:
    def two(kind: Kind, other: Target, other_kind: Kind) -> Fault:
        second = Second(target=other, kind=other_kind, after_s=0.5)
        return Fault(target="radio", kind=kind, phase="flight", delay_s=0.5, second=second)

    assert statuses(two("SIGSTOP for 2 s", "uav 0", "SIGINT")) == [FINE]
    assert statuses(two("SIGSTOP for 2 s", "physics", "SIGINT")) == [FAILED]
    assert set(statuses(two("SIGKILL", "launcher", "SIGKILL"))) == {FAILED, -signal.SIGKILL}
    assert len(named(two("SIGKILL", "physics", "SIGTERM"))) == 2
    assert named(two("SIGKILL", "launcher", "SIGTERM")) == []
    assert len(named(two("SIGKILL", "launcher", "SIGSTOP for 2 s"))) == 1
    assert end_limit_s(two("SIGKILL", "launcher", "SIGSTOP for 2 s")) == END_LIMIT_S + 2.5


def test_a_second_fault_after_an_interrupt_is_one_of_the_stop() -> None:
    second = Second(target="physics", kind="SIGSTOP for 2 s", after_s=0.25)
    fault = Fault(target="launcher", kind="SIGHUP", phase="start", delay_s=0.25, second=second)
    assert fault.parts[1].phase == "stop"
    assert set(statuses(fault)) == {INTERRUPTED, FAILED}
    killed = Fault(target="launcher", kind="SIGKILL", phase="start", delay_s=0.25, second=second)
    assert killed.parts[1].phase == "start"


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


FAULT = Fault(target="radio", kind="SIGSTOP", phase="flight", delay_s=0.5)
FINE_OUTCOME = Outcome(fault=FAULT, status=1, ended_s=6.0, last_line="", complaints=())
SLOW = Outcome(fault=FAULT, status=1, ended_s=20.0, last_line="", complaints=("it ends after 20.0 s",))
MISSED = Outcome(fault=FAULT, status=0, ended_s=0.0, last_line="", complaints=(), reached=False)


def _flown(number: int, outcome: Outcome, *, again: bool = False) -> FlightRecord:
    return FlightRecord(seed=1, number=number, commit="0123456789abcdef", again=again, outcome=outcome)


def test_the_page_counts_and_lists_what_is_not_as_required() -> None:
    flown = [_flown(0, FINE_OUTCOME), _flown(1, SLOW), _flown(2, MISSED)]
    text = page(flown, flights=3, seed=1, beside=2)
    assert "| radio | SIGSTOP | 2 | 1 |  | flight | 1 | 20.0 s |" in text
    assert "| flight | 2 | 1 |  | 1 | 20.0 s |" in text
    assert "2 flights, 1 not as required. 1 more ended before their fault." in text
    assert "- 1: SIGSTOP of radio in flight after 0.5 s: it ends after 20.0 s\n" in text
    assert "up to 2 at a time" in text
    assert "at a time" not in page(flown, flights=3, seed=1, beside=None)
    assert "`0123456789`" in text
    assert "Not as required" not in page(flown[:1], flights=1, seed=1, beside=1)


def test_a_flight_that_fails_before_its_fault_is_not_as_required() -> None:
    failed = msgspec.structs.replace(MISSED, status=1, complaints=("status 1 before its fault",))
    flown = [_flown(0, FINE_OUTCOME), _flown(1, failed), _flown(2, MISSED)]
    text = page(flown, flights=3, seed=1, beside=1)
    assert "2 flights, 1 not as required. 1 more ended before their fault." in text
    assert "- 1: SIGSTOP of radio in flight after 0.5 s: status 1 before its fault\n" in text


def test_a_repetition_is_counted_beside_the_failure_and_does_not_hide_it() -> None:
    flown = [_flown(0, SLOW), _flown(1, SLOW), _flown(0, FINE_OUTCOME, again=True)]
    text = page(flown, flights=2, seed=1, beside=1)
    assert "| radio | SIGSTOP | 2 | 0 | 1 of 1 | flight | 1 | 20.0 s |" in text
    assert "2 flights, 2 not as required, of which 1 were on repetition." in text
    assert (
        "- 0: SIGSTOP of radio in flight after 0.5 s: it ends after 20.0 s. On repetition: as required"
        in text
    )
    assert "- 1: SIGSTOP of radio in flight after 0.5 s: it ends after 20.0 s\n" in text


def _record(number: int) -> FlightRecord:
    return _flown(number, msgspec.structs.replace(FINE_OUTCOME, fault=plan(number + 1, 1)[number]))


def test_records_are_read_back_and_a_half_written_line_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "flights.jsonl"
    assert records.read(path, plan(9, 1), 1) == []
    append_record(path, _record(0))
    with path.open("ab") as file:
        file.write(b'{"seed":1,"numb')
    assert records.read(path, plan(9, 1), 1) == [_record(0)]
    append_record(path, _record(4))
    assert records.read(path, plan(9, 1), 1) == [_record(0), _record(4)]
    assert records.read(path, plan(2, 1), 1)[0] == _record(0)


ANOTHER_FILE = "not a record of this study"
ONE_LINE = msgspec.json.encode(_record(0)) + b"\n"


@pytest.mark.parametrize(
    ("line", "error"),
    [
        (b"{}\n", f"line 1: {ANOTHER_FILE}"),
        (b"\xff\n", f"line 1: {ANOTHER_FILE}"),
        (b"notes without a last new line", f"line 1: {ANOTHER_FILE}"),
        (b"{", f"line 1: {ANOTHER_FILE}"),
        (b'{"seed":1,"number":3}', f"line 1: {ANOTHER_FILE}"),
        (b'{"seed":2,"number":3,"com', f"line 1: {ANOTHER_FILE}"),
        (ONE_LINE + b"notes", f"line 2: {ANOTHER_FILE}"),
        (b'notes\n{"seed":1,"number":3,"com', f"line 1: {ANOTHER_FILE}"),
        (msgspec.json.encode(msgspec.structs.replace(_record(1), seed=2)) + b"\n", "with seed 2, not 1"),
        (msgspec.json.encode(msgspec.structs.replace(_record(1), number=2)) + b"\n", "the fault of flight 2"),
    ],
)
def test_records_of_another_study_are_refused_with_one_line(tmp_path: Path, line: bytes, error: str) -> None:
    path = tmp_path / "flights.jsonl"
    path.write_bytes(line)
    with pytest.raises(RecordsError) as caught:
        records.read(path, plan(9, 1), 1)
    assert error in str(caught.value)
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == line


def test_a_recorded_flight_with_a_full_disk_is_not_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fly_none(faults: list[tuple[int, Fault]], _beside: int) -> Iterator[tuple[int, Outcome]]:
        assert faults == []
        yield from ()

    monkeypatch.setattr(cli, "fly_all", fly_none)
    monkeypatch.setattr(cli.kernel_cache, "prepare", lambda _: None)
    monkeypatch.setattr(small_disk, "is_permitted", lambda _: False)
    first, second = [i for i, fault in enumerate(plan(200, 1)) if fault.target == "disk"][:2]
    path = tmp_path / "flights.jsonl"
    append_record(path, _flown(first, msgspec.structs.replace(SLOW, fault=plan(200, 1)[first])))
    options = ["--seed=1", "--only=of disk", "--again", f"--records={path}"]
    one = CliRunner().invoke(cli.chaos_app, [f"--flights={first + 1}", *options])
    assert one.exit_code == FAILED
    assert "1 flights, 1 not as required" in one.stdout
    assert "left out" not in one.output
    assert "at a time" not in one.stdout
    two = CliRunner().invoke(cli.chaos_app, [f"--flights={second + 1}", *options])
    assert "and 1 with a full disk were left out" in two.stdout


class _StandIn:
    """A launcher that is another program, without processes."""

    program = ""

    def __init__(self, _fault: Fault, folder: Path, _disk: None) -> None:
        self._messages = folder.with_suffix(".txt")
        with self._messages.open("wb") as messages:
            self.process = subprocess.Popen([sys.executable, "-c", self.program], stdout=messages)

    def text(self) -> str:
        return self._messages.read_text(encoding="utf-8")

    def processes(self) -> dict[str, psutil.Process]:
        return {}

    def press(self, key: bytes) -> None:
        pass

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


HOLDS = """
import signal, sys, time
signal.signal(signal.SIGINT, lambda *_: sys.exit({}))
print("holding\\nt = 0.1 of 60.0 s", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize(
    ("program", "phase", "complaints"),
    [
        ("import time; time.sleep(60)", "flight", ("it does not reach its phase",)),
        ("raise SystemExit(0)", "flight", ()),
        ("raise SystemExit(1)", "flight", ("status 1 before its fault",)),
        ("raise SystemExit(0)", "stop", ("status 0 before its fault",)),
        (HOLDS.format(130), "stop", ()),
        (HOLDS.format(1), "stop", ("status 1 before its fault",)),
    ],
)
def test_a_flight_without_its_fault_is_judged_by_its_status(
    program: str, phase: Phase, complaints: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_StandIn, "program", program)
    monkeypatch.setattr(flight, "Launcher", _StandIn)
    if complaints == ("it does not reach its phase",):
        monkeypatch.setattr(flight, "REACH_LIMIT_S", 0.2)
    outcome = fly(Fault(target="uav 0", kind="SIGKILL", phase=phase, delay_s=0.0), tmp_path / "flight")
    assert not outcome.reached
    assert outcome.complaints == complaints


def test_flights_beside_each_other_are_all_flown_once() -> None:
    both = threading.Barrier(2, timeout=20.0)

    def fly(fault: Fault, cancelled: threading.Event) -> Outcome:  # noqa: ARG001
        both.wait()  # passes only if two are under way
        return msgspec.structs.replace(FINE_OUTCOME, fault=fault)

    faults = list(enumerate(plan(6, 1)))
    outcomes = dict(fly_all(faults, 2, fly))
    assert {number: outcome.fault for number, outcome in outcomes.items()} == dict(faults)


def test_an_interrupt_cancels_the_flights_under_way_and_starts_no_more() -> None:
    begun: list[Fault] = []
    ended: list[Fault] = []

    def fly(fault: Fault, cancelled: threading.Event) -> Outcome:
        begun.append(fault)
        if len(begun) > 1:
            assert cancelled.wait(20.0)
            ended.append(fault)
        return msgspec.structs.replace(FINE_OUTCOME, fault=fault)

    flights = fly_all(list(enumerate(plan(9, 1))), 2, fly)
    next(flights)
    flights.close()
    assert len(begun) <= 3
    assert ended == begun[1:]


@pytest.mark.multiprocess
@pytest.mark.parametrize(
    "fault",
    [
        Fault(target="launcher", kind="SIGKILL", phase="start", delay_s=0.1),
        Fault(target="physics", kind="SIGSEGV", phase="flight", delay_s=0.5),
        Fault(target="prefork", kind="SIGSTOP", phase="imports", delay_s=0.2),
        Fault(target="launcher", kind="closed terminal", phase="pause", delay_s=0.1),
        Fault(target="application 0", kind="SIGKILL", phase="flight", delay_s=0.5),
        Fault(target="disk", kind="full", phase="flight", delay_s=0.5),
        Fault(
            target="radio",
            kind="SIGSTOP",
            phase="flight",
            delay_s=0.2,
            second=Second(target="launcher", kind="SIGKILL", after_s=0.3),
        ),
    ],
    ids=lambda fault: fault.title.replace(" ", "-"),
)
def test_flights_end_as_required(fault: Fault, tmp_path: Path) -> None:
    if fault.target == "disk" and not small_disk.is_permitted(tmp_path):
        pytest.skip("this machine permits no mount namespace")
    outcome = fly_in_temporary_folder(fault)
    assert outcome.reached
    # a busy machine may take longer than the study allows
    assert [each for each in outcome.complaints if not each.startswith("it ends after")] == []


@pytest.mark.multiprocess
def test_a_cancelled_flight_leaves_no_process(tmp_path: Path) -> None:
    fault = Fault(target="physics", kind="SIGKILL", phase="flight", delay_s=2.0)
    cancelled = threading.Event()

    def cancel() -> None:
        deadline_s = time.monotonic() + 60.0
        while not _processes_of(tmp_path) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        cancelled.set()

    canceller = threading.Thread(target=cancel)
    canceller.start()
    with pytest.raises(Cancelled):
        fly(fault, tmp_path / "flight", cancelled)
    canceller.join()
    assert _processes_of(tmp_path) == []


def _processes_of(folder: Path) -> list[str]:
    """Return the command lines of the coflight processes whose temporary files are in a folder."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            environment = process.environ()
            if MARK in environment and environment.get("TMPDIR", "").startswith(str(folder)):
                found.append(" ".join(process.cmdline()))
    return found
