"""Forms the messages that the vehicle streams or is asked for, each from its present values."""

import math
from collections.abc import Iterable

from pymavlink.dialects.v20 import common

from autopilot.commander.conditions import Condition
from autopilot.commander.failsafe import Cause
from autopilot.estimation.rotation import quat_rotate_inverse, quat_to_euler
from autopilot.mavlink.codec import Message
from autopilot.navigation.geodesy import ned_to_geodetic
from autopilot.protocol.flight_data import FlightData
from autopilot.protocol.status import heartbeat, landed_state
from autopilot.protocol.streams import Builder

_UNKNOWN_U16 = 65_535
_UNKNOWN_I16 = 32_767
_CELLS_MAX = 10
"""That BATTERY_STATUS has room for."""
_CENTIDEGREES = 36_000
_I8, _I16, _U16, _I32 = (-128, 127), (-32_768, 32_767), (0, 65_535), (-(2**31), 2**31 - 1)
_FLOAT32_MAX = 3.402823e38


class Telemetry:
    """Builders of the messages by id; each gives None while what it speaks of is not known."""

    def __init__(self, flight: FlightData, *, system: int) -> None:
        self._flight = flight
        self._system = system
        self.builders: dict[int, Builder] = {kind.id: build for kind, build in _pairs(self)}

    def heartbeat(self) -> Message:
        """HEARTBEAT."""
        return heartbeat(self._flight.commander, self._flight.conditions)

    def attitude(self) -> Message | None:
        """ATTITUDE."""
        state = self._flight.state
        if not state.attitude_valid:
            return None
        return common.MAVLink_attitude_message(
            self._boot_ms(), *quat_to_euler(state.q_ned_frd).tolist(), *state.omega_frd_rad_s.tolist()
        )

    def attitude_quaternion(self) -> Message | None:
        """ATTITUDE_QUATERNION."""
        state = self._flight.state
        if not state.attitude_valid:
            return None
        return common.MAVLink_attitude_quaternion_message(
            self._boot_ms(), *state.q_ned_frd.tolist(), *state.omega_frd_rad_s.tolist()
        )

    def local_position_ned(self) -> Message | None:
        """LOCAL_POSITION_NED."""
        state = self._flight.state
        if not (state.position_valid and state.height_valid):
            return None
        return common.MAVLink_local_position_ned_message(
            self._boot_ms(), *_singles(state.pos_ned_m.tolist()), *_singles(state.vel_ned_m_s.tolist())
        )

    def global_position_int(self) -> Message | None:
        """GLOBAL_POSITION_INT."""
        state = self._flight.state
        if not (state.position_valid and state.height_valid):
            return None
        lat_deg, lon_deg, alt_m = self._geodetic()
        home = self._flight.home
        relative_m = alt_m - (home.alt_m if home is not None else state.origin_alt_m)
        north, east, down = (_whole(100.0 * v, _I16) for v in state.vel_ned_m_s.tolist())
        heading_cdeg = _whole(math.degrees(self._yaw_rad()) * 100.0, _I32) % _CENTIDEGREES
        return common.MAVLink_global_position_int_message(
            self._boot_ms(), *_place(lat_deg, lon_deg, alt_m), _whole(relative_m * 1e3, _I32),
            north, east, down, heading_cdeg,
        )  # fmt: skip

    def gps_raw_int(self) -> Message | None:
        """GPS_RAW_INT: the last fix as it came, at the time of its arrival by the vehicle's own clock."""
        gps = self._flight.gps
        if gps is None:
            return None
        return common.MAVLink_gps_raw_int_message(
            self._flight.gps_us, gps.fix_type, gps.lat, gps.lon, gps.alt, gps.eph, gps.epv, gps.vel, gps.cog,
            gps.satellites_visible, h_acc=_mm(gps.eph), v_acc=_mm(gps.epv),
        )  # fmt: skip

    def gps_global_origin(self) -> Message | None:
        """GPS_GLOBAL_ORIGIN of the local frame."""
        if not self._flight.origin_known:
            return None
        state = self._flight.state
        return common.MAVLink_gps_global_origin_message(
            *_place(state.origin_lat_deg, state.origin_lon_deg, state.origin_alt_m), self._flight.now_us
        )

    def home_position(self) -> Message | None:
        """HOME_POSITION."""
        home = self._flight.home
        if home is None:
            return None
        return common.MAVLink_home_position_message(
            *_place(home.lat_deg, home.lon_deg, home.alt_m),
            *_singles(home.pos_ned_m), home.q_ned_frd, 0.0, 0.0, 0.0, self._flight.now_us,
        )  # fmt: skip

    def extended_sys_state(self) -> Message:
        """EXTENDED_SYS_STATE."""
        return common.MAVLink_extended_sys_state_message(
            common.MAV_VTOL_STATE_UNDEFINED, landed_state(self._flight.commander)
        )

    def sys_status(self) -> Message:
        """SYS_STATUS: what is there, what is well, the battery, and whether arming would be granted."""
        flight = self._flight
        healthy = sum(bit for condition, bit in _SENSOR_BITS if flight.conditions & condition)
        healthy |= sum(bit for cause, bit in _HEALTH_BITS if not flight.causes & cause)
        if flight.commander.armed or not flight.commander.arming_refusals():
            healthy |= common.MAV_SYS_STATUS_PREARM_CHECK
        voltage_mv, current_ca, remaining_percent = _UNKNOWN_U16, -1, -1
        battery = flight.battery
        if battery.sampled_us is not None:
            voltage_mv = min(_whole(1e3 * battery.voltage_v, _U16), _UNKNOWN_U16 - 1)
            current_ca = -1 if battery.current_a is None else _whole(1e2 * battery.current_a, _I16)
            remaining_percent = _whole(math.ceil(1e2 * battery.remaining), _I8)
        return common.MAVLink_sys_status_message(
            _ALL_SENSORS,
            _ALL_SENSORS,
            healthy,
            0,
            voltage_mv,
            current_ca,
            remaining_percent,
            0,
            0,
            0,
            0,
            0,
            0,
        )

    def battery_status(self) -> Message | None:
        """BATTERY_STATUS; a cell's voltage is the pack's by their number, as a power module sees it."""
        battery = self._flight.battery
        if battery.sampled_us is None:
            return None
        cells = min(battery.params.cells, _CELLS_MAX)
        cell_mv = min(_whole(1e3 * battery.voltage_v / battery.params.cells, _U16), _UNKNOWN_U16 - 1)
        time_s = battery.time_remaining_s
        return common.MAVLink_battery_status_message(
            0, common.MAV_BATTERY_FUNCTION_ALL, common.MAV_BATTERY_TYPE_LIPO, _UNKNOWN_I16,
            [cell_mv] * cells + [_UNKNOWN_U16] * (_CELLS_MAX - cells),
            -1 if battery.current_a is None else _whole(1e2 * battery.current_a, _I16),
            _whole(battery.consumed_mah, _I32), -1, _whole(math.ceil(1e2 * battery.remaining), _I8),
            0 if time_s is None else _whole(time_s, _I32),
            common.MAV_BATTERY_CHARGE_STATE_OK + battery.warning,
        )  # fmt: skip

    def altitude(self) -> Message | None:
        """ALTITUDE."""
        state = self._flight.state
        if not (state.height_valid and self._flight.origin_known):
            return None
        local_m = -float(state.pos_ned_m[2])
        amsl_m = state.origin_alt_m + local_m
        relative_m = amsl_m - self._flight.home.alt_m if self._flight.home is not None else local_m
        amsl_m, local_m, relative_m = _singles((amsl_m, local_m, relative_m))
        return common.MAVLink_altitude_message(
            self._flight.now_us, amsl_m, amsl_m, local_m, relative_m, math.nan, math.nan
        )

    def vfr_hud(self) -> Message | None:
        """VFR_HUD."""
        state = self._flight.state
        if not (state.velocity_valid and self._flight.origin_known):
            return None
        north, east, down = state.vel_ned_m_s.tolist()
        thrust = self._flight.attitude_setpoint.thrust if self._flight.attitude_setpoint is not None else 0.0
        speed_m_s, alt_m, climb_m_s = _singles(
            (math.hypot(north, east), state.origin_alt_m - float(state.pos_ned_m[2]), -down)
        )
        return common.MAVLink_vfr_hud_message(
            0.0, speed_m_s, _whole(math.degrees(self._yaw_rad()), _I16) % 360, _whole(100.0 * thrust, _U16),
            alt_m, climb_m_s,
        )  # fmt: skip

    def odometry(self) -> Message | None:
        """ODOMETRY: pose in the local NED frame, velocity in the body's, as PX4 sends them."""
        state = self._flight.state
        if not (state.position_valid and state.attitude_valid):
            return None
        vel_frd_m_s = quat_rotate_inverse(state.q_ned_frd, state.vel_ned_m_s)
        return common.MAVLink_odometry_message(
            self._flight.now_us, common.MAV_FRAME_LOCAL_NED, common.MAV_FRAME_BODY_FRD,
            *_singles(state.pos_ned_m.tolist()), state.q_ned_frd.tolist(),
            *_singles(vel_frd_m_s.tolist()), *state.omega_frd_rad_s.tolist(),
            _upper_triangle(state.pos_std_m.tolist() + state.attitude_std_rad.tolist()),
            _upper_triangle(state.vel_std_m_s.tolist() + [math.nan] * 3),
            state.reset_counter % 256, common.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        )  # fmt: skip

    def estimator_status(self) -> Message | None:
        """ESTIMATOR_STATUS: what is valid, how well the measurements fit and how sure the filter is."""
        state, fit = self._flight.state, self._flight.estimator.diagnostics
        if fit is None:
            return None
        flags = sum(
            bit
            for valid, bit in (
                (state.attitude_valid, common.ESTIMATOR_ATTITUDE),
                (state.velocity_valid, common.ESTIMATOR_VELOCITY_HORIZ | common.ESTIMATOR_VELOCITY_VERT),
                (state.position_valid, common.ESTIMATOR_POS_HORIZ_REL | common.ESTIMATOR_POS_HORIZ_ABS),
                (state.height_valid, common.ESTIMATOR_POS_VERT_ABS),
                (fit.position_held, common.ESTIMATOR_CONST_POS_MODE),
                (max(fit.velocity.test_ratio, fit.position.test_ratio) >= 1.0, common.ESTIMATOR_GPS_GLITCH),
                (fit.accelerometer_bad, common.ESTIMATOR_ACCEL_ERROR),
            )
            if valid
        )
        north_m, east_m, down_m = state.pos_std_m.tolist()
        ratios = [of.test_ratio for of in (fit.velocity, fit.position, fit.height, fit.heading)]
        return common.MAVLink_estimator_status_message(
            self._flight.now_us, flags, *_singles(ratios), math.nan, math.nan,
            *_singles((math.hypot(north_m, east_m), down_m)),
        )  # fmt: skip

    def highres_imu(self) -> Message | None:
        """HIGHRES_IMU: the last sensor sample as it came."""
        s = self._flight.sensor
        if s is None:
            return None
        return common.MAVLink_highres_imu_message(
            s.time_usec, s.xacc, s.yacc, s.zacc, s.xgyro, s.ygyro, s.zgyro, s.xmag, s.ymag, s.zmag,
            s.abs_pressure, s.diff_pressure, s.pressure_alt, s.temperature, s.fields_updated & 0xFFFF,
        )  # fmt: skip

    def scaled_pressure(self) -> Message | None:
        """SCALED_PRESSURE."""
        s = self._flight.baro
        if s is None:
            return None
        return common.MAVLink_scaled_pressure_message(
            self._boot_ms(), s.abs_pressure, s.diff_pressure, _whole(100.0 * s.temperature, _I16)
        )

    def position_target_local_ned(self) -> Message | None:
        """POSITION_TARGET_LOCAL_NED: what the controller follows."""
        setpoint = self._flight.setpoint
        if setpoint is None:
            return None
        type_mask = 0
        values: list[float] = []
        groups = (
            (setpoint.pos_ned_m, setpoint.pos_axes),
            (setpoint.vel_ned_m_s, setpoint.vel_axes),
            (setpoint.acc_ned_m_s2, setpoint.acc_axes),
        )
        for index, (vector, axes) in enumerate(groups):
            used = axes if vector is not None else (False, False, False)
            type_mask |= sum(1 << (3 * index + axis) for axis in range(3) if not used[axis])
            values += [0.0, 0.0, 0.0] if vector is None else vector.tolist()
        if setpoint.yaw_rad is None:
            type_mask |= common.POSITION_TARGET_TYPEMASK_YAW_IGNORE
        return common.MAVLink_position_target_local_ned_message(
            self._boot_ms(), common.MAV_FRAME_LOCAL_NED, type_mask, *_singles(values),
            setpoint.yaw_rad if setpoint.yaw_rad is not None else 0.0, setpoint.yaw_rate_rad_s,
        )  # fmt: skip

    def attitude_target(self) -> Message | None:
        """ATTITUDE_TARGET: what the attitude controller follows."""
        setpoint = self._flight.attitude_setpoint
        if setpoint is None:
            return None
        return common.MAVLink_attitude_target_message(
            self._boot_ms(),
            0,
            setpoint.q_ned_frd.tolist(),
            0.0,
            0.0,
            setpoint.yaw_rate_rad_s,
            setpoint.thrust,
        )

    def servo_output_raw(self) -> Message:
        """SERVO_OUTPUT_RAW: the motors' controls as pulse widths, 1000 to 2000 us; 900 us disarmed."""
        armed = self._flight.commander.armed
        widths_us = [
            _whole(1000.0 + 1000.0 * u, _U16) if armed else 900 for u in self._flight.motors.tolist()
        ]
        return common.MAVLink_servo_output_raw_message(self._flight.now_us % 2**32, 0, *widths_us, 0, 0, 0, 0)

    def system_time(self) -> Message:
        """SYSTEM_TIME; simulated time has no calendar, so the UNIX time is given as unknown (0)."""
        return common.MAVLink_system_time_message(0, self._boot_ms())

    def autopilot_version(self) -> Message:
        """AUTOPILOT_VERSION: what this autopilot understands, and an id that differs between vehicles."""
        return common.MAVLink_autopilot_version_message(
            _CAPABILITIES, 0, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, self._system
        )

    def _boot_ms(self) -> int:
        return self._flight.now_us // 1000 % 2**32

    def _yaw_rad(self) -> float:
        return float(quat_to_euler(self._flight.state.q_ned_frd)[2])

    def _geodetic(self) -> tuple[float, float, float]:
        state = self._flight.state
        lat_deg, lon_deg, alt_m = ned_to_geodetic(
            state.pos_ned_m,
            origin_lat_deg=state.origin_lat_deg,
            origin_lon_deg=state.origin_lon_deg,
            origin_alt_m=state.origin_alt_m,
        )
        return float(lat_deg), float(lon_deg), float(alt_m)


