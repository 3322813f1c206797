"""What the launcher makes of the ends and stops of processes, with a supervisor that is a script."""

import re
from pathlib import Path
from typing import Any, ClassVar

import psutil
import pytest

from harness.cli.progress import describe
from harness.launch.run_messages import ProcessNotice, SwarmError
from harness.launch.run_monitor import START_CAUSE_LIMIT_S, RunMonitor
from harness.launch.supervisor import Exited
from harness.records.run_folder import RunFolder
from harness.simulator.emulator_client import GONE, UNANSWERED
from harness.simulator.messages import Progress
from harness.simulator.process_activity import ProcessState


class Processes:
    """A supervisor of physics and radio; physics ends with ``last_words``."""

    pids: ClassVar = {"physics": 1, "radio": 2}

    def __init__(self, last_words: str) -> None:
        self.messages = [
            ("physics", Exited(name="physics", pid=1, returncode=2, log_tail="", last_words=last_words)),
        ]
        self.killed: list[tuple[str, bool]] = []

    def receive(self, _timeout_s: float) -> Any:
        return self.messages.pop() if self.messages else None

    def states(self, names: list[str]) -> dict[str, ProcessState]:
        return {name: ProcessState(psutil.STATUS_RUNNING, 0.0) for name in names if name == "radio"}

    def alive(self, name: str) -> bool:
        return name == "radio"

    def kill(self, name: str, *, after_trace: bool) -> None:
        self.killed.append((name, after_trace))

    def log_path(self, name: str) -> Path:
        return Path(f"{name}.log")


@pytest.mark.parametrize(("words", "killed"), [(UNANSWERED, [("radio", True)]), (GONE, []), ("no file", [])])
def test_an_emulator_that_does_not_answer_physics_is_killed_with_a_trace(
    tmp_path: Path, words: str, killed: list[tuple[str, bool]]
) -> None:
    supervisor = Processes(f"physics: {words}: it has not answered for 30.0 s")
    monitor = RunMonitor(
        supervisor,  # type: ignore[arg-type]  # what of it is used
        RunFolder(tmp_path),
        starting=[],
        until_connected=[],
        expendable={},
        call_limit_s=5.0,
        wall_limit_s=None,
        on_message=None,
    )
    monitor._running = True
    with pytest.raises(SwarmError, match=words):
        monitor.next(1.0, "nothing")
    monitor._kill_found()
    assert supervisor.killed == killed


class ComputingRadio(Processes):
    """Physics waits for a radio that computes, and reports it; ``wall_s`` is the time of the script."""

    def __init__(self, *, advancing: bool, paused: bool) -> None:
        super().__init__("")
        self.wall_s = 1_000.0
        self._advancing, self._paused = advancing, paused

    def receive(self, timeout_s: float) -> Any:
        self.wall_s += timeout_s
        time_us = round(self.wall_s * 1e6) if self._advancing else 3_000_000
        return "physics", Progress(
            time_us=time_us, wall_s=self.wall_s, channel_busy_fraction=0.0, vehicles=(), paused=self._paused
        )  # fmt: skip

    def states(self, _names: list[str]) -> dict[str, ProcessState]:
        return {"radio": ProcessState(psutil.STATUS_RUNNING, self.wall_s)}


@pytest.mark.parametrize(("advancing", "paused"), [(False, False), (True, False), (False, True)])
def test_a_radio_that_computes_while_simulated_time_stands_still_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, advancing: bool, paused: bool
) -> None:
    supervisor = ComputingRadio(advancing=advancing, paused=paused)
    monkeypatch.setattr("time.monotonic", lambda: supervisor.wall_s)
    messages: list[Any] = []
    monitor = RunMonitor(
        supervisor,  # type: ignore[arg-type]
        RunFolder(tmp_path),
        starting=[],
        until_connected=[],
        expendable={},
        call_limit_s=5.0,
        wall_limit_s=None,
        on_message=messages.append,
    )
    monitor._running = True
    with monitor.progress_awaited():
        while supervisor.wall_s < 1_010.0:
            monitor.next(1.0, "nothing")
    named = [message.text for message in messages if isinstance(message, ProcessNotice)]
    assert len(named) == (0 if advancing or paused else 1)
    for line in named:
        assert re.match(r"radio \(pid 2\) has worked for 8 s without progress at 3.000 s$", line)


