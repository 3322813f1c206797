"""Ctrl-C during the stop of a swarm: the manifest still gets how the run ended."""

import contextlib
import signal
from types import SimpleNamespace

import pytest

from harness.launch.interrupts import interruptible, interrupts_deferred
from harness.launch.swarm import Swarm


def test_ctrl_c_during_the_stop_takes_effect_after_the_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    def stop() -> None:
        with interrupts_deferred():
            signal.raise_signal(signal.SIGINT)
        done.append("stopped")

    swarm = Swarm.__new__(Swarm)  # without processes
    swarm._links, swarm._is_flying = contextlib.ExitStack(), True
    monkeypatch.setattr(swarm, "_processes", SimpleNamespace(stop=stop), raising=False)
    monkeypatch.setattr(swarm, "_write_outcome", lambda: done.append("outcome"))
    with interruptible(), pytest.raises(KeyboardInterrupt):
        swarm.stop()
    assert done == ["stopped", "outcome"]
