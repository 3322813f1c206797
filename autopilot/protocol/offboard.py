"""Offboard setpoints: SET_POSITION_TARGET_LOCAL_NED turned into a TrajectorySetpoint, with the time it came.

Frames LOCAL_NED, and BODY_NED for velocities and accelerations, as PX4 takes them. A setpoint that asks for
nothing, or has numbers that are none, is dropped and counted; it does not keep offboard mode alive.
"""

import math
from collections.abc import Sequence

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.estimation.rotation import quat_to_euler
from autopilot.mavlink.codec import Message
from autopilot.protocol.flight_data import FlightData
from autopilot.protocol.service import Addressed, Listener, Partner
from autopilot.types import Array, TrajectorySetpoint

_YAW_IGNORED = common.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_YAW_RATE_IGNORED = common.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_FORCE = common.POSITION_TARGET_TYPEMASK_FORCE_SET
_ALL_AXES = (True, True, True)


class OffboardService(Listener):
    """The newest setpoint from any link."""

    takes = frozenset({common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED})

    def __init__(self, flight: FlightData) -> None:
        self._flight = flight
        self.setpoint: TrajectorySetpoint | None = None
        self.received_us: int | None = None
        self.rejected = 0

    def is_fresh(self, now_us: int, timeout_us: int) -> bool:
        """Whether a setpoint came within ``timeout_us``."""
        return self.received_us is not None and now_us - self.received_us <= timeout_us

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:  # noqa: ARG002
        """Take a setpoint; nothing is answered."""
        setpoint = self._decode(message)
        if setpoint is None:
            self.rejected += 1
        else:
            self.setpoint = setpoint
            self.received_us = now_us
        return ()

    def _decode(self, message: Message) -> TrajectorySetpoint | None:
        mask = message.type_mask
        pos, pos_axes = _group(mask, (message.x, message.y, message.z))
        vel, vel_axes = _group(mask >> 3, (message.vx, message.vy, message.vz))
        acc, acc_axes = _group(mask >> 6, (message.afx, message.afy, message.afz))
        yaw_rad = None if mask & _YAW_IGNORED else message.yaw
        yaw_rate_rad_s = 0.0 if mask & _YAW_RATE_IGNORED else message.yaw_rate
        groups = [group for group in (pos, vel, acc) if group is not None]
        finite = all(np.isfinite(group).all() for group in groups)
        if not groups or not finite or not math.isfinite(yaw_rate_rad_s) or mask & _FORCE:
            return None
        if yaw_rad is not None and not math.isfinite(yaw_rad):
            return None
        if message.coordinate_frame == common.MAV_FRAME_BODY_NED:
            if pos is not None or vel_axes[0] is not vel_axes[1] or acc_axes[0] is not acc_axes[1]:
                return None  # one of forward and right alone is no axis of NED
            vel, acc = self._from_heading(vel), self._from_heading(acc)
        elif message.coordinate_frame != common.MAV_FRAME_LOCAL_NED:
            return None
        return TrajectorySetpoint(
            pos_ned_m=pos,
            vel_ned_m_s=vel,
            acc_ned_m_s2=acc,
            pos_axes=pos_axes,
            vel_axes=vel_axes,
            acc_axes=acc_axes,
            yaw_rad=yaw_rad,
            yaw_rate_rad_s=yaw_rate_rad_s,
        )

    def _from_heading(self, vector: Array | None) -> Array | None:
        """Forward, right, down by the heading into NED."""
        if vector is None:
            return None
        yaw_rad = quat_to_euler(self._flight.state.q_ned_frd)[2]
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        return np.array([
            cos_yaw * vector[0] - sin_yaw * vector[1],
            sin_yaw * vector[0] + cos_yaw * vector[1],
            vector[2],
        ])  # fmt: skip


def _group(
    ignore_bits: int, values: tuple[float, float, float]
) -> tuple[Array | None, tuple[bool, bool, bool]]:
    """Give a group's vector, 0 on axes that the lowest three bits leave out, and the axes that count."""
    axes = (not ignore_bits & 1, not ignore_bits & 2, not ignore_bits & 4)
    if not any(axes):
        return None, _ALL_AXES
    return np.array([value if used else 0.0 for value, used in zip(values, axes, strict=True)]), axes