class RadioEndsLater(Processes):
    """A vehicle has no radio during the start; the emulator's end is reported ``late_s`` afterwards."""

    pids: ClassVar = {"physics": 1, "radio": 2, "uav 0": 3}

    def __init__(self, late_s: float) -> None:
        super().__init__("")
        words = "uav: station 0: the 802.11 emulator does not acknowledge"
        self.messages = [
            ("uav 0", Exited(name="uav 0", pid=3, returncode=2, log_tail="", last_words=words)),
        ]
        self.wall_s = 1_000.0
        self._wall_end_s = self.wall_s + late_s

    def receive(self, timeout_s: float) -> Any:
        if self.messages:
            return self.messages.pop()
        self.wall_s += timeout_s
        if self.wall_s < self._wall_end_s:
            return None
        return "radio", Exited(name="radio", pid=2, returncode=-2, log_tail="", last_words="")


@pytest.mark.parametrize(("late_s", "named"), [(1.0, "radio"), (START_CAUSE_LIMIT_S + 1.0, "uav 0")])
def test_an_emulator_that_ends_in_the_start_is_the_cause_of_a_vehicle_without_radio(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late_s: float, named: str
) -> None:
    supervisor = RadioEndsLater(late_s)
    monkeypatch.setattr("time.monotonic", lambda: supervisor.wall_s)
    monitor = RunMonitor(
        supervisor,  # type: ignore[arg-type]
        RunFolder(tmp_path),
        starting=["uav 0"],
        until_connected=["uav 0"],
        expendable={},
        call_limit_s=5.0,
        wall_limit_s=None,
        on_message=None,
    )
    monitor._running = True
    with pytest.raises(SwarmError, match=rf"^{named} \(pid "):
        monitor.next(1.0, "nothing")


STATION, SEQUEL = "ground station north", "the flight goes on without its programs"


class StationFails(Processes):
    """Physics makes progress, and a ground station is stopped, or has ended with this message."""

    pids: ClassVar = {"physics": 1, "radio": 2, STATION: 4}

    def __init__(self, ended: Exited | None) -> None:
        super().__init__("")
        self.wall_s = 1_000.0
        self._ended = ended
        self.messages = []

    def receive(self, timeout_s: float) -> Any:
        self.wall_s += timeout_s
        if self.wall_s >= 1_003.0 and self._ended is not None:
            ended, self._ended = self._ended, None
            return STATION, ended
        if timeout_s == 0.0:
            return None
        return "physics", Progress(
            time_us=round((self.wall_s - 1_000.0) * 1e6), wall_s=self.wall_s, channel_busy_fraction=0.0,
            vehicles=(),
        )  # fmt: skip

    def states(self, names: list[str]) -> dict[str, ProcessState]:
        stopped = ProcessState(psutil.STATUS_STOPPED, 0.0)
        return {name: stopped for name in names if name == STATION and not self.killed and not self._ended}

    def kill(self, name: str, *, after_trace: bool = False) -> None:
        self.killed.append((name, after_trace))
        self._ended = Exited(name=name, pid=4, returncode=-9, log_tail="")


@pytest.mark.parametrize(
    ("ended", "lines"),
    [
        (None, [rf"{STATION} \(pid 4\) is stopped \(SIGSTOP\) at \d\.\d\d\d s: it is killed, and {SEQUEL}",
                rf"{STATION} \(pid 4\) was killed by SIGKILL"]),
        (Exited(name=STATION, pid=4, returncode=-9, log_tail=""),
         [rf"{STATION} \(pid 4\) was killed by SIGKILL at 2\.\d\d\d s, and {SEQUEL}"]),
        (Exited(name=STATION, pid=4, returncode=2, log_tail="", last_words="no file"),
         [rf"{STATION} \(pid 4\) ended with status 2 at 2\.\d\d\d s, and {SEQUEL}: no file"]),
    ],
)  # fmt: skip
def test_a_ground_station_that_is_stopped_or_ends_is_named_and_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ended: Exited | None, lines: list[str]
) -> None:
    supervisor = StationFails(ended)
    monkeypatch.setattr("time.monotonic", lambda: supervisor.wall_s)
    messages: list[Any] = []
    monitor = RunMonitor(
        supervisor,  # type: ignore[arg-type]
        RunFolder(tmp_path),
        starting=[],
        until_connected=[],
        expendable={STATION: SEQUEL},
        call_limit_s=5.0,
        wall_limit_s=None,
        on_message=messages.append,
    )
    monitor._running = True
    while supervisor.wall_s < 1_020.0:
        monitor.next(1.0, "nothing")
    assert monitor.failure is None
    assert supervisor.killed == ([(STATION, False)] if ended is None else [])
    shown = [line for message in messages if (line := describe(message)) is not None]
    assert len(shown) == len(lines)
    for line, pattern in zip(shown, lines, strict=True):
        assert re.fullmatch(pattern, line)
    (kept,) = monitor.failed_processes()
    assert kept.startswith(lines[0].split(" \\(")[0])
    assert (" at " in kept) and ("is stopped" in kept) == (ended is None)  # noqa: PT018
