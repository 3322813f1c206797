"""Simulated time follows the wall clock without leaps; pausing and resuming are commands."""

import queue
from itertools import pairwise
from types import SimpleNamespace

import pytest

from foundation.processes.child_protocol import Stop
from harness.simulator.emulator_client import UNPACED
from harness.simulator.messages import AnyCommand, Pause, Paused, Progress, Resume, RunUntil, SetSpeed
from harness.simulator.server import MOST_LAG_S, NAP_S, PROGRESS_PERIOD_S, Pacer, obey

STEP_US = 4_000


class Clock:
    """Wall time that passes only in sleeps and in steps."""

    def __init__(self) -> None:
        self.wall_s = 1_000.0
        self.sleeps_s: list[float] = []

    def monotonic(self) -> float:
        return self.wall_s

    def sleep(self, seconds: float) -> None:
        self.sleeps_s.append(seconds)
        self.wall_s += seconds


class World:
    """A simulation in which only time passes; ``slow`` maps a step to its additional wall time."""

    def __init__(self, clock: Clock, slow: dict[int, float] | None = None) -> None:
        self.clock, self.slow = clock, slow or {}
        self.time_us = STEP_US
        self.any_alive, self.must_end, self.formed, self.busy_fraction = True, False, False, 0.0
        self.lockstep = SimpleNamespace(connect=lambda *_, **__: None, living=0, slots=[])
        self.steps: list[tuple[int, float]] = []

    def step(self) -> None:
        self.clock.wall_s += 0.001 + self.slow.pop(len(self.steps), 0.0)
        self.time_us += STEP_US
        self.steps.append((self.time_us, self.clock.wall_s))

    def settle(self) -> None:
        pass

    def notice_collisions(self) -> None:
        pass

    def vehicles(self) -> tuple[()]:
        return ()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("harness.simulator.server.time", clock)
    return clock


class Inbox(queue.SimpleQueue):  # type: ignore[type-arg]
    """A queue whose waits advance the clock; the commands ``coming`` arrive at their wall times."""

    def __init__(self, clock: Clock, coming: dict[float, AnyCommand] | None = None) -> None:
        super().__init__()
        self.clock, self.coming = clock, coming or {}

    def empty(self) -> bool:
        for wall_s in sorted(at_s for at_s in self.coming if at_s <= self.clock.wall_s):
            self.put(self.coming.pop(wall_s))
        return super().empty()

    def get(self, block: bool = True, timeout: float | None = None) -> AnyCommand:  # noqa: FBT001, FBT002
        if timeout is None or not super().empty():
            return super().get(block, timeout)
        end_s = self.clock.wall_s + timeout
        for wall_s in sorted(at_s for at_s in self.coming if at_s <= end_s):
            self.clock.wall_s = max(self.clock.wall_s, wall_s)
            return self.coming.pop(wall_s)
        self.clock.wall_s = end_s
        raise queue.Empty


def flown(
    world: World,
    *commands: AnyCommand,
    during: dict[int, AnyCommand] | None = None,
    coming: dict[float, AnyCommand] | None = None,
) -> list[object]:
    """Execute commands; those of ``during`` arrive after so many events, those of ``coming`` at a wall time.

    Returns the events.
    """
    inbox = Inbox(world.clock, coming)
    events: list[object] = []
    later = dict(during or {})

    def emit(event: object) -> None:
        events.append(event)
        for command in [later.pop(k) for k in sorted(later) if len(events) >= k]:
            inbox.put(command)
        if isinstance(event, Paused):
            inbox.put(Stop())

    for command in commands:
        inbox.put(command)
    obey(world, inbox, connect_timeout_s=1.0, emit=emit)  # type: ignore[arg-type]
    return events


