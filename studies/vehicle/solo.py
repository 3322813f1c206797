"""One complete vehicle with the swarm's physics, sensors and messages, in one process without sockets.

The messages of the simulator's link are encoded and parsed as in a swarm, so a message that cannot be encoded
fails here as well. A flight is determined by its arguments.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from msgspec import structs
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import TO_VEHICLE, HilActuatorControls, HilEncoder, HilParser
from autopilot.mavlink.modes import FlightMode, mode_from_custom
from autopilot.parameters.config import AutopilotConfig, Devices, VehicleConfig
from autopilot.parameters.onboard_config import OnboardConfig
from autopilot.services.service import GROUND_STATION, Partner, reply
from autopilot.vehicle.vehicle import StepOutput, Vehicle
from foundation.airframe.description import Airframe
from foundation.airframe.files import IRIS
from foundation.types import Array, TrajectorySetpoint
from harness.simulator.actuator_inbox import is_armed
from harness.simulator.hil import SensorEncoder
from harness.world import esc
from harness.world.physics.world import World
from harness.world.sensors.config import SensorsConfig
from harness.world.sensors.suite import SensorFrame, SensorSuite
from harness.world.wind import GustyWind, WindConfig

STEP_US = 4_000
STEP_S = STEP_US * 1e-6
SETPOINT_PERIOD_US = 48_000
"""Period of offboard setpoints: about 20 Hz, in whole steps."""
ARM = common.MAV_CMD_COMPONENT_ARM_DISARM
MODE = common.MAV_CMD_DO_SET_MODE
TAKE_OFF = common.MAV_CMD_NAV_TAKEOFF
CALM = WindConfig(mean_n=0.0)
_NO_GPS = common.MAVLINK_MSG_ID_HIL_GPS
_YAW_RATE_IGNORED = common.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_POSITION_ONLY = 0b0001_1111_1000 | _YAW_RATE_IGNORED
_VELOCITY_ONLY = 0b0001_1100_0111 | _YAW_RATE_IGNORED
_READY_LIMIT_S = 30.0
_RETRY_S = 0.5
_TAKE_OFF_LIMIT_S = 40.0

PLAIN = structs.replace(
    IRIS,
    propulsion=structs.replace(IRIS.propulsion, drag_n_s2_m=0.0, rolling_moment_n_s2=0.0),
    body=structs.replace(IRIS.body, drag_n_s_m=0.25),
)
"""Iris with linear drag of 0.25 N/(m/s) as the only drag: the 6-DOF body on which a real PX4 was measured."""


class FlightError(RuntimeError):
    """A flight did not reach the required state; the text is one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """Recorded flight, one row for each of T steps.

    Positions are relative to the centre of mass at the start, on the ground; estimates are converted to that
    frame with the estimator's origin.
    """

    time_s: Array
    """(T,) since the start of the simulation"""
    pos_ned_m: Array
    """(T, 3) truth, like the next two fields"""
    vel_ned_m_s: Array
    q_ned_frd: Array
    """(T, 4) wxyz"""
    estimated_pos_ned_m: Array
    """(T, 3)"""
    own_pos_ned_m: Array
    """(T, 3) estimate relative to the estimator's origin, the frame of the setpoints"""
    estimated_vel_ned_m_s: Array
    estimated_q_ned_frd: Array

    def after(self, time_s: float) -> "Track":
        """Return the part that begins at ``time_s``."""
        first = int(np.searchsorted(self.time_s, time_s - 0.5 * STEP_S))
        return Track(**{name: getattr(self, name)[first:] for name in self.__slots__})

    @property
    def attitude_error_rad(self) -> Array:
        """(T,) angle between estimated and true attitude."""
        dot = np.abs((self.q_ned_frd * self.estimated_q_ned_frd).sum(axis=1))
        return np.asarray(2.0 * np.arccos(np.minimum(dot, 1.0)))

    @property
    def tilt_error_rad(self) -> Array:
        """(T,) angle between the estimated and the true vertical."""
        cosine = (_vertical_frd(self.q_ned_frd) * _vertical_frd(self.estimated_q_ned_frd)).sum(axis=1)
        return np.asarray(np.arccos(np.minimum(cosine, 1.0)))


