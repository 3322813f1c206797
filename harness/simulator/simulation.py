"""The physics server's core: master of simulated time, whoever its vehicles and its air are.

Owns the world, the wind and the sensors, meets the vehicles in lockstep, tells the air how far it may go, and
writes the truth down. How vehicles and air are reached is their own: over sockets
(`harness.simulator.server`) or in this process (`harness.launch.one_process`). Knows no wall clock.
"""

import contextlib
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Message
from autopilot.mavlink.components import APPLICATION_COMPONENT, AUTOPILOT_COMPONENT
from autopilot.mavlink.modes import mode_from_custom
from autopilot.onboard.formation.motion import STAYS_AWAY
from autopilot.onboard.formation.phases import FlightPhase
from foundation.records.record_log import RecordLog
from harness.records.run_folder import PhysicsConfig
from harness.simulator.actuator_inbox import ActuatorInbox
from harness.simulator.hil import TRUTH_PERIOD_US, SensorEncoder
from harness.simulator.interfaces import ChannelInterface, Vehicles
from harness.simulator.messages import (
    AnyEvent,
    Collision,
    FaultChanged,
    FormationMoves,
    Formed,
    Paused,
    RunUntil,
    VehicleLost,
    VehicleSilent,
    VehicleTruth,
)
from harness.simulator.motion_start import START_NAME, agreed, start_us
from harness.simulator.truth_record import AIR_RECORD, EVENT_KINDS, TRUTH_RECORD
from harness.world import esc
from harness.world.faults import MOST_ATTENUATION_DB, AnyFault, Faults, kind
from harness.world.physics.interface import Physics
from harness.world.physics.model import IRIS
from harness.world.physics.truth import Truth
from harness.world.physics.world import World
from harness.world.sensors.suite import SensorSuite
from harness.world.wind import Wind, WindNow

STREAM = 250
"""Sets the physics' random streams apart from those of the run's other processes."""
_RECORDED_OF_TRUTH = ("pos_ned_m", "vel_ned_m_s", "q_ned_frd", "omega_frd_rad_s", "rotor_speed_rad_s")


