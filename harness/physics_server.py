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
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import HilActuatorControls
from autopilot.mavlink.modes import mode_from_custom
from autopilot.onboard.phases import Phase
from harness import esc
from harness.air import Air, RadioSilent
from harness.faults import AnyFault, Faults, kind
from harness.hil import SensorEncoder, is_armed
from harness.lockstep import ConnectTimeout, Lockstep
from harness.messages import (
    AnyCommand,
    AnyEvent,
    Collision,
    FaultChanged,
    Formed,
    InjectFault,
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
from harness.wind import Wind, WindNow
from netsim.child import Finished, Ready, Stop, commands, emit
from netsim.radio import BATCH_HANDED_OVER
from netsim.record_log import RecordLog
from netsim.transport import Transport, TransportError

STREAM = 250
"""Sets the physics' random streams apart from those of the run's other processes."""
PROGRESS_PERIOD_S = 0.2
ROTORS = 4
COMPONENT_AUTOPILOT = 1
COMPONENT_ONBOARD = 191


class Simulation:
    """World, wind, sensors, vehicles and air, stepped together."""

    def __init__(self, config: PhysicsConfig, listeners: list[socket.socket], air: Air | None) -> None:
        scenario = config.scenario
        self._scenario = scenario
        self._air = air
        self._step_us = scenario.run.step_us
        n = scenario.agents
        streams = np.random.SeedSequence([scenario.run.seed, STREAM]).spawn(3)
        self._places_ned_m = scenario.places_ned_m()
        spawn_ned_m = self._places_ned_m.copy()  # on the ground below the places
        spawn_ned_m[:, 2] = -IRIS.standing_height_m
        self._world = World(
            model=IRIS,
            spawn_pos_ned_m=spawn_ned_m,
            spawn_yaw_rad=float(np.radians(scenario.formation.heading_deg)),
            step_us=self._step_us,
            environment=scenario.environment,
            ground_altitude_m=scenario.site.altitude_m,
        )
        self._wind = Wind(
            scenario.wind,
            n,
            np.random.default_rng(streams[0]),
            formation_height_m=scenario.formation.height_m,
        )
        self._sensors = SensorSuite(
            config=scenario.sensors,
            site=scenario.site,
            vehicles=n,
            step_us=self._step_us,
            seed=streams[1],
            temperature_offset_k=scenario.environment.temperature_offset_k,
        )
        self._faults = Faults(scenario.faults, n, np.random.default_rng(streams[2]))
        self._encoder = SensorEncoder()
        self.patience = Patience(scenario.run.silence_limit_s)
        self.lockstep = Lockstep(
            listeners,
            patience=self.patience,
            on_message=self._on_message,
            on_silent=lambda i, s: self._emit(
                VehicleSilent(time_us=self.time_us, instance=i, wall_silence_s=s)
            ),
            on_lost=self._on_lost,
        )
        self._truth_log = RecordLog(config.truth_log_path, TRUTH_RECORD)
        self._air_log = RecordLog(config.air_log_path, AIR_RECORD)
        self._event_log = Path(config.event_log_path).open("wb", buffering=0)  # noqa: SIM115 - closed by close()
        self.time_us = self._step_us  # PX4 takes 0 for a clock that is not set
        self.formed = False
        self._controls: list[Sequence[float]] = [[0.0] * ROTORS for _ in range(n)]
        self._armed = [False] * n
        self._stopped = np.zeros(n, dtype=bool)
        self._wind_now = WindNow(np.zeros((n, 3)), np.zeros((n, 3)))
        self._modes = [""] * n
        self._phases: list[Phase | None] = [None] * n
        self._phase_news = False
        """Whether the formation may have been reached since it was last looked at."""
        self._touching: set[tuple[int, int]] = set()

    @property
    def any_alive(self) -> bool:
        """Whether any vehicle is still in the run."""
        return self.lockstep.living > 0

    @property
    def must_end(self) -> bool:
        """Whether a vehicle has been lost in a scenario that ends for it."""
        return self._scenario.run.on_vehicle_loss == "end" and self.lockstep.living < self._scenario.agents

    def step(self) -> None:
        """One step: sensors of this instant out, answers in, air, world and wind on to the next instant.

        What needs no answer is done between the two, beside the vehicles: they idle while the rest is done.
        The air goes on beside world and vehicles; its deliveries have to be there by the next answers.
        """
        truth = self._world.truth
        alive = [seat.alive for seat in self.lockstep.seats]
        self._advance_faults()
        frame = self._sensors.sample(self.time_us, truth, self._faults)
        self.lockstep.send(self._encoder.encode(self.time_us, frame, self._escs(truth)))
        recorded = self.time_us % self._scenario.record_period_us == 0
        if recorded:
            self._record(truth, alive)
        self.notice_collisions()
        self._wind_now = self._wind.step(
            self._step_us * 1e-6, time_us=self.time_us, height_m=-truth.pos_ned_m[:, 2]
        )
        self._sensors.look_ahead()
        answers = self.lockstep.answers(self.time_us)
        self.settle()
        self._obey(answers)
        if self._air is not None:
            if recorded:
                self._air_log.append([(self.time_us, self._air.busy_ns)])
            self._air.begin(self.time_us, self._step_us, truth, self._gone())
        stopped = self._faults.rotor_stopped
        self._world.step(
            np.array(self._controls),
            np.array(self._armed),
            self._wind_now.force_ned_n,
            rotors_stopped=self._stopped if stopped is None else stopped | self._stopped[:, None],
            air_vel_ned_m_s=self._wind_now.air_vel_ned_m_s,
            rotor_effectiveness=self._faults.rotor_effectiveness,
        )
        self.time_us += self._step_us
        if self._phase_news:
            self._notice_formation()

    def inject(self, fault: AnyFault) -> None:
        """Have a fault begin its ``start_s`` after the next step. Raises ValueError for a wrong vehicle."""
        self._faults.add(fault, self.time_us)

    def _advance_faults(self) -> None:
        """Bring the faults to this step, and report which end and begin."""
        for change in self._faults.advance(self.time_us):
            self._emit(
                FaultChanged(
                    time_us=self.time_us,
                    number=change.number,
                    instance=None if change.fault.uav == "all" else change.fault.uav,
                    what=kind(change.fault),
                    motor=change.motor,
                    change="began" if change.began else "ended",
                )
            )

    def _escs(self, truth: Truth) -> esc.EscReadings | None:
        """What the motors' controllers report, when it is time."""
        if self.time_us % esc.PERIOD_US >= self._step_us:
            return None
        return esc.readings(
            truth.rotor_speed_rad_s, self._faults.rotor_effectiveness, self._world.density_ratio
        )

    def settle(self) -> None:
        """Wait until the air is through with what it was let do, and every vehicle has its deliveries."""
        if self._air is not None:
            waited_for = self._air.end()
            while waited_for:
                self.lockstep.judge(waited_for)
                waited_for = self._air.wait_on(self._gone())

    def _gone(self) -> tuple[int, ...]:
        return tuple(seat.instance for seat in self.lockstep.seats if not seat.alive)

    def _obey(self, answers: list[HilActuatorControls | None]) -> None:
        """Set motors as the vehicles say; the world limits what is out of range."""
        flags = 0
        for i, answer in enumerate(answers):
            if answer is None:
                self._stopped[i] = not self.lockstep.seats[i].alive
                continue
            self._controls[i], self._armed[i] = answer.controls[:ROTORS], is_armed(answer)
            flags |= answer.flags
        if self._air is not None and flags & BATCH_HANDED_OVER:
            self._air.handed_over()

    def vehicles(self) -> tuple[VehicleTruth, ...]:
        """Everyone as they are now."""
        truth = self._world.truth
        error_m = np.linalg.norm((truth.pos_ned_m - self._places_ned_m)[:, :2], axis=1)
        return tuple(
            VehicleTruth(
                alive=seat.alive,
                armed=self._armed[i],
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
                self._wind_now.force_ned_n,
                self._wind_now.air_vel_ned_m_s,
                truth.rotor_speed_rad_s,
                strict=True,
            )
        )

    def notice_collisions(self) -> None:
        """Report collisions of the last step that have just begun; harmless when repeated."""
        touching = self._world.vehicle_contacts
        if not touching and not self._touching:
            return
        contacts = {(contact.first, contact.second): contact for contact in touching}
        for pair in sorted(contacts.keys() - self._touching):
            first, second = pair
            where_ned_m = contacts[pair].pos_ned_m
            self._emit(Collision(time_us=self.time_us, first=first, second=second, pos_ned_m=where_ned_m))
        self._touching = set(contacts)

    def _notice_formation(self) -> None:
        """Report the formation when it is reached for the first time."""
        self._phase_news = False
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
                self._phase_news = True

    def _on_lost(self, instance: int, reason: str) -> None:
        self._phase_news = True  # the others may be all there
        self._emit(VehicleLost(time_us=self.time_us, instance=instance, reason=reason))

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
    simulation.settle()
    simulation.notice_collisions()
    return Paused(time_us=simulation.time_us, reason=reason, vehicles=simulation.vehicles())


def serve(config: PhysicsConfig, listeners: list[socket.socket], radio_endpoint: str | None) -> None:
    """Do as commanded until Stop. Raises ConnectTimeout, RadioSilent or TransportError."""
    inbox: queue.SimpleQueue[AnyCommand] = queue.SimpleQueue()
    commands(AnyCommand, inbox)  # type: ignore[arg-type]  # a union is a type to msgspec
    with contextlib.ExitStack() as stack:
        air = None
        if radio_endpoint is not None:
            transport = stack.enter_context(contextlib.closing(Transport.connect(radio_endpoint)))
            air = Air(transport, config.run_id, guests=bool(config.scenario.radio.guests))
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
                case InjectFault(fault=fault):
                    simulation.inject(fault)
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
