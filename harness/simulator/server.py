"""The physics server's process: runs `simulation` with sockets to the vehicles and to the emulator.

``python -m harness.simulator.server`` executes the commands of `harness.simulator.messages` and paces the
simulation to the requested speed.
"""

import argparse
import contextlib
import os
import queue
import socket
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from foundation.extension_call import end_stuck, watched
from foundation.extension_failure import ExtensionFailure
from foundation.processes.child_protocol import Finished, Ready, Stop, Warned, commands, emit
from foundation.profiling.profiler import profiled
from foundation.system_error import in_words
from harness.records.run_folder import PhysicsConfig
from harness.simulator.application_links import ApplicationLinks
from harness.simulator.ardupilot_link import ArduPilotLink
from harness.simulator.emulator_client import UNPACED, EmulatorClient, Pace, RadioSilent
from harness.simulator.emulator_wait import EMULATOR, POLL_S, AwaitedLine, radio_watchdog
from harness.simulator.lockstep import OWN, PX4, ConnectTimeout, Lockstep
from harness.simulator.messages import (
    AnyCommand,
    AnyEvent,
    InjectFault,
    Pause,
    Paused,
    Progress,
    Resume,
    RunUntil,
    SetAttenuation,
    SetPid,
    SetRadioPid,
    SetSpeed,
    Waiting,
)
from harness.simulator.profile_groups import PROFILE_GROUPS
from harness.simulator.response_watchdog import ResponseWatchdog
from harness.simulator.simulation import Simulation, run
from harness.simulator.slot_guard import UNGUARDED, RejectedPeer, SlotGuard
from harness.world.physics.warm_up import warm_up
from netsim.radio_models import registry
from netsim.transport.interval_stream import time_masters_end

PROGRESS_PERIOD_S = 0.2
MOST_LAG_S = 0.1
"""A run that is later than this does not catch up: its vehicles would leap before an observer or pilot."""
NETWORK_LEAD_STEPS = 10
"""Steps by which the vehicles are ahead of a channel with packets of programs, which follows wall time: steps
that take longer than their share do not delay the packets. Arrivals are released that much later: after
40 ms, the length of an interval without programs."""
NAP_S = 0.02
"""Longest wall time to sleep before a step that is early; a longer wait serves commands."""


class Pacer:
    """Synchronises simulated time to wall time. Each step has an absolute time, so errors do not add up.

    With ``lead_us`` steps begin by this simulated time earlier than due: an emulator that follows the pace
    then has the request of its next interval when that begins.

    Attributes:
        lag_s: total wall time lost by steps that took longer than their share.

    """

    def __init__(self, *, lead_us: int = 0) -> None:
        self.lag_s = 0.0
        self._lead_us = lead_us
        self._speed = 0.0
        self._anchor: tuple[int, float] | None = None
        """A simulated time and the wall time at which it is due."""

    def begin(self, speed: float, time_us: int, wall_s: float) -> None:
        """Continue at a speed, 0: as fast as possible; the time since the last step does not count as lag."""
        late_s = -self.ahead_s(time_us, wall_s, note=False)
        if speed != self._speed or late_s > MOST_LAG_S:
            self._anchor = None
        self._speed = speed

    def pause(self) -> None:
        """Pause simulated time: the wall time until the next step does not count as lag."""
        self._anchor = None

    def ahead_s(self, time_us: int, wall_s: float, *, note: bool = True) -> float:
        """Return the wall time by which the step of ``time_us`` would begin early; negative: late."""
        if self._speed <= 0.0:
            return 0.0
        due_s = wall_s + self._lead_us * 1e-6 / self._speed  # of ``time_us``, if its step begins now
        if self._anchor is None:
            self._anchor = (time_us, due_s)
            return 0.0
        anchor_us, wall_anchor_s = self._anchor
        ahead_s = (time_us - anchor_us) * 1e-6 / self._speed - (due_s - wall_anchor_s)
        if note and ahead_s < -MOST_LAG_S:
            self.lag_s -= ahead_s
            self._anchor = (time_us, due_s)
        return ahead_s

    def pace(self, time_us: int) -> Pace:
        """Return the wall time at which ``time_us`` is due, and the speed."""
        if self._anchor is None:
            return UNPACED
        anchor_us, wall_anchor_s = self._anchor
        wall_s = wall_anchor_s + (time_us - anchor_us) * 1e-6 / self._speed
        return Pace(round(wall_s * 1e9), self._speed)


