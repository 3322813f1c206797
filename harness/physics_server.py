"""The physics server's process: `harness.simulation` between the vehicles' sockets and the emulator's.

``python -m harness.physics_server`` runs on command (`harness.messages`), and at the speed asked for.
"""

import argparse
import contextlib
import os
import queue
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from harness.air import Air, RadioSilent
from harness.lockstep import ConnectTimeout, Lockstep
from harness.messages import (
    AnyCommand,
    AnyEvent,
    InjectFault,
    Paused,
    Progress,
    RunUntil,
    SetAttenuation,
    SetPid,
)
from harness.patience import Patience
from harness.run_folder import PhysicsConfig
from harness.simulation import Simulation, run
from netsim.child import Finished, Ready, Stop, commands, emit
from netsim.transport import Transport, TransportError

PROGRESS_PERIOD_S = 0.2


def obey(
    simulation: Simulation,
    inbox: "queue.SimpleQueue[AnyCommand]",
    *,
    connect_timeout_s: float,
    emit: Callable[[AnyEvent], None],
    set_pid: Callable[[int | None, int], None] = lambda _instance, _pid: None,
) -> None:
    """Do as commanded until Stop; ``set_pid`` is told which processes are whose.

    Raises what the simulation's vehicles and its air raise.
    """
    connected = False
    while True:
        match inbox.get():
            case RunUntil() as command:
                if not connected:
                    simulation.lockstep.connect(connect_timeout_s, keep_waiting=inbox.empty)
                    connected = simulation.lockstep.living == len(simulation.lockstep.seats)
                if connected:
                    emit(_run(simulation, command, inbox, emit))
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
    inbox: "queue.SimpleQueue[AnyCommand]",
    emit: Callable[[AnyEvent], None],
) -> Paused:
    """Step until the command is done, or until another command comes in (which is left for the caller)."""
    wall_start_s, start_us = time.monotonic(), simulation.time_us
    wall_progress_s = wall_start_s

    def keep_pace() -> None:
        nonlocal wall_progress_s
        wall_s = time.monotonic()
        if command.speed > 0.0:
            ahead_s = (simulation.time_us - start_us) * 1e-6 / command.speed - (wall_s - wall_start_s)
            if ahead_s > 0.0:
                time.sleep(ahead_s)
        if wall_s - wall_progress_s >= PROGRESS_PERIOD_S:
            wall_progress_s = wall_s
            emit(
                Progress(
                    time_us=simulation.time_us,
                    wall_s=wall_s,
                    channel_busy_fraction=simulation.busy_fraction,
                    vehicles=simulation.vehicles(),
                )
            )

    return run(simulation, command, interrupted=lambda: not inbox.empty(), on_step=keep_pace)


def serve(config: PhysicsConfig, listeners: list[socket.socket], radio_endpoint: str | None) -> None:
    """Do as commanded until Stop. Raises ConnectTimeout, RadioSilent or TransportError."""
    inbox: queue.SimpleQueue[AnyCommand] = queue.SimpleQueue()
    commands(AnyCommand, inbox)  # type: ignore[arg-type]  # a union is a type to msgspec
    patience = Patience(config.scenario.run.silence_limit_s)

    def meet(simulation: Simulation) -> Lockstep:
        return Lockstep(
            listeners,
            patience=patience,
            on_message=simulation.on_message,
            on_silent=simulation.on_silent,
            on_lost=simulation.on_lost,
        )

    with contextlib.ExitStack() as stack:
        air = None
        if radio_endpoint is not None:
            transport = stack.enter_context(contextlib.closing(Transport.connect(radio_endpoint)))
            air = Air(transport, config.run_id, guests=bool(config.scenario.radio.guests))
        simulation = stack.enter_context(
            contextlib.closing(Simulation(config, meet=meet, air=air, emit=emit))
        )
        emit(Ready(name="physics", pid=os.getpid()))
        obey(
            simulation,
            inbox,
            connect_timeout_s=config.connect_timeout_s,
            emit=emit,
            set_pid=patience.set_pid,
        )
    emit(Finished(name="physics", details={"time_us": simulation.time_us, "formed": simulation.formed}))


def main() -> int:
    """Parse the command line and serve; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m harness.physics_server", description="The physics server of one run."
    )
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the server's settings")
    parser.add_argument(
        "--listen-fds", required=True, help="inherited listening TCP sockets, one per vehicle: 5,6,7"
    )
    parser.add_argument(
        "--radio-endpoint", help="Zenoh locator of the 802.11 emulator; none flies without a radio"
    )
    parser.add_argument(
        "--supervised", action="store_true", help="accepted for likeness: this server always is"
    )
    arguments = parser.parse_args()
    try:
        config = msgspec.json.decode(arguments.config.read_bytes(), type=PhysicsConfig)
        listeners = [socket.socket(fileno=int(fd)) for fd in arguments.listen_fds.split(",")]
        serve(config, listeners, arguments.radio_endpoint)
    except (ConnectTimeout, RadioSilent, TransportError, OSError, ValueError) as error:
        print(f"physics: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
