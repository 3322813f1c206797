"""The physics server's core: the master of simulated time.

Owns the world, the wind and the sensors, steps the vehicles in lockstep, requests intervals of the radio
channel, and logs the truth. Vehicles and emulator are connected over sockets (`harness.simulator.server`) or
run in this process (`harness.launch.one_process`). Independent of the wall clock.
"""

import contextlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Message
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from foundation.processes.child_protocol import Warned
from foundation.records.record_log import RecordLog
from harness.records.run_folder import PhysicsConfig
from harness.simulator.actuator_inbox import ActuatorInbox
from harness.simulator.application_links import ApplicationLinks
from harness.simulator.ardupilot_json import StateEncoder
from harness.simulator.emulator_client import EmulatorClient
from harness.simulator.extra_readings import ExtraReadings
from harness.simulator.hil import TRUTH_PERIOD_US, SensorEncoder
from harness.simulator.lockstep import Lockstep
from harness.simulator.messages import (
    AnyEvent,
    Collision,
    FaultChanged,
    Paused,
    RunUntil,
    VehicleTruth,
)
from harness.simulator.truth_record import AIR_RECORD, EVENT_KINDS, truth_record
from harness.simulator.vehicle_reports import VehicleReports
from harness.world import esc
from harness.world.active_faults import MOST_ATTENUATION_DB, Faults
from harness.world.faults import AnyFault, title
from harness.world.interfaces import WorldInputs, inputs_of
from harness.world.obstacles import Obstacles
from harness.world.physics.interface import Physics, PhysicsFactory
from harness.world.physics.truth import Truth
from harness.world.physics.world import World
from harness.world.sensors.extra import ExtraSensors
from harness.world.sensors.suite import SensorFrame, SensorSuite
from harness.world.user_models import WorldModels
from harness.world.wind import Wind, WindNow

STREAM = 250
"""Part of the seed that separates the physics' random streams from those of the run's other processes."""
_RECORDED_OF_TRUTH = ("pos_ned_m", "vel_ned_m_s", "q_ned_frd", "omega_frd_rad_s")


