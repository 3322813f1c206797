"""The physics server's process: master of simulated time.

``python -m harness.physics_server`` owns the world, the wind and the sensors, meets the vehicles in
lockstep, tells the 802.11 emulator how far the air may go, and writes the truth down. It runs on command
(`harness.messages`).
"""

import argparse
import contextlib
import os
import queue
import socket
import sys
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Message
from autopilot.mavlink.modes import mode_from_custom
from autopilot.onboard.phases import Phase
from harness.hil import SensorEncoder, controls
from harness.lockstep import ConnectTimeout, Lockstep
from harness.messages import (
    AnyCommand,
    AnyEvent,
    Collision,
    Formed,
    Paused,
    Progress,
    RunUntil,
    SetAttenuation,
    SetPid,
    VehicleLost,
    VehicleSilent,
    VehicleTruth,
)
from harness.patience import Patience
from harness.physics.model import IRIS
from harness.physics.truth import Truth
from harness.physics.world import World
from harness.recording import AIR_RECORD, EVENT_KINDS, TRUTH_RECORD
from harness.run_folder import PhysicsConfig
from harness.sensors.suite import SensorSuite
from harness.wind import GustyWind
from netsim.child import Finished, Ready, Stop, commands, emit
from netsim.radio import ANSWER_LIMIT_S, BATCH_HANDED_OVER, advance_key
from netsim.record_log import RecordLog
from netsim.transport import Pending, Transport, TransportError
from netsim.wire.messages import Advance, Advanced, decode, encode

STREAM = 250
"""Sets the physics' random streams apart from those of the run's other processes."""
PROGRESS_PERIOD_S = 0.2
COMPONENT_AUTOPILOT = 1
COMPONENT_ONBOARD = 191


class RadioSilent(ConnectionError):
    """The 802.11 emulator does not answer the time master."""


class Air:
    """The time master's side of the emulated channel.

    Asks it to go on, and only when it has something to do.
    """

    def __init__(self, transport: Transport, run_id: str) -> None:
        self._asker = transport.asker(advance_key(run_id), timeout_s=ANSWER_LIMIT_S)
        self._pending: Pending | None = None
        self._quiet_until_us = 0
        self._handed_over = True
        self.extra_attenuation_db: float | None = None
        self.busy_ns = 0

    def begin(self, time_us: int, step_us: int, truth: Truth, silent: tuple[int, ...]) -> None:
        """Let the emulator simulate up to ``time_us`` beside the vehicles.

        Unless the air stays quiet until then.
        """
        if not self._handed_over and time_us < self._quiet_until_us:
            return
        self._handed_over = False
        request = Advance(
            to_us=time_us,
            release_us=time_us + step_us,
            pos_ned_m=_rows(truth.pos_ned_m),
            vel_ned_m_s=_rows(truth.vel_ned_m_s),
            q_ned_frd=_rows(truth.q_ned_frd),
            silent=silent,
            extra_attenuation_db=self.extra_attenuation_db,
        )
        self._pending = self._asker.ask(encode(request))

    def end(self) -> tuple[int, ...]:
        """Wait until the emulator is through and its deliveries are in the vehicles' hands.

        Returns the vehicles that did not take theirs. Raises RadioSilent.
        """
        if self._pending is None:
            return ()
        answer = self._pending.answer()
        self._pending = None
        advanced = decode(Advanced, answer) if answer is not None else None
        if advanced is None:
            raise RadioSilent("the 802.11 emulator does not answer")
        self._quiet_until_us = advanced.quiet_until_us
        self.busy_ns = advanced.busy_ns
        return advanced.unresponsive

    def handed_over(self) -> None:
        """A vehicle gave its radio something to send: the next interval is not quiet."""
        self._handed_over = True


def _rows(array: NDArray[np.float64]) -> Any:  # noqa: ANN401  as many components as the message wants
    return tuple(map(tuple, array.tolist()))


