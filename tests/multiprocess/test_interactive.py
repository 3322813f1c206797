"""Flights at wall-clock pace: pause, hold and release, steady and changed speed, heartbeats."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import common
from swarms import AGENTS, Held

from autopilot.mavlink.input_budget import PARTNER_FRAMES_S
from harness.launch.swarm import Swarm
from harness.simulator.messages import Progress
from harness.simulator.server import MOST_LAG_S

pytestmark = pytest.mark.multiprocess

SCENARIO = "scenarios/article.toml"
WALL_LIMIT_S = 60.0


@pytest.fixture
def held() -> Iterator[Callable[..., Swarm]]:
    """Yield a factory of started swarms, with `onboard.hold` by default."""
    started: list[Swarm] = []

    def start(*, agents: int = 2, hold: bool = True, **options: Any) -> Swarm:
        overrides = ["onboard.hold=true"] if hold else []
        swarm = Swarm(SCENARIO, agents=agents, overrides=overrides, wall_limit_s=120.0, **options)
        started.append(swarm)
        swarm.start()
        return swarm

    yield start
    for swarm in started:
        swarm.stop()


def receive(
    link: Any, kind: str, *, until: Callable[[list[tuple[float, Any]]], bool] = bool, component: int = 1
) -> list[tuple[float, Any]]:
    """Return messages of a kind with the wall times of their arrival, until ``until`` is true of them.

    By default this is the first message; raises AssertionError after `WALL_LIMIT_S`.
    """
    messages: list[tuple[float, Any]] = []
    wall_end_s = time.monotonic() + WALL_LIMIT_S
    while not until(messages):
        message = link.recv_match(type=kind, blocking=True, timeout=max(0.0, wall_end_s - time.monotonic()))
        assert time.monotonic() < wall_end_s, f"{len(messages)} {kind}, not enough"
        if message is not None and message.get_srcComponent() == component:
            messages.append((time.monotonic(), message))
    return messages


def command(link: Any, number: int, *params: float, component: int = 1) -> int:
    """Send a COMMAND_LONG; returns its result."""
    link.mav.command_long_send(1, component, number, 0, *params, *(0.0,) * (7 - len(params)))
    answers = receive(
        link, "COMMAND_ACK", until=lambda acks: any(m.command == number for _, m in acks), component=component
    )
    return answers[-1][1].result


def is_armed(beat: Any) -> bool:
    return bool(beat.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED)


def test_heartbeats_and_commands_continue_during_a_pause(held) -> None:
    swarm = held(agents=1)
    link = swarm.mavlink(0)
    swarm.run_for(8.0)  # until arming is permitted
    while link.recv_msg() is not None:
        pass

    def shortest_gap_s(beats: list[tuple[float, Any]]) -> float:
        gaps_s = (later - earlier for (earlier, _), (later, _) in pairwise(beats))
        return min(gaps_s, default=float("inf"))

    # time is paused. The period is a second and one poll on an idle machine; stations time out after three
    beats = receive(link, "HEARTBEAT", until=lambda beats: len(beats) >= 4 and shortest_gap_s(beats) < 1.4)
    assert beats[-1][0] - beats[0][0] > (len(beats) - 1) * 0.9 - 0.5  # and no shorter period
    assert not any(is_armed(beat) for _, beat in beats)
    assert command(link, common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == common.MAV_RESULT_ACCEPTED
    receive(link, "HEARTBEAT", until=lambda beats: bool(beats) and is_armed(beats[-1][1]))
    assert command(link, common.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == common.MAV_RESULT_ACCEPTED
    # setpoints within the link's budget are read from the socket; the last one is used
    for i in range(PARTNER_FRAMES_S // 2):
        link.mav.set_position_target_local_ned_send(
            0, 1, 1, common.MAV_FRAME_LOCAL_NED, 0x0DF8, 0.0, 0.0, -float(i), *(0.0,) * 8
        )
        time.sleep(1e-4)
    offboard = (float(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), 6.0)
    assert command(link, common.MAV_CMD_DO_SET_MODE, *offboard) == common.MAV_RESULT_ACCEPTED
    before_s = swarm.truth.t_s
    swarm.run_for(0.2)
    assert swarm.truth.t_s == pytest.approx(before_s + 0.2)
    # the time-out of setpoints is in simulated time
    assert swarm.truth.vehicles[0].mode == "Offboard"


def test_pause_does_not_change_the_flight(held, tmp_path) -> None:
    hashes = []
    for name, pauses in (("straight", False), ("paused", True)):
        progress: list[Progress] = []
        swarm = held(
            hold=False,
            out=tmp_path / name,
            on_message=lambda m, received=progress: received.append(m) if isinstance(m, Progress) else None,
        )
        if pauses:
            swarm.pause()
            threading.Timer(1.2, swarm.resume).start()
        swarm.run(until_s=3.0)
        paused = [p for p in progress if p.paused]
        assert bool(paused) is pauses
        assert len({p.time_us for p in paused}) <= 1
        summary = swarm.summary(draw=False)
        hashes.append(summary["log_sha256"])
        assert summary["deterministic"]
    assert hashes[0] == hashes[1]


def test_held_uavs_range_and_stay_until_release(held) -> None:
    swarm = held(agents=2)
    swarm.run_for(12.0)
    assert [vehicle.phase for vehicle in swarm.truth.vehicles] == ["held", "held"]
    assert not any(vehicle.armed for vehicle in swarm.truth.vehicles)
    link = swarm.mavlink(0)
    # other commands and other components do not release
    assert command(link, common.MAV_CMD_USER_2, component=191) == common.MAV_RESULT_UNSUPPORTED
    assert command(link, common.MAV_CMD_USER_1, component=1) != common.MAV_RESULT_ACCEPTED
    assert command(link, common.MAV_CMD_USER_1, component=191) == common.MAV_RESULT_ACCEPTED
    assert command(link, common.MAV_CMD_USER_1, component=191) == common.MAV_RESULT_ACCEPTED  # a repetition
    truth = swarm.run_until(lambda truth: truth.vehicles[0].phase == "on station", timeout_s=60.0)
    assert truth.vehicles[1].phase == "held"
    assert not truth.vehicles[1].armed
    swarm.run_for(0.5)
    summary = swarm.summary(draw=False)
    assert summary["ftm"]["completed"] > 0
    # the released vehicle alone is a reached formation, and the other stands on the ground
    assert summary["formed_s"] is not None
    assert_no_formation(summary)


def assert_no_formation(summary: dict[str, Any]) -> None:
    """Check that nothing is reported of a formation that was not asked for."""
    assert set(summary["formation_rms_m"].values()) == {None}
    kinds = ("absolute_rms_m", "shape_rms_m")
    assert {vehicle[kind] for vehicle in summary["vehicles"] for kind in kinds} == {None}
    assert (summary["max_gain_dbi"]["mean"], summary["max_gain_dbi"]["ideal"]) == (None, None)


def test_a_hold_without_applications_waits_at_the_walls_pace_until_ctrl_c(tmp_path) -> None:
    options = ("--set", "onboard.enabled=false", "--set", "run.duration_s=0.5")
    swarm = Held(tmp_path / "run", *options)
    try:
        wall_begin_s = time.monotonic()
        swarm.start()
        line = swarm.await_time(2.0)  # beyond run.duration_s
        assert time.monotonic() - wall_begin_s > 1.5
        manifest = swarm.end()
    finally:
        swarm.kill()
    assert "holding until Ctrl-C" in line
    assert f"{AGENTS} disarmed" in line
    assert not any("error" in line for line in swarm.log_lines)
    assert (manifest["status"], manifest["reason"], manifest["speed"]) == ("held", None, 1.0)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["status"] == "held"
    assert_no_formation(summary)


def test_pace_is_steady_and_delays_are_not_made_up(held) -> None:
    progress: list[Progress] = []
    swarm = held(
        agents=1, speed=2.0, on_message=lambda m: progress.append(m) if isinstance(m, Progress) else None
    )
    wall_begin_s = time.monotonic()
    swarm.run_for(3.0)
    assert time.monotonic() - wall_begin_s > 3.0 / 2.0 - 0.02
    threading.Timer(0.5, swarm.pause).start()
    threading.Timer(1.5, swarm.resume).start()
    first_run = progress.copy()
    progress.clear()  # no pace is kept between two runs
    swarm.run_for(3.0)
    assert any(p.paused for p in progress)
    for a, b in (*pairwise(first_run), *pairwise(progress)):
        if b.time_us > a.time_us and not a.paused and not b.paused:
            late_s = (b.wall_s - a.wall_s) - (b.time_us - a.time_us) * 1e-6 / 2.0
            # delays are reported, except those of at most MOST_LAG_S, which are made up
            assert -MOST_LAG_S - 0.02 < late_s - (b.lag_s - a.lag_s) < MOST_LAG_S + 0.02


def test_speed_can_be_changed_during_a_run(held) -> None:
    swarm = held(agents=1, speed=0.02)
    assert swarm.speed == 0.02
    wall_begin_s = time.monotonic()
    threading.Timer(0.5, swarm.set_speed, ["max"]).start()
    swarm.run_for(3.0)
    assert time.monotonic() - wall_begin_s < WALL_LIMIT_S  # 150 s at 0.02
    assert swarm.speed == "max"