def test_a_second_at_speed_two_takes_half_a_second_however_inexact_sleeps_are(clock: Clock) -> None:
    world = World(clock)
    begin_s = clock.wall_s
    end = RunUntil(time_us=1_000_000 + STEP_US, speed=2.0)
    (*_, paused) = [e for e in flown_then_stop(world, end) if isinstance(e, Paused)]
    assert paused.time_us == end.time_us
    # the first step sets the anchor; from then on every step has its absolute time
    assert clock.wall_s - begin_s == pytest.approx(0.001 + 0.5, abs=0.0021)


@pytest.mark.parametrize("speed", [1.0, 0.5])
def test_steps_with_a_lead_begin_before_their_time_is_due_by_it(speed: float) -> None:
    pacer = Pacer(lead_us=3 * STEP_US)
    pacer.begin(speed, STEP_US, 10.0)
    assert pacer.ahead_s(STEP_US, 10.0) == 0.0
    # a step that begins now is due after the lead
    lead_ns = 3 * STEP_US * 1e3 / speed
    assert pacer.pace(STEP_US).due_ns == pytest.approx(10e9 + lead_ns)
    later_us = STEP_US + 400_000
    assert pacer.ahead_s(later_us, 10.0) == pytest.approx(0.4 / speed)
    # after a stall, its due time is that of a step that begins then, again
    stalled_s = 10.0 + 0.4 / speed + 2 * MOST_LAG_S
    assert pacer.ahead_s(later_us, stalled_s) == pytest.approx(-2 * MOST_LAG_S)
    assert pacer.pace(later_us).due_ns == pytest.approx(stalled_s * 1e9 + lead_ns)
    assert pacer.lag_s == pytest.approx(2 * MOST_LAG_S)


def flown_then_stop(world: World, *commands: AnyCommand) -> list[object]:
    """Execute commands one after the other, each when the previous run is done, and then stop."""
    inbox: queue.SimpleQueue[AnyCommand] = queue.SimpleQueue()
    events: list[object] = []
    waiting = [*commands, Stop()]

    def emit(event: object) -> None:
        events.append(event)
        if isinstance(event, Paused):
            inbox.put(waiting.pop(0))

    inbox.put(waiting.pop(0))
    obey(world, inbox, connect_timeout_s=1.0, emit=emit)  # type: ignore[arg-type]
    return events


def test_the_lag_of_a_stall_is_reported_and_not_caught_up(clock: Clock) -> None:
    world = World(clock, slow={50: 0.7})
    events = flown_then_stop(world, RunUntil(time_us=2_000_000, speed=1.0))
    (last,) = [e for e in events if isinstance(e, Progress)][-1:]
    assert last.lag_s == pytest.approx(0.7, abs=0.01)
    after = world.steps[51:]
    for (earlier_us, earlier_s), (later_us, later_s) in pairwise(after):
        assert (later_s - earlier_s) == pytest.approx((later_us - earlier_us) * 1e-6, abs=1e-6)


def test_a_shorter_stall_is_caught_up(clock: Clock) -> None:
    world = World(clock, slow={50: 0.9 * MOST_LAG_S})
    begin_s = clock.wall_s
    events = flown_then_stop(world, RunUntil(time_us=1_000_000 + STEP_US, speed=1.0))
    assert clock.wall_s - begin_s == pytest.approx(1.0, abs=0.01)
    assert all(e.lag_s == 0.0 for e in events if isinstance(e, Progress))


def test_wall_time_between_two_runs_is_no_lag() -> None:
    pacer = Pacer()
    pacer.begin(1.0, 0, 100.0)
    assert pacer.ahead_s(4_000, 100.0) == 0.0
    assert pacer.ahead_s(8_000, 100.001) == pytest.approx(0.003)
    pacer.begin(1.0, 8_000, 130.0)
    assert pacer.ahead_s(12_000, 130.0) == 0.0
    assert pacer.ahead_s(16_000, 130.0) == pytest.approx(0.004)
    assert pacer.lag_s == 0.0
    pacer.begin(0.0, 16_000, 130.0)
    assert pacer.ahead_s(1_000_000, 131.0) == 0.0  # as fast as possible


