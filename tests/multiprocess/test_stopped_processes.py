"""A run of stand-ins whose processes are stopped or hang: it names them and ends, or goes on when it can."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from paths import SUPPORT

import harness.launch.processes
from harness.launch.run_messages import ProcessNotice
from harness.launch.swarm import Swarm, SwarmError
from harness.scenario.scenario import Scenario

pytestmark = pytest.mark.multiprocess

STAND_INS = SUPPORT / "supervisor_stand_ins.py"
NAMED_WITHIN_S = 10.0
ENDED_WITHIN_S = 10.0
Launch = Callable[..., Swarm]


@pytest.fixture
def launch(monkeypatch: pytest.MonkeyPatch) -> Iterator[Launch]:
    """Yield a factory of swarms of stand-ins; checks at the end that no process or port is left."""
    launched: list[Swarm] = []

    def command(module: str, *arguments: str) -> list[str]:
        return [sys.executable, str(STAND_INS), module, *arguments]

    def make(name: str = "fine", **options: Any) -> Swarm:
        launched.append(Swarm(Scenario(name=name, agents=2), wall_limit_s=120.0, **options))
        return launched[-1]

    monkeypatch.setattr(harness.launch.processes, "bound_module", command)
    yield make
    for swarm in launched:
        swarm.stop()
        assert swarm.leftovers() == []


@pytest.mark.parametrize("name", ["physics", "radio", "prefork"])
def test_stopped_process_is_named_and_the_run_ends(launch: Launch, name: str) -> None:
    notes: list[str] = []
    swarm = launch(
        "endless", on_message=lambda m: notes.append(m.text) if isinstance(m, ProcessNotice) else None
    )
    with swarm:
        swarm.run(until_s=1.0)
        pid = swarm.pids[name]
        os.kill(pid, signal.SIGSTOP)
        wall_begin_s = time.monotonic()
        with pytest.raises(
            SwarmError, match=rf"^{name} \(pid {pid}\) is stopped \(SIGSTOP\) at 1\.0\d\d s$"
        ) as error:
            swarm.run(until_s=1e6)
        assert time.monotonic() - wall_begin_s < NAMED_WITHIN_S
        wall_begin_s = time.monotonic()
        swarm.stop()
        assert time.monotonic() - wall_begin_s < ENDED_WITHIN_S
    assert swarm.forced == ()
    assert f"{error.value}: the run ends" in notes
    assert swarm.records_lost == (None if name == "prefork" else str(error.value))


def test_process_that_is_continued_soon_does_not_end_the_run(launch: Launch) -> None:
    """Four swarms at once, as each takes six seconds; each has another process stopped."""

    def records_lost(name: str) -> str | None:
        with launch("endless") as swarm:
            swarm.run(until_s=1.0)
            pid = swarm.pids[name]
            os.kill(pid, signal.SIGSTOP)
            threading.Timer(1.5, os.kill, (pid, signal.SIGCONT)).start()
            threading.Timer(6.0, swarm.pause).start()  # a command ends the stand-in's run
            swarm.run(until_s=1e6)
        return swarm.records_lost

    names = ("physics", "radio", "prefork", "uav 1")
    with ThreadPoolExecutor(len(names)) as pool:
        lost = dict(zip(names, pool.map(records_lost, names), strict=True))
    assert lost == dict.fromkeys(names)


def test_physics_without_progress_is_named_and_leaves_a_trace(launch: Launch) -> None:
    with launch("physics-hangs") as swarm:
        with pytest.raises(SwarmError, match=r"^physics \(pid \d+\) has made no progress for \d+ s at "):
            swarm.run(until_s=5.0)
        swarm.stop()
        trace = Path(swarm.path, "logs", "physics.log").read_text()
    assert "Fatal Python error: Aborted" in trace
    assert swarm.records_lost is not None
    assert "physics.log" in swarm.records_lost


@pytest.mark.parametrize("name", ["physics", "uav 1"])
def test_process_that_is_stopped_during_the_start_is_named(launch: Launch, name: str) -> None:
    swarm = launch("never-connects")
    stopped: list[int] = []

    def stop_it() -> None:
        while name not in swarm.pids:
            time.sleep(0.01)
        stopped.append(swarm.pids[name])
        os.kill(stopped[0], signal.SIGSTOP)

    threading.Thread(target=stop_it).start()
    wall_begin_s = time.monotonic()
    with pytest.raises(SwarmError, match=rf"^{name} \(pid \d+\) is stopped \(SIGSTOP\) during the start$"):
        swarm.start()
    assert time.monotonic() - wall_begin_s < 2.0 * NAMED_WITHIN_S
    assert swarm.leftovers() == []