def _vertical_frd(q_ned_frd: Array) -> Array:
    """Return the down direction in body axes, (T, 3)."""
    w, x, y, z = q_ned_frd.T
    return np.stack((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z), axis=1)


_STATE = ("pos_ned_m", 3), ("vel_ned_m_s", 3), ("q_ned_frd", 4)
_RECORD = np.dtype(
    [("time_s", "f8")]
    + [(f"{of}{name}", "f8", length) for of in ("", "estimated_") for name, length in _STATE]
)


def solo_config(
    *,
    params: dict[str, float] | None = None,
    seed: int = 0,
    gps_delay_s: float = Devices().gps_delay_s,
    airframe: Airframe = IRIS,
) -> VehicleConfig:
    """Return the configuration of a single vehicle without the on-board application."""
    return VehicleConfig(
        run_id="solo", instance=0, seed=seed, airframe=airframe,
        onboard=OnboardConfig(enabled=False, localisation="gps"),
        autopilot=AutopilotConfig(params=params or {}),
        devices=Devices(gps_delay_s=gps_delay_s), places_ned_m=((0.0, 0.0, -5.0),),
    )  # fmt: skip


class Solo:
    """World and vehicle in lockstep, with a ground station: `send`, `command` and received messages."""

    def __init__(
        self,
        config: VehicleConfig,
        *,
        plant: Airframe | None = None,
        sensors: SensorsConfig | None = None,
        wind: WindConfig = CALM,
        seed: np.random.SeedSequence,
        spawn_yaw_rad: float = 0.0,
        imu_noise: float = 1.0,
        recording: bool = True,
    ) -> None:
        """Place the vehicle on the ground. ``imu_noise`` scales the inertial errors of the sensor profile.

        ``plant`` is the airframe of the physics; None: that of ``config``, from which the autopilot has its.
        """
        self.vehicle = Vehicle(config)
        plant = config.airframe if plant is None else plant
        self._escs = esc.SpeedControllers([plant])
        self._rotors = len(plant.rotors)
        self.rotors_stopped = np.zeros((1, self._rotors), dtype=np.bool_)
        """(1, n) motors without current."""
        self._start_ned_m = np.array((0.0, 0.0, -plant.standing_height_m))
        self.world = World(
            airframes=[plant],
            spawn_pos_ned_m=[self._start_ned_m],
            spawn_yaw_rad=spawn_yaw_rad,
            step_us=STEP_US,
        )
        self._standing_height_m = plant.standing_height_m
        self._wind = GustyWind(wind, 1, np.random.default_rng(seed))
        self._sensors = SensorSuite(
            config=sensors if sensors is not None else SensorsConfig(), site=config.site, vehicles=1,
            step_us=STEP_US, seed=seed,
        )  # fmt: skip
        self._imu_noise = imu_noise
        self._hil = SensorEncoder()
        self._parser = HilParser(*TO_VEHICLE)
        self._from_vehicle = HilParser(HilActuatorControls)
        self._encoder = HilEncoder(system=config.instance + 1, component=1)
        self.gps = True
        """False drops the GPS fixes before they reach the vehicle."""
        self.stream: list[bytes] | None = None
        """If a list is set: bytes sent to the vehicle, one entry each step"""
        self.now_us = 0
        self.received: list[tuple[int, Message]] = []
        """(time_us, message) received by the ground station, without heartbeats."""
        self.modes: list[tuple[int, str, bool]] = []
        """(time_us, mode, armed) from heartbeats to the simulator, at each change."""
        self._to_send: list[Message] = []
        self._setpoint: Message | None = None
        self._recording = recording
        self._rows = np.empty(4096, _RECORD)
        self._taken = 0

    def __enter__(self) -> Self:
        """Return the object itself; the world exists already."""
        return self

    def __exit__(self, *_: object) -> None:
        self.world.close()

    # ---- stepping

    @property
    def now_s(self) -> float:
        """Simulated time since the start."""
        return self.now_us * 1e-6

    @property
    def height_m(self) -> float:
        """True height above the ground at the start."""
        return -float(self.world.truth.pos_ned_m[0, 2]) - self._standing_height_m

    def step(self, *, streams: bool = False, controls: Array | None = None) -> StepOutput:
        """Advance vehicle, then world, by one step.

        ``streams``: both links are active. ``controls`` (n,) replace the motor controls of the vehicle, which
        gets no notice of it.
        """
        self.now_us += STEP_US
        if self._setpoint is not None and self.now_us % SETPOINT_PERIOD_US == 0:
            self._to_send.append(self._setpoint)
        (frame,) = self._hil.encode(self.now_us, self._read_sensors(), self._statuses())
        data = bytes(frame)  # a copy: the frame is valid only until the next one
        if self.stream is not None:
            self.stream.append(data)
        messages = self._parser.push(data)
        if not self.gps:
            messages = [message for message in messages if message.get_msgId() != _NO_GPS]
        sent, self._to_send = self._to_send, []
        output = self.vehicle.step(
            sim_messages=messages,
            link_messages=reply(Partner(GROUND_STATION, 0), *sent),
            link_active=(streams, streams),
        )
        self._receive(output)
        (answer,) = self._from_vehicle.push(self._encoder.encode(output.actuators))
        if not isinstance(answer, HilActuatorControls):
            raise FlightError(f"unexpected message from the vehicle: {answer!r}")
        self.world.step(
            np.array([answer.controls[: self._rotors] if controls is None else controls]),
            np.array([is_armed(answer)]),
            self._wind.step(STEP_S),
            rotors_stopped=self.rotors_stopped,
        )
        if self._recording:
            self._record()
        return output

    def run(self, seconds: float, *, until: Callable[[], bool] | None = None) -> bool:
        """Step for ``seconds`` or until the condition holds; return whether it did."""
        for _ in range(round(seconds / STEP_S)):
            self.step()
            if until is not None and until():
                return True
        return False

    # ---- the ground station

    def send(self, *messages: Message) -> None:
        """Send messages with the next step."""
        self._to_send += messages

    def command(self, command: int, *params: float) -> int:
        """Send a command, step once and return the result in its acknowledgement."""
        padded = (*params, *[0.0] * (7 - len(params)))
        self.send(common.MAVLink_command_long_message(1, 1, command, 0, *padded))
        self.step()
        results = [
            message.result
            for time_us, message in self.received
            if time_us == self.now_us and message.get_type() == "COMMAND_ACK" and message.command == command
        ]
        if len(results) != 1:
            raise FlightError(f"command {command} was acknowledged {len(results)} times")
        result: int = results[0]
        return result

    def texts(self) -> list[str]:
        """Return the status texts received so far."""
        return [message.text for _, message in self.received if message.get_type() == "STATUSTEXT"]

    def set_position(self, north_m: float, east_m: float, down_m: float) -> None:
        """Stream this offboard setpoint from now on, in the estimator's frame, heading north."""
        self._setpoint = _target(_POSITION_ONLY, north_m, east_m, down_m, *[0.0] * 7)

    def set_velocity(self, north_m_s: float, east_m_s: float, down_m_s: float) -> None:
        """Stream this offboard setpoint from now on, heading north."""
        self._setpoint = _target(_VELOCITY_ONLY, *[0.0] * 3, north_m_s, east_m_s, down_m_s, *[0.0] * 4)

    def set_reference(self, setpoint: TrajectorySetpoint) -> None:
        """Stream this offboard setpoint, starting with the next step; all three groups must be set."""
        groups = (setpoint.pos_ned_m, setpoint.vel_ned_m_s, setpoint.acc_ned_m_s2)
        values = [value for group in groups if group is not None for value in map(float, group)]
        self._setpoint = _target(_YAW_RATE_IGNORED, *values, setpoint.yaw_rad or 0.0)
        self.send(self._setpoint)

    def take_off(self, height_m: float) -> None:
        """Wait for the estimator, arm, take off and wait for the hold. Raises FlightError."""
        vehicle = self.vehicle
        while self.command(ARM, 1.0) != common.MAV_RESULT_ACCEPTED:
            if self.now_s > _READY_LIMIT_S:
                raise FlightError(f"not ready after {_READY_LIMIT_S:g} s: {' / '.join(self.texts()[-1:])}")
            self.run(_RETRY_S)
        altitude_m = vehicle.flight.state.origin_alt_m + height_m
        self._require(TAKE_OFF, *[0.0] * 3, *[math.nan] * 3, altitude_m)
        if not self.run(_TAKE_OFF_LIMIT_S, until=lambda: vehicle.commander.mode is FlightMode.HOLD):
            raise FlightError(f"no hold {_TAKE_OFF_LIMIT_S:g} s after take-off to {height_m:g} m")

    def offboard(self) -> None:
        """Switch to offboard mode, which follows the streamed setpoint. Raises FlightError."""
        self.run(2 * SETPOINT_PERIOD_US * 1e-6)
        self._require(MODE, 1.0, float(FlightMode.OFFBOARD.custom_mode >> 16), 0.0)

    def _require(self, command: int, *params: float) -> None:
        result = self.command(command, *params)
        if result != common.MAV_RESULT_ACCEPTED:
            raise FlightError(f"command {command} refused: {' / '.join(self.texts()[-1:])}")

    # ---- records

    @property
    def track(self) -> Track:
        """Recorded flight so far."""
        rows = self._rows[: self._taken]
        columns = {name: rows[name].copy() for name in _RECORD.names or ()}
        columns["pos_ned_m"] -= self._start_ned_m
        columns["own_pos_ned_m"] = columns["estimated_pos_ned_m"].copy()
        columns["estimated_pos_ned_m"] += self.vehicle.site.origin_ned_m(self.vehicle.flight.state)
        return Track(**columns)

    def _record(self) -> None:
        if self._taken == len(self._rows):
            self._rows = np.concatenate((self._rows, np.empty_like(self._rows)))
        truth, state = self._measured, self.vehicle.flight.state
        self._rows[self._taken] = (
            self.now_us * 1e-6, truth.pos_ned_m[0], truth.vel_ned_m_s[0], truth.q_ned_frd[0],
            state.pos_ned_m, state.vel_ned_m_s, state.q_ned_frd,
        )  # fmt: skip
        self._taken += 1

    def _read_sensors(self) -> SensorFrame:
        truth = self._measured = self.world.truth
        frame = self._sensors.sample(self.now_us, truth)
        if self._imu_noise == 1.0:
            return frame
        accel, gyro = truth.specific_force_frd_m_s2, truth.mean_omega_frd_rad_s
        return structs.replace(
            frame,
            accel_frd_m_s2=accel + self._imu_noise * (frame.accel_frd_m_s2 - accel),
            gyro_frd_rad_s=gyro + self._imu_noise * (frame.gyro_frd_rad_s - gyro),
        )

    def _statuses(self) -> Sequence[esc.EscStatus]:
        """Return ESC_STATUS in steps that have them, as the physics server does."""
        if self.now_us % esc.PERIOD_US >= STEP_US:
            return ()
        return self._escs.statuses(self.now_us, self._measured.rotor_speed_rad_s)

    def _receive(self, output: StepOutput) -> None:
        self.received += [
            (self.now_us, message)
            for partner, message in output.links
            if partner.link == GROUND_STATION and message.get_type() != "HEARTBEAT"
        ]
        for message in output.simulator:
            if message.get_type() == "HEARTBEAT" and message.autopilot == common.MAV_AUTOPILOT_PX4:
                mode = mode_from_custom(message.custom_mode)
                if mode is None:
                    raise FlightError(f"heartbeat with unknown mode {message.custom_mode}")
                seen = (mode.label, bool(message.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED))
                if not self.modes or self.modes[-1][1:] != seen:
                    self.modes.append((self.now_us, *seen))


def _target(mask: int, *values: float) -> Message:
    """Return a setpoint from position, velocity, acceleration (NED) and yaw: ten values."""
    return common.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, common.MAV_FRAME_LOCAL_NED, mask, *values, 0.0
    )
