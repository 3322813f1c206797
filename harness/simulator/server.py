"""The physics server's process: runs `simulation` between the sockets of the vehicles and of the emulator.

``python -m harness.simulator.server`` runs on command (`harness.simulator.messages`), and at the speed asked
for.
"""

import argparse
import contextlib
import os
import queue
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from foundation.processes.child_protocol import Finished, Ready, Stop, commands, emit
from foundation.profiling.profiler import profiled
from harness.records.run_folder import PhysicsConfig
from harness.simulator.emulator_client import EmulatorClient, RadioSilent
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
    SetSpeed,
)
from harness.simulator.profile_groups import PROFILE_GROUPS
from harness.simulator.response_watchdog import ResponseWatchdog
from harness.simulator.simulation import Simulation, run
from netsim.transport.interval_stream import time_masters_end

PROGRESS_PERIOD_S = 0.2
MOST_LAG_S = 0.1
"""A run that is later than this is not hurried to catch up: who watches or flies would see it leap."""
NAP_S = 0.02
"""Wall time for which a step that is too early may be slept away; in a longer wait commands are heard."""


class Pacer:
    """Keeps simulated time to wall time: every step has its absolute time, so errors of sleeps do not add up.

    Attributes:
        lag_s: wall time lost in all by steps that took longer than they may.

    """

    def __init__(self) -> None:
        self.lag_s = 0.0
        self._speed = 0.0
        self._anchor: tuple[int, float] | None = None
        """A simulated time and the wall time that belongs to it."""

    def begin(self, speed: float, time_us: int, wall_s: float) -> None:
        """Go on at a speed, 0 being as fast as it goes; time since the last step is nobody's lag."""
        late_s = -self.ahead_s(time_us, wall_s, note=False)
        if speed != self._speed or late_s > MOST_LAG_S:
            self._anchor = None
        self._speed = speed

    def stand(self) -> None:
        """Have simulated time stand: what passes until the next step is nobody's lag either."""
        self._anchor = None

    def ahead_s(self, time_us: int, wall_s: float, *, note: bool = True) -> float:
        """Wall time by which a step that ends at ``time_us`` is too early; negative: too late."""
        if self._speed <= 0.0:
            return 0.0
        if self._anchor is None:
            self._anchor = (time_us, wall_s)
            return 0.0
        anchor_us, wall_anchor_s = self._anchor
        ahead_s = (time_us - anchor_us) * 1e-6 / self._speed - (wall_s - wall_anchor_s)
        if note and ahead_s < -MOST_LAG_S:
            self.lag_s -= ahead_s
            self._anchor = (time_us, wall_s)
        return ahead_s


class _Commands:
    """Commands in their order, but those about the pace of a run act while it lasts."""

    def __init__(self, inbox: "queue.SimpleQueue[AnyCommand]") -> None:
        self._inbox = inbox
        self._later: deque[AnyCommand] = deque()
        self.paused = False
        self.speed: float | None = None
        """As it was changed since it was last looked at."""

    @property
    def quiet(self) -> bool:
        """Whether nothing has come that a run must look at."""
        return self.empty() and not self.paused and self.speed is None

    def get(self) -> AnyCommand:
        """Take the next command that is none about the pace, waiting for it."""
        while not self._later:
            self._sort(self._inbox.get())
        return self._later.popleft()

    def empty(self) -> bool:
        """Whether there is none that `get` would return at once."""
        while not self._inbox.empty():
            self._sort(self._inbox.get())
        return not self._later

    def wait(self, wall_timeout_s: float) -> None:
        """Let at most this pass until another command."""
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
    emit: Callable[[AnyEvent], None],
    set_pid: Callable[[int, int], None] = lambda _instance, _pid: None,
) -> None:
    """Do as commanded until Stop; ``set_pid`` is told which processes are whose.

    Raises what the simulation's vehicles and its air raise.
    """
    connected, line, pacer = False, _Commands(inbox), Pacer()
    while True:
        match line.get():
            case RunUntil() as command:
                if not connected:
                    simulation.lockstep.connect(connect_timeout_s, keep_waiting=line.empty)
                    connected = simulation.lockstep.living == len(simulation.lockstep.seats)
                if connected:
                    emit(_run(simulation, command, line, pacer, emit))
                else:  # another command cut the rendezvous short; the next run goes on with it
                    paused = Paused(
                        time_us=simulation.time_us, reason="command", vehicles=simulation.vehicles()
                    )
                    emit(paused)
            case SetAttenuation(extra_attenuation_db=attenuation_db):
                simulation.set_extra_attenuation_db(attenuation_db)
            case InjectFault(fault=fault):
                simulation.inject(fault)
            case SetPid(instance=instance, pid=pid):
                set_pid(instance, pid)
            case Stop():
                return


