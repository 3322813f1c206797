"""Telemetry of the system: mode, health, battery, versions and time."""

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.failsafe import Cause
from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import AvailableModesMonitor, CurrentMode, ProtocolVersion
from autopilot.services.fields import I8, I16, I32, U16, UNKNOWN_I16, UNKNOWN_U16, Part, whole
from autopilot.services.flight_data import FlightData
from autopilot.services.manual_control import ManualControlService
from autopilot.services.status import heartbeat, landed_state

_CELLS_MAX = 10
"""Capacity of BATTERY_STATUS."""
VERSION = 1 << 24 | 17 << 16 | 0 << 8 | 255
"""1.17.0, a release (255): the PX4 whose behaviour is reproduced; stations offer less for an unknown one."""
_MAVLINK_VERSION = 200
_UID_NAME = b"coflight"
_UID_BYTES = 18


class SystemState(Part):
    """Messages of mode and health, battery, versions and time."""

    def __init__(
        self,
        flight: FlightData,
        *,
        system: int,
        manual: ManualControlService,
        fenced: Callable[[], bool],
        epoch_unix_us: int,
    ) -> None:
        """``fenced`` returns whether there is a geofence; ``epoch_unix_us`` is the date of time 0."""
        super().__init__(flight)
        self._system = system
        self._manual = manual
        self._fenced = fenced
        self._epoch_unix_us = epoch_unix_us

    def heartbeat(self) -> Message:
        """HEARTBEAT."""
        return heartbeat(self._flight.commander, self._flight.conditions, self._flight.mav_type)

    def extended_sys_state(self) -> Message:
        """EXTENDED_SYS_STATE."""
        flight = self._flight
        return common.MAVLink_extended_sys_state_message(
            common.MAV_VTOL_STATE_UNDEFINED, landed_state(flight.course(), landed=flight.commander.landed)
        )

    def sys_status(self) -> Message:
        """SYS_STATUS: sensors present and healthy, the battery, and whether arming would be accepted."""
        flight = self._flight
        present = _ALWAYS_THERE
        if self._fenced():
            present |= common.MAV_SYS_STATUS_GEOFENCE
        if self._manual.sticks is not None:
            present |= common.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        healthy = sum(bit for condition, bit in _SENSOR_BITS if flight.conditions & condition)
        healthy |= sum(bit for cause, bit in _HEALTH_BITS if not flight.causes & cause)
        if flight.commander.armed or not flight.commander.arming_refusals():
            healthy |= common.MAV_SYS_STATUS_PREARM_CHECK
        healthy &= present | _HEALTHY_UNSEEN
        voltage_mv, current_ca, remaining_percent = UNKNOWN_U16, -1, -1
        battery = flight.battery
        if battery.sampled_us is not None:
            voltage_mv = min(whole(1e3 * battery.voltage_v, U16), UNKNOWN_U16 - 1)
            current_ca = -1 if battery.current_a is None else whole(1e2 * battery.current_a, I16)
            remaining_percent = whole(math.ceil(1e2 * battery.remaining), I8)
        return common.MAVLink_sys_status_message(
            present, present, healthy, 0, voltage_mv, current_ca, remaining_percent,
            0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def battery_status(self) -> Message | None:
        """BATTERY_STATUS; a cell's voltage is the pack's over the number of cells, as from a power module."""
        battery = self._flight.battery
        if battery.sampled_us is None:
            return None
        cells = min(battery.params.cells, _CELLS_MAX)
        cell_mv = min(whole(1e3 * battery.voltage_v / battery.params.cells, U16), UNKNOWN_U16 - 1)
        time_s = battery.time_remaining_s
        return common.MAVLink_battery_status_message(
            0, common.MAV_BATTERY_FUNCTION_ALL, common.MAV_BATTERY_TYPE_LIPO, UNKNOWN_I16,
            [cell_mv] * cells + [UNKNOWN_U16] * (_CELLS_MAX - cells),
            -1 if battery.current_a is None else whole(1e2 * battery.current_a, I16),
            whole(battery.consumed_mah, I32), -1, whole(math.ceil(1e2 * battery.remaining), I8),
            0 if time_s is None else whole(time_s, I32),
            common.MAV_BATTERY_CHARGE_STATE_OK + battery.warning,
        )  # fmt: skip

    def system_time(self) -> Message:
        """SYSTEM_TIME: the date by the scenario's epoch, and the time since the start."""
        return common.MAVLink_system_time_message(self._epoch_unix_us + self._flight.now_us, self.boot_ms())

    def current_mode(self) -> Message:
        """CURRENT_MODE; for a mode that a failsafe forced, the intended mode is left at 0 (unknown)."""
        mode, forced = self._flight.commander.mode, self._flight.commander.failsafe
        standard = self._flight.commander.modes.standard(mode)
        return CurrentMode(standard, mode.custom_mode, 0 if forced else mode.custom_mode)

    def available_modes_monitor(self) -> Message:
        """AVAILABLE_MODES_MONITOR: the list of modes never changes."""
        return AvailableModesMonitor(seq=0)

    def autopilot_version(self) -> Message:
        """AUTOPILOT_VERSION: capabilities, and ids that are unique among the vehicles.

        Vendor and product id are 0 as in PX4's simulation, since there is no USB device.
        """
        uid2 = (_UID_NAME + self._system.to_bytes(1, "big")).ljust(_UID_BYTES, b"\0")
        return common.MAVLink_autopilot_version_message(
            _CAPABILITIES, VERSION, VERSION, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, self._system, list(uid2)
        )

    def protocol_version(self) -> Message:
        """PROTOCOL_VERSION: MAVLink 2 is sent, 1 is accepted."""
        return ProtocolVersion(version=_MAVLINK_VERSION, min_version=100, max_version=_MAVLINK_VERSION)

    def flight_information(self) -> Message:
        """FLIGHT_INFORMATION; times are since the start, as in PX4, and 0 before the first event."""
        flight = self._flight
        return common.MAVLink_flight_information_message(
            self.boot_ms(),
            flight.armed_us,
            flight.took_off_us,
            flight.flights,
            flight.landed_us // 1000 % 2**32,
        )


_CAPABILITIES = (
    common.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | common.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | common.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | common.MAV_PROTOCOL_CAPABILITY_FTP
    | common.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | common.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | common.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | common.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | common.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | common.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | common.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)
_SENSOR_BITS = (
    (int(Condition.IMU), common.MAV_SYS_STATUS_SENSOR_3D_GYRO | common.MAV_SYS_STATUS_SENSOR_3D_ACCEL),
    (int(Condition.BARO), common.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE),
    (int(Condition.MAG), common.MAV_SYS_STATUS_SENSOR_3D_MAG),
    (int(Condition.GPS), common.MAV_SYS_STATUS_SENSOR_GPS),
    (int(Condition.ATTITUDE), common.MAV_SYS_STATUS_AHRS),
    (int(Condition.MANUAL), common.MAV_SYS_STATUS_SENSOR_RC_RECEIVER),
)
_HEALTH_BITS = (
    (int(Cause.MOTOR_FAILED), common.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS),
    (int(Cause.GEOFENCE), common.MAV_SYS_STATUS_GEOFENCE),
    (
        int(Cause.BATTERY_LOW | Cause.BATTERY_CRITICAL | Cause.BATTERY_EMERGENCY),
        common.MAV_SYS_STATUS_SENSOR_BATTERY,
    ),
)
_HEALTHY_UNSEEN = common.MAV_SYS_STATUS_GEOFENCE
"""Healthy although absent: MAVProxy evaluates the geofence's health bit alone."""
_NOT_ALWAYS_THERE = common.MAV_SYS_STATUS_GEOFENCE | common.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
_ALWAYS_THERE = (
    sum(bit for _, bit in (*_SENSOR_BITS, *_HEALTH_BITS)) & ~_NOT_ALWAYS_THERE
    | common.MAV_SYS_STATUS_PREARM_CHECK
)