class _Commands:
    """Queue of commands; `Pause`, `Resume` and `SetSpeed` take effect at once instead."""

    def __init__(self, inbox: "queue.SimpleQueue[AnyCommand]") -> None:
        self._inbox = inbox
        self._later: deque[AnyCommand] = deque()
        self.paused = False
        self.speed: float | None = None
        """New speed since it was last read."""

    @property
    def quiet(self) -> bool:
        """Whether no command has arrived that affects the run."""
        return self.empty() and not self.paused and self.speed is None

    def get(self) -> AnyCommand:
        """Wait for the next command that does not concern the pace, and return it."""
        while not self._later:
            self._sort(self._inbox.get())
        return self._later.popleft()

    def empty(self) -> bool:
        """Whether `get` would have to wait."""
        while not self._inbox.empty():
            self._sort(self._inbox.get())
        return not self._later

    def wait(self, wall_timeout_s: float) -> None:
        """Wait for another command, at most ``wall_timeout_s``."""
        with contextlib.suppress(queue.Empty):
            self._sort(self._inbox.get(timeout=wall_timeout_s))

    def _sort(self, command: AnyCommand) -> None:
        match command:
            case Pause():
                self.paused = True
            case Resume():
                self.paused = False
            case SetSpeed(speed=speed):
                self.speed = speed
            case _:
                self._later.append(command)


def obey(
    simulation: Simulation,
    inbox: "queue.SimpleQueue[AnyCommand]",
    *,
    connect_timeout_s: float,
    pacer: Pacer | None = None,
    emit: Callable[[AnyEvent], None],
    set_pid: Callable[[SetPid | SetRadioPid], None] = lambda _: None,
    on_wait: Callable[[float], object] = lambda _: None,
) -> None:
    """Execute commands until Stop; ``set_pid`` receives the process ids of the others.

    ``pacer`` is for others to read; None: one of its own.

    ``on_wait`` is called with the wall time, repeatedly while vehicles are awaited that have not connected.

    Raises the errors of the simulation's vehicles and of its channel.
    """
    connected, line = False, _Commands(inbox)
    pacer = pacer or Pacer()

    def keep_waiting() -> bool:
        on_wait(time.monotonic())
        return line.empty()

    while True:
        match line.get():
            case RunUntil() as command:
                if not connected:
                    simulation.lockstep.connect(connect_timeout_s, keep_waiting=keep_waiting)
                    connected = simulation.lockstep.living == len(simulation.lockstep.slots)
                if connected:
                    emit(_run(simulation, command, line, pacer, emit))
                else:  # another command interrupted the handshake; the next run continues it
                    paused = Paused(
                        time_us=simulation.time_us, reason="command", vehicles=simulation.vehicles()
                    )
                    emit(paused)
            case SetAttenuation(extra_attenuation_db=attenuation_db):
                simulation.set_extra_attenuation_db(attenuation_db)
            case InjectFault(fault=fault):
                simulation.inject(fault)
            case SetPid() | SetRadioPid() as command:
                set_pid(command)
            case Stop():
                return


