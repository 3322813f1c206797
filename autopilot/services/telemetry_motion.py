"""Telemetry of position, attitude and velocity."""

import math

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.local_messages import LocalPosition
from autopilot.navigation.site_frame import geodetic
from autopilot.services.fields import I16, I32, U16, Part, place, singles, whole
from foundation.geometry.rotations import quat_rotate_inverse, quat_to_euler

_CENTIDEGREES = 36_000


class MotionTelemetry(Part):
    """Messages of the estimate, and of its reference positions."""

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

    def _yaw_rad(self) -> float:
        return float(quat_to_euler(self._flight.state.q_ned_frd)[2])


def _upper_triangle(std: list[float]) -> list[float]:
    """Row-major upper triangle of a 6 x 6 covariance without correlations."""
    variances = singles(one * one for one in std)
    return [variances[row] if row == column else 0.0 for row in range(6) for column in range(row, 6)]