class Simulation:
    """World, wind, sensors, vehicles and air, stepped together.

    ``meet`` makes the rendezvous with the vehicles, which tells this one's `on_message`, `on_silent` and
    `on_lost` of them. ``emit`` is given what happens. Raises OSError for a log.
    """

    def __init__(
        self,
        config: PhysicsConfig,
        *,
        meet: Callable[["Simulation"], Vehicles],
        air: ChannelInterface | None,
        emit: Callable[[AnyEvent], None],
    ) -> None:
        scenario = config.scenario
        self._scenario = scenario
        self._air = air
        self._tell = emit
        self._step_us = scenario.run.step_us
        self._record_period_us = self._air_record_us = scenario.record_period_us
        n = scenario.agents
        streams = np.random.SeedSequence([scenario.run.seed, STREAM]).spawn(3)
        self._plan = scenario.plan()
        spawn_ned_m = scenario.places_ned_m()  # on the ground below the places
        spawn_ned_m[:, 2] = -IRIS.standing_height_m
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
        px4 = frozenset(filter(scenario.autopilot.is_px4, range(n)))
        self._encoder = SensorEncoder(
            scenario.site, px4=px4, epoch_us=scenario.run.epoch_unix_us, px4_rc=scenario.autopilot.px4_rc
        )
        self._has_escs = len(px4) < n
        self._tells_truth = scenario.onboard.enabled and scenario.onboard.localisation == "truth"
        self.time_us = self._step_us  # PX4 takes 0 for a clock that is not set
        self.formed = False
        self._answers = ActuatorInbox(n)
        self._wind_now = WindNow(np.zeros((n, 3)), np.zeros((n, 3)))
        self._gone: tuple[int, ...] = ()
        """Vehicles that were lost."""
        self._instances = np.arange(n)
        self._modes = [""] * n
        self._phases: list[FlightPhase | None] = [None] * n
        self._starts_us: list[int | None] = [None] * n
        self._start_us: int | None = None
        """Start of the formation's motion: as each vehicle says, and as they agree."""
        self._phase_news = False
        """Whether the formation may have been reached, or its start agreed, since it was last looked at."""
        self._touching: set[tuple[int, int]] = set()
        self._attenuation_db: float | None = None
        """On every radio link, as commanded; None is the scenario's."""
        with contextlib.ExitStack() as stack:  # nothing stays open if anything of it fails
            keep = stack.enter_context
            self._world: Physics = keep(
                World(
                    model=IRIS,
                    spawn_pos_ned_m=spawn_ned_m,
                    spawn_yaw_rad=float(np.radians(scenario.formation.heading_deg)),
                    step_us=self._step_us,
                    environment=scenario.environment,
                    ground_altitude_m=scenario.site.altitude_m,
                )
            )
            self._truth_log = keep(contextlib.closing(RecordLog(config.truth_log_path, TRUTH_RECORD)))
            self._air_log = keep(contextlib.closing(RecordLog(config.air_log_path, AIR_RECORD)))
            self._event_log = keep(Path(config.event_log_path).open("wb", buffering=0))  # noqa: SIM115
            self.lockstep = keep(contextlib.closing(meet(self)))
            self._open = stack.pop_all()

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
        The air goes on beside world and vehicles over an interval of several steps, and is waited for when
        what it delivers is to be told.
        """
        truth, air = self._world.truth, self._air
        recorded = self.time_us % self._record_period_us == 0
        self._advance_faults()
        frame = self._sensors.sample(self.time_us, truth, self._faults)
        told = truth if self._tells_truth and self.time_us % TRUTH_PERIOD_US < self._step_us else None
        delivered: tuple[int, ...] = ()
        if air is not None:
            if air.is_awaited(self.time_us):
                self.settle()
            delivered = air.delivered(self.time_us)
        alive = [seat.alive for seat in self.lockstep.seats] if recorded else []
        self.lockstep.send(self._encoder.encode(self.time_us, frame, self._escs(truth), told, delivered))
        if recorded:
            self._record(truth, alive)
        self.notice_collisions()
        self._wind_now = self._wind.step(
            self._step_us * 1e-6, time_us=self.time_us, height_m=-truth.pos_ned_m[:, 2]
        )
        self._sensors.begin_fast_steps()
        answers = self._answers = self.lockstep.answers(self.time_us)
        air_begins = air is not None and air.begins_at(self.time_us)
        if air_begins:
            self.settle()
        if self._gone:
            answers.armed[list(self._gone)] = False
        if air is not None and air_begins:
            if self.time_us >= self._air_record_us:
                period_us = self._record_period_us
                self._air_record_us = self.time_us - self.time_us % period_us + period_us
                self._air_log.append([(self.time_us, air.busy_ns)])
            air.begin(self.time_us, self._step_us, truth, senders=answers.senders, silent=self._gone)
        self._world.step(
            answers.controls,
            answers.armed,
            self._wind_now.force_ned_n,
            rotors_stopped=self._faults.rotor_stopped,
            air_vel_ned_m_s=self._wind_now.air_vel_ned_m_s,
            rotor_effectiveness=self._faults.rotor_effectiveness,
        )
        self.time_us += self._step_us
        if self._phase_news:
            self._notice_formation()
            self._notice_motion()

    def set_extra_attenuation_db(self, value: float | None) -> None:
        """From the air's next interval on, attenuate every radio link by this; None: as the scenario says."""
        self._attenuation_db = value
        self._spoil_air()

    def inject(self, fault: AnyFault) -> None:
        """Have a fault begin its ``start_s`` after the next step. Raises ValueError for a wrong vehicle."""
        self._faults.add(fault, self.time_us)

    def _advance_faults(self) -> None:
        """Bring the faults to this step, and report which end and begin."""
        changes = self._faults.advance(self.time_us)
        if changes:
            self._spoil_air()
        for change in changes:
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

    def _spoil_air(self) -> None:
        """Have the faults of the radio in force, on top of what was commanded."""
        air, fault_db = self._air, self._faults.extra_attenuation_db
        if air is None:
            return
        own_db = self._attenuation_db
        if fault_db is not None:
            own_db = self._scenario.radio.extra_attenuation_db if own_db is None else own_db
            own_db = min(own_db + fault_db, MOST_ATTENUATION_DB)
        air.extra_attenuation_db = own_db
        air.range_offsets_m = self._faults.range_offsets_m

    def _escs(self, truth: Truth) -> esc.EscReadings | None:
        """What the motors' controllers report, when it is time."""
        if self.time_us % esc.PERIOD_US >= self._step_us or not self._has_escs:
            return None
        return esc.readings(
            truth.rotor_speed_rad_s, self._faults.rotor_effectiveness, self._world.density_ratio
        )

    def settle(self) -> None:
        """Wait until the air is through with what it was let do."""
        if self._air is not None:
            waited_for = self._air.end()
            while waited_for:
                self.lockstep.judge(waited_for)
                waited_for = self._air.wait_on(self._gone)

    def vehicles(self) -> tuple[VehicleTruth, ...]:
        """Everyone as they are now."""
        truth = self._world.truth
        since_start_s = 0.0 if self._start_us is None else (self.time_us - self._start_us) * 1e-6
        places_ned_m = self._plan.at(since_start_s).pos_ned_m
        error_m = np.linalg.norm((truth.pos_ned_m - places_ned_m)[:, :2], axis=1)
        return tuple(
            VehicleTruth(
                alive=seat.alive,
                armed=bool(self._answers.armed[i]),
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
        """End connections, logs and world, each whatever becomes of the others; harmless when repeated."""
        self._open.close()

    def _record(self, truth: Truth, alive: list[bool]) -> None:
        rows = np.empty(len(alive), TRUTH_RECORD)
        rows["time_us"] = self.time_us
        rows["uav"] = self._instances
        rows["alive"] = alive
        rows["armed"] = self._answers.armed
        for name in _RECORDED_OF_TRUTH:
            rows[name] = truth.rows[name]
        rows["wind_force_ned_n"] = self._wind_now.force_ned_n
        rows["wind_vel_ned_m_s"] = self._wind_now.air_vel_ned_m_s
        self._truth_log.append_array(rows)

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
        """Report the formation when all who have not left it have reached it for the first time."""
        self._phase_news = False
        if not self.formed:
            phases = [
                phase
                for phase, seat in zip(self._phases, self.lockstep.seats, strict=True)
                if seat.alive and phase not in STAYS_AWAY
            ]
            if phases and all(phase == FlightPhase.ON_STATION for phase in phases):
                self.formed = True
                self._emit(Formed(time_us=self.time_us))

    def _notice_motion(self) -> None:
        """Report the start of the formation's motion that most of the living vehicles hold agreed."""
        starts_us = [s for s, seat in zip(self._starts_us, self.lockstep.seats, strict=True) if seat.alive]
        agreed_us = agreed(starts_us)
        if agreed_us is not None and agreed_us != self._start_us:
            self._start_us = agreed_us
            self._emit(FormationMoves(time_us=self.time_us, start_us=agreed_us))

    def on_message(self, instance: int, message: Message) -> None:
        """Take in what a vehicle said beside its answer."""
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_NAMED_VALUE_INT:
            if message.get_srcComponent() == APPLICATION_COMPONENT and message.name == START_NAME:
                self._starts_us[instance] = start_us(message.value)
                self._phase_news = True
            return
        if message.get_msgId() != mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return
        if message.get_srcComponent() == AUTOPILOT_COMPONENT:
            mode = mode_from_custom(message.custom_mode)
            self._modes[instance] = "" if mode is None else mode.label
        elif message.get_srcComponent() == APPLICATION_COMPONENT:
            with contextlib.suppress(ValueError):
                self._phases[instance] = FlightPhase(message.custom_mode)
                self._phase_news = True

    def on_silent(self, instance: int, wall_silence_s: float) -> None:
        """Report a vehicle that has not answered for a while."""
        self._emit(VehicleSilent(time_us=self.time_us, instance=instance, wall_silence_s=wall_silence_s))

    def on_lost(self, instance: int, reason: str) -> None:
        """Report a vehicle that has left for good."""
        self._gone += (instance,)
        self._phase_news = True  # the others may be all there
        self._emit(VehicleLost(time_us=self.time_us, instance=instance, reason=reason))

    def _emit(self, event: AnyEvent) -> None:
        line = msgspec.json.encode(event)
        if type(event).__name__.lower() in EVENT_KINDS:
            self._event_log.write(line + b"\n")
        self._tell(event)


def _name(phase: FlightPhase | None) -> str:
    return "" if phase is None else phase.name.lower().replace("_", " ")


def run(
    simulation: Simulation,
    command: RunUntil,
    *,
    interrupted: Callable[[], bool] = lambda: False,
    on_step: Callable[[], None] = lambda: None,
) -> Paused:
    """Step until the command is done, or can not be, or ``interrupted``; ``on_step`` is called after each."""
    reason = "time"
    while simulation.time_us < command.time_us:
        if not simulation.any_alive:
            reason = "no_vehicles"
            break
        if interrupted():
            reason = "command"
            break
        simulation.step()
        if simulation.must_end:
            reason = "vehicle_lost"
            break
        if command.stop_when_formed and simulation.formed:
            reason = "formed"
            break
        on_step()
    simulation.settle()
    simulation.notice_collisions()
    return Paused(time_us=simulation.time_us, reason=reason, vehicles=simulation.vehicles())