def _pairs(telemetry: Telemetry) -> tuple[tuple[type[Message], Builder], ...]:
    """Name the messages and who forms them."""
    return (
        (common.MAVLink_heartbeat_message, telemetry.heartbeat),
        (common.MAVLink_attitude_message, telemetry.attitude),
        (common.MAVLink_attitude_quaternion_message, telemetry.attitude_quaternion),
        (common.MAVLink_local_position_ned_message, telemetry.local_position_ned),
        (common.MAVLink_global_position_int_message, telemetry.global_position_int),
        (common.MAVLink_gps_raw_int_message, telemetry.gps_raw_int),
        (common.MAVLink_gps_global_origin_message, telemetry.gps_global_origin),
        (common.MAVLink_home_position_message, telemetry.home_position),
        (common.MAVLink_extended_sys_state_message, telemetry.extended_sys_state),
        (common.MAVLink_sys_status_message, telemetry.sys_status),
        (common.MAVLink_battery_status_message, telemetry.battery_status),
        (common.MAVLink_altitude_message, telemetry.altitude),
        (common.MAVLink_vfr_hud_message, telemetry.vfr_hud),
        (common.MAVLink_odometry_message, telemetry.odometry),
        (common.MAVLink_estimator_status_message, telemetry.estimator_status),
        (common.MAVLink_highres_imu_message, telemetry.highres_imu),
        (common.MAVLink_scaled_pressure_message, telemetry.scaled_pressure),
        (common.MAVLink_position_target_local_ned_message, telemetry.position_target_local_ned),
        (common.MAVLink_attitude_target_message, telemetry.attitude_target),
        (common.MAVLink_servo_output_raw_message, telemetry.servo_output_raw),
        (common.MAVLink_system_time_message, telemetry.system_time),
        (common.MAVLink_autopilot_version_message, telemetry.autopilot_version),
    )