def _run(
    simulation: Simulation, command: RunUntil, line: _Commands, pacer: Pacer, emit: Callable[[AnyEvent], None]
) -> Paused:
    """Step until the command is done, or until another command arrives (which is left to the caller)."""
    wall_progress_s = time.monotonic()
    wall_paused_s = 0.0
    line.speed = None
    pacer.begin(command.speed, simulation.time_us, wall_progress_s)

    def report(wall_s: float) -> None:
        nonlocal wall_progress_s
        wall_progress_s = wall_s
        emit(
            Progress(
                time_us=simulation.time_us,
                wall_s=wall_s,
                channel_busy_fraction=simulation.busy_fraction,
                vehicles=simulation.vehicles(),
                lag_s=pacer.lag_s,
                paused=line.paused,
                wall_paused_s=wall_paused_s,
            )
        )

    def hold() -> None:
        nonlocal wall_paused_s
        simulation.settle()
        wall_begin_s, before_s = time.monotonic(), wall_paused_s

        def report_paused() -> None:
            nonlocal wall_paused_s
            wall_s = time.monotonic()
            wall_paused_s = before_s + wall_s - wall_begin_s
            report(wall_s)

        while line.paused and line.empty():
            report_paused()
            line.wait(PROGRESS_PERIOD_S)
        pacer.pause()
        report_paused()

    def interrupted() -> bool:
        idle = line.empty()
        if line.paused and idle:
            hold()
            idle = line.empty()
        if line.speed is not None:
            pacer.begin(line.speed, simulation.time_us, time.monotonic())
            line.speed = None
        return not idle

    def keep_pace() -> None:
        wall_s = time.monotonic()
        ahead_s = pacer.ahead_s(simulation.time_us, wall_s)
        if wall_s - wall_progress_s >= PROGRESS_PERIOD_S:
            report(wall_s)
        if 0.0 < ahead_s <= NAP_S:
            time.sleep(ahead_s)
        elif ahead_s > NAP_S:
            wait(wall_s + ahead_s)

    def wait(wall_until_s: float) -> None:
        """Wait for a long time while emulator, launcher and user are served."""
        simulation.settle()
        while line.quiet and (wall_s := time.monotonic()) < wall_until_s:
            if wall_s - wall_progress_s >= PROGRESS_PERIOD_S:
                report(wall_s)
            line.wait(min(wall_until_s - wall_s, PROGRESS_PERIOD_S))

    paused = run(simulation, command, interrupted=interrupted, on_step=keep_pace)
    return msgspec.structs.replace(paused, wall_paused_s=wall_paused_s)


def serve(
    config: PhysicsConfig,
    clock: socket.socket | None,
    *,
    vehicles: dict[int, socket.socket],
    listeners: dict[int, socket.socket],
    applications: dict[int, socket.socket],
    states: dict[int, socket.socket],
) -> None:
    """Execute commands until Stop; ``clock`` is the connection to the 802.11 emulator, if there is one.

    The other sockets are by vehicle: ``vehicles`` are the connections to coflight's own vehicles,
    ``listeners`` the TCP listeners at which other ones arrive, ``applications`` the connections to the
    applications beside PX4s and ArduPilots, ``states`` the UDP sockets for the states of ArduPilots.

    Raises ConnectTimeout, RadioSilent, or OSError for a file or an address.
    """
    inbox: queue.SimpleQueue[AnyCommand] = queue.SimpleQueue()
    commands(AnyCommand, inbox)  # type: ignore[arg-type]  # msgspec accepts a union as a type
    scenario = config.scenario
    wall_reported_s = 0.0

    def on_wait(wall_s: float) -> None:
        nonlocal wall_reported_s
        if wall_s - wall_reported_s >= PROGRESS_PERIOD_S:
            wall_reported_s = wall_s
            emit(Waiting(time_us=simulation.time_us))

    limit_s = scenario.run.silence_limit_s
    watchdog, application_watchdog = (ResponseWatchdog(limit_s, on_check=on_wait) for _ in range(2))
    emulator_watchdog = radio_watchdog(limit_s, on_check=on_wait)
    policies = [PX4 if scenario.autopilot.is_px4(i) else OWN for i in range(scenario.agents)]
    has_px4 = PX4 in policies
    guard = SlotGuard(on_rejected=_warn_rejected)
    admitting = guard if scenario.ports.simulator_peers == "started" else UNGUARDED

    def make_lockstep(simulation: Simulation) -> Lockstep:
        return Lockstep(
            {i: each for i, each in listeners.items() if i not in states},
            links=vehicles,
            guard=admitting,
            watchdog=watchdog,
            on_message=simulation.on_message,
            on_silent=simulation.reports.on_silent,
            on_lost=simulation.reports.on_lost,
            policies=policies,
            ardupilots={
                i: ArduPilotLink(sock, listeners[i], system=i + 1, guard=admitting)
                for i, sock in states.items()
            },
            rotors=scenario.most_rotors,
        )

    def make_applications(simulation: Simulation) -> ApplicationLinks:
        return ApplicationLinks(
            applications,
            period_us=scenario.onboard.loop_period_us,
            watchdog=application_watchdog,
            on_message=simulation.on_message,
            on_silent=simulation.reports.on_application_silent,
            on_lost=simulation.reports.on_application_lost,
        )

    def set_pid(command: SetPid | SetRadioPid) -> None:
        if isinstance(command, SetRadioPid):
            emulator_watchdog.set_pid(EMULATOR, command.pid)
            watchdog.set_radio_pid(command.pid)
            return
        chosen = application_watchdog if command.is_application else watchdog
        chosen.set_pid(command.instance, command.pid)
        if not command.is_application:
            guard.set_pid(command.instance, command.pid)

    with contextlib.ExitStack() as stack:
        emulator = None
        lead_steps = NETWORK_LEAD_STEPS if scenario.has_network else 1
        pacer = Pacer(lead_us=lead_steps * scenario.run.step_us if scenario.has_network else 0)
        if clock is not None:
            line = time_masters_end(stack.enter_context(clock), limit_s=POLL_S)
            emulator = EmulatorClient(
                AwaitedLine(line, emulator_watchdog),
                period_us=scenario.onboard.loop_period_us,
                asynchronous=bool(scenario.channel.guests) or scenario.has_network,
                lead_steps=lead_steps,
                pace=pacer.pace,
            )
        simulation = stack.enter_context(
            contextlib.closing(
                Simulation(
                    config,
                    make_lockstep=make_lockstep,
                    make_applications=make_applications if applications else None,
                    emulator=emulator,
                    emit=emit,
                )
            )
        )
        if scenario.has_network:  # it will follow wall time, and loading a kernel takes milliseconds
            warm_up()
        emit(Ready(name="physics", pid=os.getpid()))
        with profiled(
            PROFILE_GROUPS, now_us=lambda: simulation.time_us, from_us=config.profile_from_us
        ) as profile:
            obey(
                simulation,
                inbox,
                pacer=pacer,
                connect_timeout_s=config.connect_timeout_s,
                emit=emit,
                set_pid=set_pid,
                on_wait=on_wait,
            )
    details: dict[str, Any] = {"time_us": simulation.time_us, "formed": simulation.reports.formed, **profile}
    if has_px4:
        details["late_answers"] = {f"uav {i}": count for i, count in simulation.lockstep.late_answers.items()}
    if rejected := guard.rejected():
        details["rejected_connections"] = rejected
    emit(Finished(name="physics", details=details))


