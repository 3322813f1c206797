"""What the launcher makes of the end of the physics server, with a supervisor that is a script."""

from pathlib import Path
from typing import Any, ClassVar

import psutil
import pytest

from harness.launch.run_messages import SwarmError
from harness.launch.run_monitor import RunMonitor
from harness.launch.supervisor import Exited
from harness.records.run_folder import RunFolder
from harness.simulator.emulator_client import GONE, UNANSWERED
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