def _run(
    simulation: Simulation,
    command: RunUntil,
    line: _Commands,
    pacer: Pacer,
    emit: Callable[[AnyEvent], None],
) -> Paused:
    """Step until the command is done, or until another command comes in (which is left for the caller)."""
    wall_progress_s = time.monotonic()
    wall_paused_s = 0.0
    line.speed = None
    pacer.begin(command.speed, simulation.time_us, wall_progress_s)

    def tell(wall_s: float) -> None:
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

    def stand() -> None:
        nonlocal wall_paused_s
        simulation.settle()
        wall_begin_s, before_s = time.monotonic(), wall_paused_s

        def look() -> None:
            nonlocal wall_paused_s
            wall_s = time.monotonic()
            wall_paused_s = before_s + wall_s - wall_begin_s
            tell(wall_s)

        while line.paused and line.empty():
            look()
            line.wait(PROGRESS_PERIOD_S)
        pacer.stand()
        look()

    def interrupted() -> bool:
        idle = line.empty()
        if line.paused and idle:
            stand()
            idle = line.empty()
        if line.speed is not None:
            pacer.begin(line.speed, simulation.time_us, time.monotonic())
            line.speed = None
        return not idle

    def keep_pace() -> None:
        wall_s = time.monotonic()
        ahead_s = pacer.ahead_s(simulation.time_us, wall_s)
        if wall_s - wall_progress_s >= PROGRESS_PERIOD_S:
            tell(wall_s)
        if 0.0 < ahead_s <= NAP_S:
            time.sleep(ahead_s)
        elif ahead_s > NAP_S:
            wait(wall_s + ahead_s)

    def wait(wall_until_s: float) -> None:
        """Wait long, so that the air, the launcher and its user do not have to."""
        simulation.settle()
        while line.quiet and (wall_s := time.monotonic()) < wall_until_s:
            if wall_s - wall_progress_s >= PROGRESS_PERIOD_S:
                tell(wall_s)
            line.wait(min(wall_until_s - wall_s, PROGRESS_PERIOD_S))

    paused = run(simulation, command, interrupted=interrupted, on_step=keep_pace)
    return msgspec.structs.replace(paused, wall_paused_s=wall_paused_s)


def serve(
    config: PhysicsConfig,
    listeners: list[socket.socket],
    own_listener: socket.socket | None,
    clock: socket.socket | None,
    radio_endpoint: str | None,
) -> None:
    """Do as commanded until Stop; ``clock`` leads to the 802.11 emulator, if there is one.

    Raises ConnectTimeout or RadioSilent, or OSError for what it cannot open or reach.
    """
    inbox: queue.SimpleQueue[AnyCommand] = queue.SimpleQueue()
    commands(AnyCommand, inbox)  # type: ignore[arg-type]  # a union is a type to msgspec
    scenario = config.scenario
    patience = ResponseWatchdog(scenario.run.silence_limit_s)
    manners = [PX4 if scenario.autopilot.is_px4(i) else OWN for i in range(scenario.agents)]
    has_px4 = PX4 in manners

    met: list[Lockstep] = []

    def meet(simulation: Simulation) -> Lockstep:
        lockstep = Lockstep(
            listeners,
            own_listener=own_listener,
            patience=patience,
            on_message=simulation.on_message,
            on_silent=simulation.on_silent,
            on_lost=simulation.on_lost,
            manners=manners,
        )
        met.append(lockstep)
        return lockstep

    with contextlib.ExitStack() as stack:
        air = None
        if clock is not None:
            line = time_masters_end(stack.enter_context(clock))
            # applications beside PX4s are in no lockstep, so their radios are as unforeseeable as guests'
            free = bool(scenario.radio.guests) or has_px4
            air = EmulatorClient(line, period_us=scenario.onboard.loop_period_us, free=free)
        simulation = stack.enter_context(
            contextlib.closing(Simulation(config, meet=meet, air=air, emit=emit))
        )
        if has_px4 and radio_endpoint is not None:
            from harness.simulator.application_reports import overheard  # noqa: PLC0415  see there

            stack.enter_context(overheard(radio_endpoint, config.run_id, met[0]))
        emit(Ready(name="physics", pid=os.getpid()))
        with profiled(
            PROFILE_GROUPS, now_us=lambda: simulation.time_us, from_us=config.profile_from_us
        ) as profile:
            obey(
                simulation,
                inbox,
                connect_timeout_s=config.connect_timeout_s,
                emit=emit,
                set_pid=patience.set_pid,
            )
    details: dict[str, Any] = {"time_us": simulation.time_us, "formed": simulation.formed, **profile}
    if has_px4:
        details["late_answers"] = {f"uav {i}": count for i, count in met[0].late_answers.items()}
    emit(Finished(name="physics", details=details))


def main() -> int:
    """Parse the command line and serve; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m harness.simulator.server", description="The physics server of one run."
    )
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the server's settings")
    parser.add_argument(
        "--listen-fds", required=True, help="inherited listening TCP sockets, one per vehicle: 5,6,7"
    )
    parser.add_argument(
        "--own-listen-fd", type=int, help="inherited listening Unix socket, for all vehicles but PX4s"
    )
    parser.add_argument(
        "--clock-fd",
        type=int,
        help="inherited stream socket to the 802.11 emulator; none flies without a radio",
    )
    parser.add_argument(
        "--radio-endpoint", help="the emulator's Zenoh locator, where applications beside PX4s are heard"
    )
    parser.add_argument(
        "--supervised", action="store_true", help="accepted for likeness: this server always is"
    )
    arguments = parser.parse_args()
    try:
        config = msgspec.json.decode(arguments.config.read_bytes(), type=PhysicsConfig)
        listeners = [socket.socket(fileno=int(fd)) for fd in arguments.listen_fds.split(",")]
        own_listener, clock = (
            None if fd is None else socket.socket(fileno=fd)
            for fd in (arguments.own_listen_fd, arguments.clock_fd)
        )
        serve(config, listeners, own_listener, clock, arguments.radio_endpoint)
    except (ConnectTimeout, RadioSilent, OSError, ValueError) as error:
        print(f"physics: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
