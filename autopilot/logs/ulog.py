"""The ULog of one vehicle: PX4's topics, with the definitions of v1.17, at the rates of its default logger.

The writer returns bytes, piece by piece: the head, then for each full step the samples that are due, and in
blocks of `ROWS_AT_ONCE` inertial samples those of the topics that are sampled in fast steps too. Timestamps
are microseconds of simulated time. Positions are from the estimator's origin, in NED, in metres. Ground truth
is not known to a vehicle: the report adds its topics (`harness.report.ulog_truth`), which the head defines.
"""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from autopilot.logs import ulog_estimator, ulog_motion, ulog_sensors, ulog_status
from autopilot.logs.ulog_messages import (
    SampleEncoder,
    Values,
    default_parameter,
    file_header,
    format_definition,
    logged_text,
    number_information,
    parameter,
    subscription,
    text_information,
)
from autopilot.logs.ulog_rows import RowEncoder
from autopilot.logs.ulog_topics import NUMBER_OF, TOPICS, TRUTH_TOPICS
from autopilot.parameters.table import ROWS
from autopilot.services.parameter import value_bytes
from autopilot.vehicle.shared_state import MOST_ROWS

if TYPE_CHECKING:
    from autopilot.vehicle.vehicle import Vehicle

ROWS_AT_ONCE = 250
"""A second at the simulator's 250 Hz. With the file's buffer a killed vehicle lacks up to two seconds."""
PX4_VERSION = 0x0111_00FF
"""v1.17.0, a release: that of the message definitions, and that of the vehicle's AUTOPILOT_VERSION."""
DATA_FORMAT = 2
"""PX4's version of the contents: positions of receivers in degrees and metres."""
_IMU_FIELDS = 0b11_1111
_UNKNOWN_ATTITUDE = (float("nan"),) * 4


class _Source(NamedTuple):
    """Where the samples of a topic come from."""

    topic: str
    read: Callable[[], Values | None]
    key: Callable[[], object] | None = None
    """What the topic depends on, of topics that PX4 publishes on changes: sampled at once when it changes."""
    needs_change: bool = False
    """Whether nothing is sampled without a change."""


class _Stream:
    """One topic with the time of its next sample."""

    def __init__(self, source: _Source) -> None:
        number = NUMBER_OF[source.topic]
        self._source, self._period_us = source, TOPICS[number].period_us
        self._encoder = SampleEncoder(number, TOPICS[number])
        self._due_us = 0
        self._key: object = None

    def sample(self, now_us: int) -> bytes:
        """Return the sample of a step, if there is one."""
        source = self._source
        due = now_us >= self._due_us
        if source.key is not None:
            key = source.key()
            changed, self._key = key != self._key, key
            due = (due and changed) if source.needs_change else (due or changed)
        if not due:
            return b""
        if self._period_us:
            self._due_us = now_us - now_us % self._period_us + self._period_us
        values = source.read()
        return b"" if values is None else self._encoder.encode(now_us, values)