class Simulation:
    """World, wind, sensors, vehicles and air, stepped together."""

    def __init__(self, config: PhysicsConfig, listeners: list[socket.socket], air: Air | None) -> None:
        scenario = config.scenario
        self._scenario = scenario
        self._air = air
        self._step_us = scenario.run.step_us
        n = scenario.agents
        streams = np.random.SeedSequence([scenario.run.seed, STREAM]).spawn(2)
        self._places_ned_m = scenario.places_ned_m()
        spawn_ned_m = self._places_ned_m.copy()  # on the ground below the places
        spawn_ned_m[:, 2] = -IRIS.standing_height_m
        self._world = World(
            model=IRIS,
            spawn_pos_ned_m=spawn_ned_m,
            spawn_yaw_rad=float(np.radians(scenario.formation.heading_deg)),
            step_us=self._step_us,
        )
        self._wind = GustyWind(scenario.wind, n, np.random.default_rng(streams[0]))
        self._sensors = SensorSuite(
            config=scenario.sensors, site=scenario.site, vehicles=n, step_us=self._step_us, seed=streams[1]
        )
        self._encoders = [SensorEncoder() for _ in range(n)]
        self.patience = Patience(scenario.run.silence_limit_s)
        self.lockstep = Lockstep(
            listeners,
            patience=self.patience,
            on_message=self._on_message,
            on_silent=lambda i, s: self._emit(
                VehicleSilent(time_us=self.time_us, instance=i, wall_silence_s=s)
            ),
            on_lost=lambda i, reason: self._emit(
                VehicleLost(time_us=self.time_us, instance=i, reason=reason)
            ),
        )
        self._truth_log = RecordLog(config.truth_log_path, TRUTH_RECORD)
        self._air_log = RecordLog(config.air_log_path, AIR_RECORD)
        self._event_log = Path(config.event_log_path).open("wb", buffering=0)  # noqa: SIM115 - closed by close()
        self.time_us = self._step_us  # PX4 takes 0 for a clock that is not set
        self.formed = False
        self._controls = np.zeros((n, 4))
        self._armed = np.zeros(n, dtype=bool)
        self._stopped = np.zeros(n, dtype=bool)
        self._wind_ned_n = np.zeros((n, 3))
        self._modes = [""] * n
        self._phases: list[Phase | None] = [None] * n
        self._touching: set[tuple[int, int]] = set()

    @property
    def any_alive(self) -> bool:
        """Whether any vehicle is still in the run."""
        return any(seat.alive for seat in self.lockstep.seats)

    @property
    def must_end(self) -> bool:
        """Whether a vehicle has been lost in a scenario that ends for it."""
        return self._scenario.run.on_vehicle_loss == "end" and not all(
            seat.alive for seat in self.lockstep.seats
        )

    def step(self) -> None:
        """One step: sensors of this instant out, answers in, world and wind on to the next instant."""
        truth = self._world.truth
        alive = [seat.alive for seat in self.lockstep.seats]
        frame = self._sensors.sample(self.time_us, truth)
        if self._air is not None:
            self._air.begin(
                self.time_us, self._step_us, truth, tuple(i for i, a in enumerate(alive) if not a)
            )
        if self.time_us % self._scenario.record_period_us == 0:
            self._record(truth, alive)
        answers = self.lockstep.exchange(
            self.time_us,
            [
                encoder.encode(i, self.time_us, frame) if alive[i] else None
                for i, encoder in enumerate(self._encoders)
            ],
        )
        if self._air is not None:
            for i in self._air.end():
                self.lockstep.lose(i, "it does not take what its radio delivers")
        for i, answer in enumerate(answers):
            if answer is None:
                self._stopped[i] = not self.lockstep.seats[i].alive
                continue
            self._controls[i], self._armed[i] = controls(answer, self._controls.shape[1])
            if self._air is not None and answer.flags & BATCH_HANDED_OVER:
                self._air.handed_over()
        self._wind_ned_n = self._wind.step(self._step_us * 1e-6)
        self._world.step(self._controls, self._armed, self._wind_ned_n, rotors_stopped=self._stopped)
        self.time_us += self._step_us
        self._notice()

    def vehicles(self) -> tuple[VehicleTruth, ...]:
        """Everyone as they are now."""
        truth = self._world.truth
        error_m = np.linalg.norm((truth.pos_ned_m - self._places_ned_m)[:, :2], axis=1)
        return tuple(
            VehicleTruth(
                alive=seat.alive,
                armed=bool(self._armed[i]),
                mode=self._modes[i],
                phase=_name(self._phases[i]),
                pos_ned_m=tuple(truth.pos_ned_m[i].tolist()),
                vel_ned_m_s=tuple(truth.vel_ned_m_s[i].tolist()),
                q_ned_frd=tuple(truth.q_ned_frd[i].tolist()),
                error_m=float(error_m[i]),
            )
            for i, seat in enumerate(self.lockstep.seats)
        )

    @property
    def busy_fraction(self) -> float:
        """Part of the simulated time for which the channel was occupied."""
        return self._air.busy_ns / (self.time_us * 1e3) if self._air is not None and self.time_us else 0.0

    def close(self) -> None:
        """End connections, world and logs; harmless when repeated."""
        self.lockstep.close()
        self._world.close()
        self._truth_log.close()
        self._air_log.close()
        self._event_log.close()

    def _record(self, truth: Truth, alive: list[bool]) -> None:
        self._truth_log.append(
            zip(
                [self.time_us] * len(alive),
                range(len(alive)),
                alive,
                self._armed,
                truth.pos_ned_m,
                truth.vel_ned_m_s,
                truth.q_ned_frd,
                truth.omega_frd_rad_s,
                self._wind_ned_n,
                truth.rotor_speed_rad_s,
                strict=True,
            )
        )
        if self._air is not None:
            self._air_log.append([(self.time_us, self._air.busy_ns)])

    def _notice(self) -> None:
        """Report collisions when they begin, and the formation when it is reached for the first time."""
        contacts = {(contact.first, contact.second): contact for contact in self._world.vehicle_contacts}
        for pair in sorted(contacts.keys() - self._touching):
            first, second = pair
            where_ned_m = contacts[pair].pos_ned_m
            self._emit(Collision(time_us=self.time_us, first=first, second=second, pos_ned_m=where_ned_m))
        self._touching = set(contacts)
        if not self.formed:
            phases = [p for p, seat in zip(self._phases, self.lockstep.seats, strict=True) if seat.alive]
            if phases and all(phase == Phase.ON_STATION for phase in phases):
                self.formed = True
                self._emit(Formed(time_us=self.time_us))

    def _on_message(self, instance: int, message: Message) -> None:
        if message.get_msgId() != mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return
        if message.get_srcComponent() == COMPONENT_AUTOPILOT:
            mode = mode_from_custom(message.custom_mode)
            self._modes[instance] = "" if mode is None else mode.label
        elif message.get_srcComponent() == COMPONENT_ONBOARD:
            with contextlib.suppress(ValueError):
                self._phases[instance] = Phase(message.custom_mode)

    def _emit(self, event: AnyEvent) -> None:
        line = msgspec.json.encode(event)
        if type(event).__name__.lower() in EVENT_KINDS:
            self._event_log.write(line + b"\n")
        emit(event)


