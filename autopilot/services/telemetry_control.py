"""Telemetry of controller setpoints and motor outputs."""

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.navigation.site_frame import geodetic
from autopilot.services.fields import U16, Part, place, singles, whole

_OUTPUTS = 32
"""Capacity of ACTUATOR_OUTPUT_STATUS."""


class Control(Part):
    """Messages of setpoints and outputs."""

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
        return common.MAVLink_servo_output_raw_message(self._flight.now_us % 2**32, 0, *widths_us, 0, 0, 0, 0)

    def actuator_output_status(self) -> Message:
        """ACTUATOR_OUTPUT_STATUS: number of motors, and their controls in 0..1."""
        motors = self._flight.motors()
        return common.MAVLink_actuator_output_status_message(
            self._flight.now_us, len(motors), [*motors, *[0.0] * (_OUTPUTS - len(motors))]
        )