class UlogWriter:
    """Returns the bytes of one log, piece by piece."""

    def __init__(self, name: str, version: str, vehicle: "Vehicle") -> None:
        """``name`` is the vehicle's name in the log, ``version`` that of the program."""
        self._name, self._version = name, version
        self._vehicle = vehicle
        self._parameters_version = -1
        self._written: dict[str, bytes] = {}
        self._rows = RowEncoder()
        self._yaw_resets = 0
        self._known_us = self._entered_us = self._homes = 0
        self._mode: object = None
        self._masks = ulog_status.mode_masks(vehicle)
        self._streams = [_Stream(source) for source in self._sources()]

    def begin(self, now_us: int) -> bytes:
        """Return header and definitions, and have all steps from now on collect their rows."""
        self._vehicle.shared.samples.open()
        topics = TOPICS + TRUTH_TOPICS
        information = {
            "sys_name": "coflight", "ver_hw": "SITL", "sys_os_name": "Linux", "ver_sw": self._version,
            "vehicle": self._name,
        }  # fmt: skip
        return (
            file_header(now_us)
            + b"".join(map(format_definition, topics))
            + b"".join(text_information(name, value) for name, value in information.items())
            + number_information("ver_sw_release", PX4_VERSION)
            + number_information("ver_data_format", DATA_FORMAT)
            + self._defaults()
            + self._changed_parameters()
            + b"".join(subscription(number, topic) for number, topic in enumerate(TOPICS))
        )

    def step(self) -> bytes:
        """Return what a full step adds: samples that are due, and parameters that have changed."""
        vehicle = self._vehicle
        now_us, rows, state = vehicle.flight.now_us, vehicle.shared.samples, vehicle.flight.state
        changed = self._parameters_version != vehicle.parameters.version
        data = b""
        if state.yaw_reset_counter != self._yaw_resets:
            data += self.rest()  # the rows before the reset
            self._yaw_resets = state.yaw_reset_counter
        if rows.count == MOST_ROWS:
            data += self.rest()  # there must be room for the row
        self._add_row()
        if changed or rows.count >= ROWS_AT_ONCE:
            data += self.rest()
        if vehicle.flight.origin_known and not self._known_us:
            self._known_us = now_us
        if vehicle.commander.mode != self._mode:
            self._mode, self._entered_us = vehicle.commander.mode, now_us
        data += b"".join([stream.sample(now_us) for stream in self._streams])
        return data + self._changed_parameters() if changed else data

    def rest(self) -> bytes:
        """Return the samples of the rows that were not returned yet."""
        rows, state = self._vehicle.shared.samples, self._vehicle.flight.state
        if not rows.count:
            return b""
        return self._rows.encode(
            rows.take(),
            yaw_resets=self._yaw_resets,
            yaw_reset_rad=state.yaw_reset_delta_rad if self._yaw_resets else 0.0,
            accel_bias_m_s2=state.accel_bias_m_s2.tolist(),
        )

    @staticmethod
    def text(severity: int, now_us: int, text: str) -> bytes:
        """Return a text that was sent to the stations; ``severity`` is MAV_SEVERITY, as in syslog."""
        return logged_text(severity, now_us, text)

    def _add_row(self) -> None:
        """Append the row of a full step, as `fast_step.inertial_step` does of a fast one."""
        vehicle = self._vehicle
        sensor, state, controller = vehicle.flight.sensor, vehicle.flight.state, vehicle.pilot.controller
        if sensor is None or sensor.fields_updated & _IMU_FIELDS != _IMU_FIELDS:
            return
        block = controller.block
        attitude = _UNKNOWN_ATTITUDE if vehicle.estimator.filter is None else state.q_ned_frd.tolist()
        vehicle.shared.samples.append((
            sensor.time_usec, sensor.xacc, sensor.yacc, sensor.zacc, sensor.xgyro, sensor.ygyro, sensor.zgyro,
            *attitude, *state.omega_frd_rad_s.tolist(), *block["rate_setpoint_frd_rad_s"][0].tolist(),
            *block["torque"][0].tolist(), controller.thrust,
        ))  # fmt: skip

    def _sources(self) -> tuple[_Source, ...]:
        """Return the topics that full steps sample."""
        vehicle, flight, commander = self._vehicle, self._vehicle.flight, self._vehicle.commander
        motion, sensors = ulog_motion, ulog_sensors

        def of(read: Callable[["Vehicle"], Values | None]) -> Callable[[], Values | None]:
            return partial(read, vehicle)

        def pressure(read: Callable[..., Values]) -> Callable[[], Values | None]:
            return lambda: None if flight.baro is None else read(flight.baro)

        return (
            _Source("vehicle_attitude_setpoint", of(motion.attitude_setpoint)),
            _Source("vehicle_local_position", lambda: motion.local_position(vehicle, self._known_us)),
            _Source("vehicle_local_position_setpoint", of(motion.local_position_setpoint)),
            _Source("vehicle_global_position", of(motion.global_position)),
            _Source("trajectory_setpoint", of(motion.trajectory_setpoint)),
            _Source("actuator_motors", of(motion.motors)),
            _Source("actuator_outputs", of(motion.outputs)),
            _Source("hover_thrust_estimate", of(motion.hover_thrust)),
            _Source("rate_ctrl_status", of(motion.rate_integrals)),
            _Source("vehicle_gps_position", of(sensors.gps), lambda: flight.gps_us, needs_change=True),
            _Source("sensor_gps", of(sensors.gps), lambda: flight.gps_us, needs_change=True),
            _Source("vehicle_air_data", pressure(sensors.air_data)),
            _Source("sensor_baro", pressure(sensors.baro)),
            _Source("vehicle_magnetometer", lambda: None if flight.mag is None else sensors.mag(flight.mag)),
            _Source("estimator_status", of(ulog_estimator.status)),
            _Source("estimator_innovations", of(ulog_estimator.innovations)),
            _Source("estimator_innovation_variances", of(ulog_estimator.variances)),
            _Source("estimator_innovation_test_ratios", of(ulog_estimator.test_ratios)),
            _Source("estimator_states", of(ulog_estimator.states)),
            _Source("estimator_sensor_bias", of(ulog_estimator.sensor_bias)),
            _Source("battery_status", of(sensors.battery)),
            _Source("manual_control_setpoint", of(sensors.sticks)),
            _Source("vehicle_land_detected", of(ulog_status.landed), lambda: vehicle.pilot.land_stage),
            _Source(
                "vehicle_status",
                lambda: ulog_status.status(vehicle, self._entered_us),
                lambda: (commander.mode, commander.armed, commander.failsafe, vehicle.pilot.landed),
            ),
            _Source(
                "failsafe_flags",
                lambda: ulog_status.failsafe_flags(vehicle, self._masks),
                lambda: (flight.conditions, flight.causes),
            ),
            _Source("home_position", self._home, lambda: flight.home, needs_change=True),
        )

    def _home(self) -> Values | None:
        self._homes += 1
        return ulog_motion.home(self._vehicle, self._homes)

    def _defaults(self) -> bytes:
        """Return the defaults of the parameters that differ from theirs; the others have none in the log."""
        parameters, data = self._vehicle.parameters, b""
        for row in ROWS:
            value = value_bytes(row.is_integer, parameters.get(row.name))
            default = value_bytes(row.is_integer, parameters.default(row.name))
            if value != default:
                data += default_parameter(row.name, default, is_integer=row.is_integer)
        return data

    def _changed_parameters(self) -> bytes:
        """Return the parameters that have changed since the last call."""
        parameters, data = self._vehicle.parameters, b""
        self._parameters_version = parameters.version
        for row in ROWS:
            value = value_bytes(row.is_integer, parameters.get(row.name))
            if self._written.get(row.name) != value:
                self._written[row.name] = value
                data += parameter(row.name, value, is_integer=row.is_integer)
        return data