def _warn_rejected(peer: RejectedPeer) -> None:
    text = f"{peer.describe()} was rejected at the simulator's port {peer.port}: not the vehicle of this run"
    emit(Warned(name="physics", time_us=0, text=text))


def _sockets(text: str) -> dict[int, socket.socket]:
    """Return inherited sockets by vehicle, from "0:8,1:9"."""
    pairs = (entry.split(":") for entry in filter(None, text.split(",")))
    return {int(instance): socket.socket(fileno=int(fd)) for instance, fd in pairs}


def main() -> int:
    """Parse the command line and serve; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m harness.simulator.server", description="The physics server of one run."
    )
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the server's settings")
    for option, content in (
        ("--vehicle-fds", "stream sockets to coflight's own vehicles"),
        ("--listen-fds", "listening TCP sockets of the vehicles that connect by themselves"),
        ("--application-fds", "stream sockets to the applications beside other autopilots"),
        ("--state-fds", "UDP sockets for the states of ArduPilots"),
    ):
        parser.add_argument(option, default="", help=f"inherited {content}, as vehicle:fd: 0:8,1:9")
    parser.add_argument(
        "--interval-fd",
        type=int,
        help="inherited stream socket to the 802.11 emulator; without it the swarm has no radio",
    )
    parser.add_argument("--supervised", action="store_true", help="accepted for uniformity, no effect")
    arguments = parser.parse_args()
    try:
        config = msgspec.json.decode(arguments.config.read_bytes(), type=PhysicsConfig)
        clock = None if arguments.interval_fd is None else socket.socket(fileno=arguments.interval_fd)
        limit_s = config.scenario.run.silence_limit_s
        with watched(limit_s, on_stuck=partial(end_stuck, "physics")):
            serve(
                config,
                clock,
                vehicles=_sockets(arguments.vehicle_fds),
                listeners=_sockets(arguments.listen_fds),
                applications=_sockets(arguments.application_fds),
                states=_sockets(arguments.state_fds),
            )
    except RadioSilent as error:
        users = [f"{field} {name}" for field, (name, _) in registry.named(config.scenario.radio).items()]
        calls = f"; it calls {', '.join(users)}" if users else ""
        print(f"physics: {error}{calls}", file=sys.stderr)
        return 2
    except (ConnectTimeout, OSError, ValueError) as error:
        print(f"physics: {in_words(error) if isinstance(error, OSError) else error}", file=sys.stderr)
        return 2
    except ExtensionFailure as error:
        traceback.print_exception(error)
        print(f"physics: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