def test_a_run_that_was_paused_continues_to_its_end(clock: Clock) -> None:
    world = World(clock)
    # the pause comes first; a paused run continues to report, and the third report is followed by Resume
    events = flown(world, Pause(), RunUntil(time_us=400_000, speed=1.0), during={3: Resume()})
    standing = [e for e in events if isinstance(e, Progress) and e.paused]
    assert len(standing) >= 2
    assert {e.time_us for e in standing} == {STEP_US}
    paused = next(e for e in events if isinstance(e, Paused))
    assert (paused.reason, paused.time_us) == ("time", 400_000)


def test_stop_ends_a_paused_run(clock: Clock) -> None:
    world = World(clock)
    events = flown(world, Pause(), RunUntil(time_us=400_000), during={2: Stop()})
    assert isinstance(events[-1], Paused)
    assert events[-1].reason == "command"
    assert world.steps == []


def test_another_speed_applies_from_then_on(clock: Clock) -> None:
    world = World(clock)
    flown(world, RunUntil(time_us=4_000_000, speed=1.0), during={2: SetSpeed(speed=4.0)})
    first, last = world.steps[:20], world.steps[-20:]
    for steps, speed in ((first, 1.0), (last, 4.0)):
        took_s = steps[-1][1] - steps[0][1]
        assert (steps[-1][0] - steps[0][0]) * 1e-6 / took_s == pytest.approx(speed, rel=0.1)


def test_a_slow_run_reports_a_few_times_per_second_and_a_command_ends_the_wait(clock: Clock) -> None:
    world, begin_s = World(clock), clock.wall_s
    # more than an hour per step
    events = flown(world, RunUntil(time_us=1_000_000, speed=1e-6), coming={begin_s + 700.0: Stop()})
    assert clock.wall_s == pytest.approx(begin_s + 700.0, abs=0.01)
    reported_s = [begin_s, *(e.wall_s for e in events if isinstance(e, Progress))]
    assert len(reported_s) > 1_000
    assert max(later - earlier for earlier, later in pairwise(reported_s)) < 2.0 * PROGRESS_PERIOD_S
    assert max(clock.sleeps_s, default=0.0) <= NAP_S
    assert [e.reason for e in events if isinstance(e, Paused)] == ["command"]


def test_another_speed_and_a_pause_apply_at_once_in_a_slow_run(clock: Clock) -> None:
    world, begin_s = World(clock), clock.wall_s
    coming: dict[float, AnyCommand] = {
        begin_s + 10.0: SetSpeed(speed=1.0),
        begin_s + 10.5: Pause(),
        begin_s + 14.0: Resume(),
    }
    events = flown(world, RunUntil(time_us=1_000_000, speed=1e-6), coming=coming)
    assert clock.wall_s == pytest.approx(begin_s + 10.0 + 1.0 + 3.5, abs=0.05)
    paused = next(e for e in events if isinstance(e, Paused))
    assert paused.wall_paused_s == pytest.approx(3.5, abs=0.05)
    # the last report of a paused run has the wall time of the pause
    standing = [e for e in events if isinstance(e, Progress) and e.paused]
    assert standing[-1].wall_paused_s == pytest.approx(3.5, abs=1.5 * PROGRESS_PERIOD_S)
    for earlier, later in pairwise(standing):
        assert later.wall_paused_s - earlier.wall_paused_s == pytest.approx(later.wall_s - earlier.wall_s)


def test_pace_states_when_a_simulated_time_is_due() -> None:
    pacer = Pacer()
    pacer.begin(0.5, 1_000_000, 20.0)
    assert pacer.pace(2_000_000) == UNPACED  # the first step sets the anchor
    pacer.ahead_s(1_000_000, 20.0)
    assert pacer.pace(2_000_000) == (22_000_000_000, 0.5)
    pacer.pause()
    assert pacer.pace(2_000_000) == UNPACED
    pacer.begin(0.0, 1_000_000, 30.0)
    pacer.ahead_s(1_000_000, 30.0)
    assert pacer.pace(2_000_000) == UNPACED
