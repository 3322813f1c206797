"""Keys during a run: their effect on the swarm, also if it refuses, and when they are enabled."""

import contextlib
import time
from types import SimpleNamespace

import pytest

from harness.cli import fly as cli
from harness.cli.fly import FASTEST, SLOWEST
from harness.cli.progress import Stage
from harness.launch.one_process import OneProcessSwarm
from harness.launch.process_commands import PHYSICS
from harness.launch.run_messages import SwarmError
from harness.launch.supervisor import Supervisor, SupervisorError
from harness.launch.swarm import Swarm
from harness.simulator.messages import Pause, Progress


class Pressed:
    """A swarm that executes or refuses requests, and a display."""

    def __init__(self, speed=1.0, *, refuses=False):
        self.speed, self.refuses = speed, refuses
        self.stands, self.simulated_s, self.notes = False, 12.5, []

    def pause(self):
        self.set_stands(True)

    def resume(self):
        self.set_stands(False)

    def set_stands(self, stands):
        if self.refuses:
            raise SwarmError("the swarm is not running")
        self.stands = stands

    def set_speed(self, speed):
        assert 0.0 < speed < float("inf")
        self.speed = speed

    def note(self, line):
        self.notes.append(line)

    def press(self, keys):
        for key in keys:
            cli._on_key(key, self, self)
        return self


def test_the_space_bar_pauses_and_resumes_and_a_refusal_is_no_error():
    pressed = Pressed().press(" ")
    assert pressed.stands
    assert not pressed.press(" ").stands
    assert pressed.notes == ["paused at t = 12.50 s", "going on"]
    assert Pressed(refuses=True).press(" ").notes == []


def test_speeds_by_keys_are_limited_and_reversible():
    pressed = Pressed().press("-" * 20)
    assert pressed.speed == SLOWEST
    assert pressed.press("+" * 6).speed == 1.0
    assert pressed.press("+" * 2_000).speed == FASTEST
    # a speed of the command line is not changed in the wrong direction
    assert Pressed(1e-6).press("-").speed == 1e-6
    assert Pressed(1e-6).press("+").speed == 2e-6
    assert Pressed(500.0).press("+").speed == 500.0
    assert Pressed(500.0).press("-").speed == 250.0
    assert Pressed("max").press("+-").speed == "max"


def test_keys_are_enabled_when_every_process_is_ready(monkeypatch):
    order = []

    class Keys(contextlib.nullcontext):
        listening = True

        def __init__(self, _on_key):
            order.append("keys")
            super().__init__(self)

    swarm = SimpleNamespace(
        scenario=SimpleNamespace(
            name="small", agents=1, onboard=SimpleNamespace(hold=False), forms=False,
            run=SimpleNamespace(seed=1, duration_s=5.0),
        ),
        path="out", pids={"physics": 1}, forced=(), speed="max", truth=SimpleNamespace(t_s=0.004),
        start=lambda: order.append("start"), stop=lambda: order.append("stop"),
        run_for=lambda _: order.append("run"),
    )  # fmt: skip
    monkeypatch.setattr(cli, "Keyboard", Keys)
    display = SimpleNamespace(
        note=lambda line: order.append("hint") if "space" in line else None,
        begin=order.append,
    )
    assert cli._fly(swarm, display, until_interrupted=False) is None
    assert order == ["start", "keys", "hint", Stage("flying", end_s=5.004), "run", "stop"]


@pytest.mark.parametrize(("speed", "offered"), [("max", False), (2.0, True)])
def test_only_keys_with_an_effect_are_offered(speed, offered):
    line = cli._keys(SimpleNamespace(speed=speed), until_interrupted=False)
    assert "space" in line
    assert ("+ and -" in line) is offered
    assert "Ctrl-C" not in line
    assert "Ctrl-C ends the hold" in cli._keys(SimpleNamespace(speed=1.0), until_interrupted=True)


def test_a_command_before_the_physics_server_is_ready_is_refused_and_does_not_fail_the_run(tmp_path):
    with pytest.raises(SupervisorError, match="physics has not been started"):
        Supervisor(tmp_path).send(PHYSICS, Pause())
    swarm = Swarm("scenarios/article.toml", agents=1, out=tmp_path / "run")
    swarm._processes._running = True  # as during the start of its processes
    for ask in (swarm.pause, swarm.resume, lambda: swarm.set_speed(2.0)):
        with pytest.raises(SwarmError, match="not running"):
            ask()
    assert swarm._processes.failure is None
    assert not swarm.stands


def test_paused_wall_time_does_not_count_when_ctrl_c_ends_a_paused_run(tmp_path):
    stood = []

    def interrupt(message):
        if isinstance(message, Progress) and message.paused and max(stood, default=0.0) < 1.0:
            stood.append(message.wall_paused_s)
            if stood[-1] > 1.0:
                raise KeyboardInterrupt

    swarm = OneProcessSwarm(
        "scenarios/article.toml", agents=1, out=tmp_path / "run", wall_limit_s=60.0, on_message=interrupt
    )
    with swarm:
        swarm.pause()
        wall_begin_s = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            swarm.run_for(5.0)
        wall_run_s = time.monotonic() - wall_begin_s
    wall_s = swarm.summary(draw=False, interrupted=True)["wall_s"]
    assert wall_s == pytest.approx(wall_run_s - stood[-1], abs=0.05)
    assert wall_s < 0.5 * wall_run_s