def _name(phase: Phase | None) -> str:
    return "" if phase is None else phase.name.lower().replace("_", " ")


def _run(simulation: Simulation, command: RunUntil, inbox: "queue.SimpleQueue[AnyCommand]") -> Paused:
    """Step until the command is done, or until another command comes in (which is left for the caller)."""
    wall_start_s, start_us = time.monotonic(), simulation.time_us
    wall_progress_s = wall_start_s
    reason = "time"
    while simulation.time_us < command.time_us:
        if not simulation.any_alive:
            reason = "no_vehicles"
            break
        if not inbox.empty():
            reason = "command"
            break
        simulation.step()
        if simulation.must_end:
            reason = "vehicle_lost"
            break
        if command.stop_when_formed and simulation.formed:
            reason = "formed"
            break
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
    return Paused(time_us=simulation.time_us, reason=reason, vehicles=simulation.vehicles())


def serve(config: PhysicsConfig, listeners: list[socket.socket], radio_endpoint: str | None) -> None:
    """Do as commanded until Stop. Raises ConnectTimeout, RadioSilent or TransportError."""
    inbox: queue.SimpleQueue[AnyCommand] = queue.SimpleQueue()
    commands(AnyCommand, inbox)  # type: ignore[arg-type]  # a union is a type to msgspec
    with contextlib.ExitStack() as stack:
        air = None
        if radio_endpoint is not None:
            transport = stack.enter_context(contextlib.closing(Transport.connect(radio_endpoint)))
            air = Air(transport, config.run_id)
        simulation = stack.enter_context(contextlib.closing(Simulation(config, listeners, air)))
        emit(Ready(name="physics", pid=os.getpid()))
        stopped = False
        connected = False
        while not stopped:
            match inbox.get():
                case RunUntil() as command:
                    if not connected:
                        simulation.lockstep.connect(config.connect_timeout_s, keep_waiting=inbox.empty)
                        connected = True
                    emit(_run(simulation, command, inbox))
                case SetAttenuation(extra_attenuation_db=attenuation_db):
                    if air is not None:
                        air.extra_attenuation_db = attenuation_db
                case SetPid(instance=instance, pid=pid):
                    simulation.patience.set_pid(instance, pid)
                case Stop():
                    stopped = True
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