class Simulation:
    """World, wind, sensors, vehicles and radio channel, stepped together.

    ``make_lockstep`` returns the vehicles' lockstep, which calls `on_message` of this object and methods of
    its `reports`; ``make_applications`` the links to applications beside other autopilots, which call those
    as well. ``emit`` receives the events. Raises OSError if a log cannot be written.
    """

    def __init__(
        self,
        config: PhysicsConfig,
        *,
        make_lockstep: Callable[["Simulation"], Lockstep],
        make_applications: Callable[["Simulation"], ApplicationLinks] | None = None,
        emulator: EmulatorClient | None,
        emit: Callable[[AnyEvent | Warned], None],
        physics: PhysicsFactory = World,
    ) -> None:
        scenario = config.scenario
        self._scenario = scenario
        self._emulator = emulator
        self._on_event = emit
        self._step_us = scenario.run.step_us
        self._record_period_us = self._air_record_us = scenario.record_period_us
        n = scenario.agents
        streams = np.random.SeedSequence([scenario.run.seed, STREAM]).spawn(3)
        self._plan = scenario.plan()
        spawn_ned_m = scenario.places_ned_m()  # on the ground below the formation
        airframes = scenario.airframes()
        spawn_ned_m[:, 2] = [-airframe.standing_height_m for airframe in airframes]
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
        self._rotors = rotors = [len(airframe.rotors) for airframe in airframes]
        models = WorldModels(
            seed=scenario.run.seed,
            stream=STREAM,
            airframes=airframes,
            site=scenario.site,
            obstacles=Obstacles(scenario.sensors.boxes),
            step_us=self._step_us,
        )
        self._faults = Faults(scenario.faults, rotors, np.random.default_rng(streams[2]), models.fault)
        extra_sensors = ExtraSensors(models.sensors(scenario.sensors.extra), self._step_us)
        self._escs = esc.SpeedControllers(airframes)
        kinds = [scenario.autopilot.kind_of(i) for i in range(n)]
        self._external = frozenset(i for i, kind in enumerate(kinds) if kind != "own")
        """Vehicles whose autopilot is another program."""
        self._encoder = SensorEncoder(
            scenario.site,
            px4=[i for i, kind in enumerate(kinds) if kind == "px4"],
            epoch_us=scenario.run.epoch_unix_us,
            px4_rc=scenario.autopilot.px4_rc,
        )
        self._state_encoders = {
            i: StateEncoder(
                i,
                site=scenario.site,
                step_us=self._step_us,
                epoch_us=scenario.run.epoch_unix_us,
                parameters=scenario.autopilot.external_params(i),
            )
            for i, kind in enumerate(kinds)
            if kind == "ardupilot"
        }
        self._has_escs = len(self._external) < n
        self._sends_truth = False
        self.time_us = self._step_us  # to PX4 0 is a clock that is not set
        self._truth_record = truth_record(max(rotors))
        self._inbox = ActuatorInbox(n, max(rotors))
        self._wind_now = WindNow(np.zeros((n, 3)), np.zeros((n, 3)))
        self.reports = VehicleReports(n, config.applications, now_us=lambda: self.time_us, emit=self._emit)
        """What vehicles and applications report."""
        self._instances = np.arange(n)
        self._touching: set[tuple[int, int]] = set()
        self._attenuation_db = scenario.radio.extra_attenuation_db
        """Attenuation of every radio link, without that of active faults: the scenario's, or as commanded."""
        open_log = partial(RecordLog, block_rows=config.log_block_rows)
        with contextlib.ExitStack() as stack:  # closes everything if a part cannot be opened
            keep = stack.enter_context
            self._world: Physics = physics(
                airframes=airframes,
                spawn_pos_ned_m=spawn_ned_m,
                spawn_yaw_rad=float(np.radians(scenario.formation.heading_deg)),
                step_us=self._step_us,
                environment=scenario.environment,
                ground_altitude_m=scenario.site.altitude_m,
            )
            keep(contextlib.closing(self._world))
            self._truth_log = keep(contextlib.closing(open_log(config.truth_log_path, self._truth_record)))
            self._readings = keep(
                contextlib.closing(
                    ExtraReadings(extra_sensors, self._external, config.sensor_log_path, open_log=open_log)
                )
            )
            self._air_log = keep(contextlib.closing(open_log(config.air_log_path, AIR_RECORD)))
            self._event_log = keep(Path(config.event_log_path).open("wb", buffering=0))  # noqa: SIM115
            self.lockstep = keep(contextlib.closing(make_lockstep(self)))
            self._applications: ApplicationLinks | None = None
            if make_applications is not None:
                self._applications = keep(contextlib.closing(make_applications(self)))
            self._open = stack.pop_all()

    @property
    def any_alive(self) -> bool:
        """Whether any vehicle is still in the run."""
        return self.lockstep.living > 0

    @property
    def must_end(self) -> bool:
        """Whether a vehicle or application was lost in a scenario whose ``run.on_vehicle_loss`` is "end"."""
        lost = self.lockstep.living < self._scenario.agents or bool(self.reports.without_application)
        return lost and self._scenario.run.on_vehicle_loss == "end"

    @property
    def truth(self) -> Truth:
        """Present true state of all vehicles."""
        return self._world.truth

    def step(self) -> None:
        """Simulate one step: send the sensors of this instant, receive the answers, advance world and wind.

        Work that needs no answers runs between sending and receiving, in parallel with the vehicles. The
        emulator runs in parallel over an interval of several steps, and is awaited when its deliveries are
        due.
        """
        truth, emulator = self._world.truth, self._emulator
        recorded = self.time_us % self._record_period_us == 0
        self._advance_faults()
        frame = self._sensors.sample(self.time_us, truth, self._faults)
        readings = self._readings.sample(self.time_us, self._inputs_of, self._faults, self.reports.lost)
        sends_truth = self._sends_truth and self.time_us % TRUTH_PERIOD_US < self._step_us
        sent_truth = truth if sends_truth else None
        delivered: tuple[int, ...] = ()
        if emulator is not None:
            while emulator.is_pending(self.time_us):
                self._settle_interval(emulator)
            delivered = emulator.delivered(self.time_us)
        alive = [slot.alive for slot in self.lockstep.slots] if recorded else []
        announced = tuple(vehicle for vehicle in delivered if vehicle not in self._external)
        frames = self._encoder.encode(
            self.time_us, frame, self._statuses(truth), sent_truth, announced, readings.with_sensors
        )
        self.lockstep.send(self._with_states(frames, frame, truth) if self._state_encoders else frames)
        applications = self._applications
        if applications is not None:
            passed = self._encoder.readings(readings.to_applications)
            applications.begin(self.time_us, delivered, self.reports.lost, passed)
        if recorded:
            self._record(truth, alive)
        self.notice_collisions()
        self._wind_now = self._wind.step(
            self._step_us * 1e-6, time_us=self.time_us, height_m=-truth.pos_ned_m[:, 2]
        )
        self._sensors.draw_ahead()
        inbox = self._inbox = self.lockstep.receive(self.time_us)
        applied = () if applications is None else applications.finish(self.reports.lost)
        if self.reports.lost:
            inbox.armed[list(self.reports.lost)] = False
        if emulator is not None and emulator.begins_at(self.time_us):
            until_us, busy_ns = emulator.occupancy(self.time_us)
            if until_us >= self._air_record_us:
                period_us = self._record_period_us
                self._air_record_us = until_us - until_us % period_us + period_us
                self._air_log.append([(until_us, busy_ns)])
            emulator.begin(
                self.time_us,
                self._step_us,
                truth,
                extra_attenuation_db=min(
                    self._attenuation_db + self._faults.extra_attenuation_db, MOST_ATTENUATION_DB
                ),
                range_offsets_m=self._faults.range_offsets_m,
                senders=inbox.senders + applied,
                silent=self.reports.lost,
            )
        force_ned_n = self._wind_now.force_ned_n
        if self._faults.force_ned_n is not None:
            force_ned_n = force_ned_n + self._faults.force_ned_n
        self._world.step(
            inbox.controls,
            inbox.armed,
            force_ned_n,
            rotors_stopped=self._faults.rotor_stopped,
            air_vel_ned_m_s=self._wind_now.air_vel_ned_m_s,
            rotor_effectiveness=self._faults.rotor_effectiveness,
        )
        self.time_us += self._step_us
        self.reports.notice_changes()

    def _with_states(
        self, frames: Sequence[bytes | memoryview], frame: SensorFrame, truth: Truth
    ) -> Sequence[bytes | memoryview]:
        """Return the vehicles' frames with those of ArduPilots replaced by their states."""
        inbox, replaced = self._inbox, list(frames)
        for vehicle, encoder in self._state_encoders.items():
            if vehicle in self.reports.lost:
                continue
            replaced[vehicle] = encoder.encode(
                self.time_us, frame, truth, inbox.controls[vehicle], armed=bool(inbox.armed[vehicle])
            )
            for name in encoder.parameters.unknown():
                text = f"autopilot.params.{name}: this ArduPilot has no such parameter"
                self._on_event(Warned(name=f"uav {vehicle}", time_us=self.time_us, text=text))
        return replaced

    def set_extra_attenuation_db(self, value: float) -> None:
        """Set the attenuation of every radio link from the next interval on; radio faults are added to it."""
        self._attenuation_db = value

    def inject(self, fault: AnyFault) -> None:
        """Schedule a fault for ``start_s`` after the next step. Raises ValueError for a wrong vehicle."""
        self._faults.add(fault, self.time_us)

    def _inputs_of(self, vehicle: int) -> WorldInputs:
        """Return the present truth for sensors and faults of a vehicle."""
        return inputs_of(self.time_us, self._world.truth, self.reports.alive, vehicle, self._rotors[vehicle])

    def _advance_faults(self) -> None:
        """Advance the faults to this step, and report which of them end and begin."""
        for change in self._faults.advance(self.time_us, self._inputs_of):
            self._emit(
                FaultChanged(
                    time_us=self.time_us,
                    number=change.number,
                    instance=None if change.fault.uav == "all" else change.fault.uav,
                    what=title(change.fault),
                    motor=change.motor,
                    change="began" if change.began else "ended",
                )
            )

    def _statuses(self, truth: Truth) -> Sequence[esc.EscStatus]:
        """Return ESC_STATUS of the motors' speed controllers if it is due in this step."""
        if self.time_us % esc.PERIOD_US >= self._step_us or not self._has_escs:
            return ()
        effectiveness, density_ratio = self._faults.rotor_effectiveness, self._world.density_ratio
        return self._escs.statuses(self.time_us, truth.rotor_speed_rad_s, effectiveness, density_ratio)

    def settle(self) -> None:
        """Wait until the emulator has completed the requested intervals."""
        while self._emulator is not None and self._emulator.is_busy:
            self._settle_interval(self._emulator)

    def _settle_interval(self, emulator: EmulatorClient) -> None:
        """Wait until the emulator has completed the first of the requested intervals."""
        missing = emulator.end()
        while missing:
            without: tuple[int, ...] = ()
            if self._applications is not None:
                without = self._applications.check([i for i in missing if i in self._external])
            self.lockstep.check(i for i in missing if i not in self._external)
            missing = emulator.wait_on(self.reports.lost, without)

    def vehicles(self) -> tuple[VehicleTruth, ...]:
        """Return the present truth of all vehicles."""
        connected = [slot.alive for slot in self.lockstep.slots]
        return self.reports.vehicles(
            self._world.truth, self._plan, connected=connected, armed=self._inbox.armed
        )

    @property
    def busy_fraction(self) -> float:
        """Fraction of the simulated time for which the channel was occupied."""
        if self._emulator is None or not self.time_us:
            return 0.0
        return self._emulator.busy_ns / (self.time_us * 1e3)

    def close(self) -> None:
        """Close connections, logs and world, each even if another fails; harmless when repeated."""
        self._open.close()

    def _record(self, truth: Truth, alive: list[bool]) -> None:
        rows = np.empty(len(alive), self._truth_record)
        rows["time_us"] = self.time_us
        rows["uav"] = self._instances
        rows["alive"] = alive
        rows["armed"] = self._inbox.armed
        for name in _RECORDED_OF_TRUTH:
            rows[name] = truth.rows[name]
        rows["rotor_speed_rad_s"] = truth.rotor_speed_rad_s
        rows["wind_force_ned_n"] = self._wind_now.force_ned_n
        rows["wind_vel_ned_m_s"] = self._wind_now.air_vel_ned_m_s
        self._truth_log.append_array(rows)

    def notice_collisions(self) -> None:
        """Report the collisions that began in the last step; harmless when repeated."""
        touching = self._world.vehicle_contacts
        if not touching and not self._touching:
            return
        contacts = {(contact.first, contact.second): contact for contact in touching}
        for pair in sorted(contacts.keys() - self._touching):
            first, second = pair
            where_ned_m = contacts[pair].pos_ned_m
            self._emit(Collision(time_us=self.time_us, first=first, second=second, pos_ned_m=where_ned_m))
        self._touching = set(contacts)

    def on_message(self, instance: int, message: Message) -> None:
        """Process a vehicle's message other than an answer: report, parameter or request."""
        if instance in self._state_encoders:
            self._state_encoders[instance].parameters.on_message(message, self.time_us)
        if message.get_srcComponent() == AUTOPILOT_COMPONENT and instance not in self._external:
            self._sends_truth |= _requests_truth(message)
        self.reports.on_message(instance, message)

    def _emit(self, event: AnyEvent) -> None:
        line = msgspec.json.encode(event)
        if type(event).__name__.lower() in EVENT_KINDS:
            self._event_log.write(line + b"\n")
        self._on_event(event)


def _requests_truth(message: Message) -> bool:
    """Whether a message requests HIL_STATE_QUATERNION."""
    return bool(
        message.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_LONG
        and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        and message.param1 == mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION
        and message.param2 > 0.0
    )


def run(
    simulation: Simulation,
    command: RunUntil,
    *,
    interrupted: Callable[[], bool] = lambda: False,
    on_step: Callable[[], None] = lambda: None,
) -> Paused:
    """Step until the command is done, impossible or ``interrupted``; call ``on_step`` after each step."""
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
        if command.stop_when_formed and simulation.reports.formed:
            reason = "formed"
            break
        on_step()
    simulation.settle()
    simulation.notice_collisions()
    return Paused(time_us=simulation.time_us, reason=reason, vehicles=simulation.vehicles())
