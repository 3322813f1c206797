"""What the launcher makes of the end of the physics server, with a supervisor that is a script."""

import re
from pathlib import Path
from typing import Any, ClassVar

import psutil
import pytest

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
        call_limit_s=5.0,
        wall_limit_s=None,
        on_message=None,
    )
    monitor._running = True
    with pytest.raises(SwarmError, match=rf"^{named} \(pid "):
        monitor.next(1.0, "nothing")
