"""Telemetry of position, attitude and velocity, of their setpoints and of the motors."""

import math

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.local_messages import LocalPosition
from autopilot.navigation.site_frame import geodetic
from autopilot.services.fields import I16, I32, U16, Part, place, singles, whole
from foundation.geometry.rotations import quat_rotate_inverse, quat_to_euler

_CENTIDEGREES = 36_000
_OUTPUTS = 32
"""Capacity of ACTUATOR_OUTPUT_STATUS."""
_SERVOS = 8
"""Outputs of SERVO_OUTPUT_RAW without its extension."""


class MotionTelemetry(Part):
    """Messages of the estimate and its reference positions, of setpoints and motor outputs."""

    def attitude(self) -> Message | None:
        """ATTITUDE."""
        state = self._flight.state
        if not state.attitude_valid:
            return None
        return common.MAVLink_attitude_message(
            self.boot_ms(), *quat_to_euler(state.q_ned_frd).tolist(), *state.omega_frd_rad_s.tolist()
        )

    def attitude_quaternion(self) -> Message | None:
        """ATTITUDE_QUATERNION."""
        state = self._flight.state
        if not state.attitude_valid:
            return None
        return common.MAVLink_attitude_quaternion_message(
            self.boot_ms(), *state.q_ned_frd.tolist(), *state.omega_frd_rad_s.tolist()
        )

    def local_position_ned(self) -> Message | None:
        """LOCAL_POSITION_NED."""
        position = self.local_position()
        return None if position is None else common.MAVLink_local_position_ned_message(*position)

    def local_position(self) -> LocalPosition | None:
        """Return the same as a plain value for an application in this process."""
        state = self._flight.state
        if not (state.position_valid and state.height_valid):
            return None
        return LocalPosition(self.boot_ms(), *singles(state.pos_ned_m.tolist() + state.vel_ned_m_s.tolist()))

    def global_position_int(self) -> Message | None:
        """GLOBAL_POSITION_INT."""
        state = self._flight.state
        if not (state.position_valid and state.height_valid):
            return None
        lat_deg, lon_deg, alt_m = geodetic(state.pos_ned_m, state)
        home = self._flight.home
        relative_m = alt_m - (home.alt_m if home is not None else state.origin_alt_m)
        north, east, down = (whole(100.0 * v, I16) for v in state.vel_ned_m_s.tolist())
        heading_cdeg = whole(math.degrees(self._yaw_rad()) * 100.0, I32) % _CENTIDEGREES
        return common.MAVLink_global_position_int_message(
            self.boot_ms(), *place(lat_deg, lon_deg, alt_m), whole(relative_m * 1e3, I32),
            north, east, down, heading_cdeg,
        )  # fmt: skip

    def odometry(self) -> Message | None:
        """ODOMETRY: pose in the local NED frame, velocity in the body frame, as in PX4."""
        state = self._flight.state
        if not (state.position_valid and state.attitude_valid):
            return None
        vel_frd_m_s = quat_rotate_inverse(state.q_ned_frd, state.vel_ned_m_s)
        return common.MAVLink_odometry_message(
            self._flight.now_us, common.MAV_FRAME_LOCAL_NED, common.MAV_FRAME_BODY_FRD,
            *singles(state.pos_ned_m.tolist()), state.q_ned_frd.tolist(),
            *singles(vel_frd_m_s.tolist()), *state.omega_frd_rad_s.tolist(),
            _upper_triangle(state.pos_std_m.tolist() + state.attitude_std_rad.tolist()),
            _upper_triangle(state.vel_std_m_s.tolist() + [math.nan] * 3),
            state.reset_counter % 256, common.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        )  # fmt: skip

    def altitude(self) -> Message | None:
        """ALTITUDE."""
        state = self._flight.state
        if not (state.height_valid and self._flight.origin_known):
            return None
        local_m = -float(state.pos_ned_m[2])
        amsl_m = state.origin_alt_m + local_m
        relative_m = amsl_m - self._flight.home.alt_m if self._flight.home is not None else local_m
        amsl_m, local_m, relative_m = singles((amsl_m, local_m, relative_m))
        return common.MAVLink_altitude_message(
            self._flight.now_us, amsl_m, amsl_m, local_m, relative_m, math.nan, math.nan
        )

    def vfr_hud(self) -> Message | None:
        """VFR_HUD."""
        state = self._flight.state
        if not (state.velocity_valid and self._flight.origin_known):
            return None
        north, east, down = state.vel_ned_m_s.tolist()
        attitude = self._flight.attitude_setpoint()
        thrust = attitude.thrust if attitude is not None else 0.0
        speed_m_s, alt_m, climb_m_s = singles(
            (math.hypot(north, east), state.origin_alt_m - float(state.pos_ned_m[2]), -down)
        )
        return common.MAVLink_vfr_hud_message(
            0.0, speed_m_s, whole(math.degrees(self._yaw_rad()), I16) % 360, whole(100.0 * thrust, U16),
            alt_m, climb_m_s,
        )  # fmt: skip

    def home_position(self) -> Message | None:
        """HOME_POSITION."""
        home = self._flight.home
        if home is None:
            return None
        return common.MAVLink_home_position_message(
            *place(home.lat_deg, home.lon_deg, home.alt_m),
            *singles(home.pos_ned_m), home.q_ned_frd, 0.0, 0.0, 0.0, self._flight.now_us,
        )  # fmt: skip

    def gps_global_origin(self) -> Message | None:
        """GPS_GLOBAL_ORIGIN of the local frame."""
        if not self._flight.origin_known:
            return None
        state = self._flight.state
        return common.MAVLink_gps_global_origin_message(
            *place(state.origin_lat_deg, state.origin_lon_deg, state.origin_alt_m), self._flight.now_us
        )

    def estimator_status(self) -> Message | None:
        """ESTIMATOR_STATUS: validity flags, innovation test ratios and standard deviations."""
        state, fusion = self._flight.state, self._flight.estimator.fusion
        if fusion is None:
            return None
        glitch = max(fusion.velocity.test_ratio, fusion.position.test_ratio) >= 1.0
        flags = sum(
            bit
            for valid, bit in (
                (state.attitude_valid, common.ESTIMATOR_ATTITUDE),
                (state.velocity_valid, common.ESTIMATOR_VELOCITY_HORIZ | common.ESTIMATOR_VELOCITY_VERT),
                (state.position_valid, common.ESTIMATOR_POS_HORIZ_REL | common.ESTIMATOR_POS_HORIZ_ABS),
                (state.height_valid, common.ESTIMATOR_POS_VERT_ABS),
                (fusion.held_pos_m is not None, common.ESTIMATOR_CONST_POS_MODE),
                (glitch, common.ESTIMATOR_GPS_GLITCH),
                (fusion.vertical.bad, common.ESTIMATOR_ACCEL_ERROR),
            )
            if valid
        )
        north_m, east_m, down_m = state.pos_std_m.tolist()
        ratios = [of.test_ratio for of in (fusion.velocity, fusion.position, fusion.height, fusion.heading)]
        return common.MAVLink_estimator_status_message(
            self._flight.now_us, flags, *singles(ratios), math.nan, math.nan,
            *singles((math.hypot(north_m, east_m), down_m)),
        )  # fmt: skip

    def position_target_local_ned(self) -> Message | None:
        """POSITION_TARGET_LOCAL_NED: setpoint of the position controller."""
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
            values += (0.0, 0.0, 0.0) if vector is None else map(float, vector)
        if setpoint.yaw_rad is None:
            type_mask |= common.POSITION_TARGET_TYPEMASK_YAW_IGNORE
        return common.MAVLink_position_target_local_ned_message(
            self.boot_ms(), common.MAV_FRAME_LOCAL_NED, type_mask, *singles(values),
            setpoint.yaw_rad if setpoint.yaw_rad is not None else 0.0, setpoint.yaw_rate_rad_s,
        )  # fmt: skip

    def position_target_global_int(self) -> Message | None:
        """POSITION_TARGET_GLOBAL_INT: the same in geodetic coordinates, which are 0 without a position."""
        local, setpoint, state = self.position_target_local_ned(), self._flight.setpoint, self._flight.state
        if local is None or setpoint is None or not self._flight.origin_known:
            return None
        lat_e7, lon_e7, alt_m = 0, 0, 0.0
        if setpoint.pos_ned_m is not None:
            lat_deg, lon_deg, alt = geodetic(np.array(setpoint.pos_ned_m), state)
            lat_e7, lon_e7, _ = place(lat_deg, lon_deg, alt)
            (alt_m,) = singles((alt,))
        return common.MAVLink_position_target_global_int_message(
            local.time_boot_ms, common.MAV_FRAME_GLOBAL_INT, local.type_mask, lat_e7, lon_e7, alt_m,
            local.vx, local.vy, local.vz, local.afx, local.afy, local.afz, local.yaw, local.yaw_rate,
        )  # fmt: skip

    def attitude_target(self) -> Message | None:
        """ATTITUDE_TARGET: setpoint of the attitude controller."""
        setpoint = self._flight.attitude_setpoint()
        if setpoint is None:
            return None
        return common.MAVLink_attitude_target_message(
            self.boot_ms(), 0, setpoint.q_ned_frd.tolist(), 0.0, 0.0, setpoint.yaw_rate_rad_s, setpoint.thrust
        )

    def servo_output_raw(self) -> Message:
        """SERVO_OUTPUT_RAW: the motors' controls as pulse widths, 1000 to 2000 us; 900 us disarmed."""
        armed = self._flight.commander.armed
        widths_us = [whole(1000.0 + 1000.0 * u, U16) if armed else 900 for u in self._flight.motors()]
        unused = [0] * (_SERVOS - len(widths_us))
        return common.MAVLink_servo_output_raw_message(self._flight.now_us % 2**32, 0, *widths_us, *unused)

    def actuator_output_status(self) -> Message:
        """ACTUATOR_OUTPUT_STATUS: number of motors, and their controls in 0..1."""
        motors = self._flight.motors()
        return common.MAVLink_actuator_output_status_message(
            self._flight.now_us, len(motors), [*motors, *[0.0] * (_OUTPUTS - len(motors))]
        )

    def _yaw_rad(self) -> float:
        return float(quat_to_euler(self._flight.state.q_ned_frd)[2])


def _upper_triangle(std: list[float]) -> list[float]:
    """Row-major upper triangle of a 6 x 6 covariance without correlations."""
    variances = singles(one * one for one in std)
    return [variances[row] if row == column else 0.0 for row in range(6) for column in range(row, 6)]
