"""High-rate messages between an autopilot and an application in one process, as plain values.

pymavlink's objects take longer to construct than to process. Fields have pymavlink's names, so these classes
can replace pymavlink's messages. `autopilot.mavlink.telemetry` packs the setpoint where a link is between the
two.
"""

from typing import NamedTuple

from pymavlink.dialects.v20 import common


class LocalPosition(NamedTuple):
    """LOCAL_POSITION_NED: m and m/s from the estimator's origin."""

    time_boot_ms: int
    x: float
    y: float
    z: float
    vx: float
    vy: float
    vz: float

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return int(common.MAVLINK_MSG_ID_LOCAL_POSITION_NED)

    def get_type(self) -> str:
        """Return the message name."""
        return "LOCAL_POSITION_NED"


class PositionTarget(NamedTuple):
    """SET_POSITION_TARGET_LOCAL_NED: position, velocity, acceleration, and the mask of ignored values."""

    time_boot_ms: int
    target_system: int
    target_component: int
    coordinate_frame: int
    type_mask: int
    x: float
    y: float
    z: float
    vx: float
    vy: float
    vz: float
    afx: float = 0.0
    afy: float = 0.0
    afz: float = 0.0
    yaw: float = 0.0
    yaw_rate: float = 0.0

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return int(common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED)

    def get_type(self) -> str:
        """Return the message name."""
        return "SET_POSITION_TARGET_LOCAL_NED"