_CAPABILITIES = (
    common.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | common.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | common.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | common.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
)
_SENSOR_BITS = (
    (int(Condition.IMU), common.MAV_SYS_STATUS_SENSOR_3D_GYRO | common.MAV_SYS_STATUS_SENSOR_3D_ACCEL),
    (int(Condition.BARO), common.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE),
    (int(Condition.MAG), common.MAV_SYS_STATUS_SENSOR_3D_MAG),
    (int(Condition.GPS), common.MAV_SYS_STATUS_SENSOR_GPS),
    (int(Condition.ATTITUDE), common.MAV_SYS_STATUS_AHRS),
)
_HEALTH_BITS = (
    (int(Cause.MOTOR_FAILED), common.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS),
    (int(Cause.GEOFENCE), common.MAV_SYS_STATUS_GEOFENCE),
    (
        int(Cause.BATTERY_LOW | Cause.BATTERY_CRITICAL | Cause.BATTERY_EMERGENCY),
        common.MAV_SYS_STATUS_SENSOR_BATTERY,
    ),
)
_ALL_SENSORS = sum(bit for _, bit in (*_SENSOR_BITS, *_HEALTH_BITS)) | common.MAV_SYS_STATUS_PREARM_CHECK


def _mm(accuracy_cm: int) -> int:
    return 0 if accuracy_cm == _UNKNOWN_U16 else 10 * accuracy_cm


def _upper_triangle(std: list[float]) -> list[float]:
    """Row-major upper triangle of a 6 x 6 covariance whose correlations are not given."""
    variances = _singles(one * one for one in std)
    return [variances[row] if row == column else 0.0 for row in range(6) for column in range(row, 6)]


def _place(lat_deg: float, lon_deg: float, alt_m: float) -> tuple[int, int, int]:
    """Latitude and longitude in 1e-7 degrees and altitude in millimetres, as positions travel."""
    return _whole(lat_deg * 1e7, _I32), _whole(lon_deg * 1e7, _I32), _whole(alt_m * 1e3, _I32)


def _whole(value: float, limits: tuple[int, int]) -> int:
    """Nearest whole number that a field of these limits can hold; 0 for not-a-number."""
    if math.isnan(value):
        return 0
    return round(min(max(value, limits[0]), limits[1]))


def _singles(values: Iterable[float]) -> list[float]:
    """Numbers that a float32 can hold; infinities and not-a-number are among them."""
    return [
        value if -_FLOAT32_MAX <= value <= _FLOAT32_MAX or not math.isfinite(value)
        else math.copysign(_FLOAT32_MAX, value)
        for value in values
    ]  # fmt: skip
