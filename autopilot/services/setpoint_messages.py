"""Decoding of SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT and SET_ATTITUDE_TARGET. Pure.

Masks and frames are interpreted as in PX4, offset frames as in MAVLink: positions are relative to the
vehicle's position when the message arrives. Yaw is a heading from north in every frame. A message that
requests nothing that can be flown, or contains invalid numbers, is no setpoint.
"""

import math
from collections.abc import Sequence

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.navigation.site_frame import horizontal_ned_m
from autopilot.services.command import AMSL_FRAMES, RELATIVE_FRAMES
from autopilot.services.flight_data import FlightData
from foundation.geometry.rotations import quat_to_euler
from foundation.types import (
    AttitudeSetpoint,
    EstimatorState,
    RateSetpoint,
    Setpoint,
    TrajectorySetpoint,
    Vector,
)

_LOCAL = common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
_GLOBAL = common.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
_ATTITUDE = common.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET
SETPOINT_MESSAGES = frozenset({_LOCAL, _GLOBAL, _ATTITUDE})

_FORCE = common.POSITION_TARGET_TYPEMASK_FORCE_SET
_YAW_IGNORED = common.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_YAW_RATE_IGNORED = common.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_BY_HEADING = frozenset({common.MAV_FRAME_BODY_NED, common.MAV_FRAME_BODY_OFFSET_NED})
_FROM_HERE = frozenset({common.MAV_FRAME_LOCAL_OFFSET_NED, common.MAV_FRAME_BODY_OFFSET_NED})
_LOCAL_NED = int(common.MAV_FRAME_LOCAL_NED)

_ROLL_PITCH_RATE_IGNORED = (
    common.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
    | common.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
)
_BODY_YAW_RATE_IGNORED = common.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
_THRUST_BODY = 32
"""ATTITUDE_TARGET_TYPEMASK_THRUST_BODY_SET"""
_THRUST_IGNORED = common.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE
_ATTITUDE_IGNORED = common.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE
_GREATEST = 1e9
"""Largest magnitude of any value, in its unit; larger ones would exceed the range of telemetry's fields."""
_NORM_ERROR_MAX = 0.1
"""Largest error of a quaternion's norm, which is then normalised; beyond it the message is invalid"""

_Axes = tuple[bool, bool, bool]
_Group = tuple[Vector | None, _Axes]
"""Vector, 0 on unused axes, and the axes that are used."""
_Motion = tuple[Vector, Vector, float, float]
"""Velocity, acceleration, yaw and yaw rate of a message, regardless of its mask."""
_AXES: tuple[_Axes, ...] = tuple((not bits & 1, not bits & 2, not bits & 4) for bits in range(8))
"""Used axes by the three ignore bits."""
_ALL_AXES, _NO_AXES = _AXES[0], _AXES[7]


def decode(message: Message, flight: FlightData) -> Setpoint | None:
    """Setpoint of one of `SETPOINT_MESSAGES`; None if it cannot be flown."""
    if isinstance(message, PositionTarget):
        return _local_target(message, flight.state)
    kind = message.get_msgId()
    if kind == _ATTITUDE:
        return _attitude(message)
    if kind == _LOCAL:
        fields = [getattr(message, name) for name in PositionTarget._fields]
        return _local_target(PositionTarget(*fields), flight.state)
    pos = _global_position(message, flight)
    if pos is None:
        return None
    m = message
    motion = (m.vx, m.vy, m.vz), (m.afx, m.afy, m.afz), m.yaw, m.yaw_rate
    return _trajectory(message.type_mask, pos, motion, flight.state, by_heading=False)


# ---- positions, velocities, accelerations


def _local_target(target: PositionTarget, state: EstimatorState) -> TrajectorySetpoint | None:
    # unpacked as a whole: access to each field by name is slower
    _, _, _, frame, mask, x, y, z, vx, vy, vz, afx, afy, afz, yaw, yaw_rate = target
    given = _group(mask, (x, y, z))
    pos = given if frame == _LOCAL_NED else _position(frame, given, state)
    if pos is None:
        return None
    motion = (vx, vy, vz), (afx, afy, afz), yaw, yaw_rate
    return _trajectory(mask, pos, motion, state, by_heading=frame in _BY_HEADING)


def _trajectory(
    mask: int, pos: _Group, motion: _Motion, state: EstimatorState, *, by_heading: bool
) -> TrajectorySetpoint | None:
    velocity, acceleration, yaw, yaw_rate = motion
    vel, acc = _group(mask >> 3, velocity), _group(mask >> 6, acceleration)
    yaw_rad = None if mask & _YAW_IGNORED else yaw
    yaw_rate_rad_s = 0.0 if mask & _YAW_RATE_IGNORED else yaw_rate
    numbers = (*(pos[0] or ()), *(vel[0] or ()), *(acc[0] or ()))
    if not numbers or (mask & _FORCE and acc[0] is not None):
        return None
    if not _are_sane((*numbers, 0.0 if yaw_rad is None else yaw_rad, yaw_rate_rad_s)):
        return None
    if by_heading:
        if not (_turns(vel) and _turns(acc)):
            return None
        vel, acc = _by_heading(vel, state), _by_heading(acc, state)
    return TrajectorySetpoint(
        pos_ned_m=pos[0],
        vel_ned_m_s=vel[0],
        acc_ned_m_s2=acc[0],
        pos_axes=pos[1],
        vel_axes=vel[1],
        acc_axes=acc[1],
        yaw_rad=yaw_rad,
        yaw_rate_rad_s=yaw_rate_rad_s,
    )


def _position(frame: int, group: _Group, state: EstimatorState) -> _Group | None:
    """Convert a position in a local frame other than LOCAL_NED to one from the estimator's origin.

    None if the frame is unknown or the estimate that it requires is not valid.
    """
    if frame not in _BY_HEADING | _FROM_HERE or (frame in _BY_HEADING and not state.attitude_valid):
        return None
    pos, axes = group
    if pos is None:
        return group
    if frame == common.MAV_FRAME_BODY_NED or not _is_located(state, axes):
        return None  # PX4 does not support positions in BODY_NED
    if frame == common.MAV_FRAME_BODY_OFFSET_NED:
        if not _turns(group):
            return None
        pos = _to_ned(pos, state)
    north_m, east_m, down_m = np.where(axes, state.pos_ned_m, 0.0).tolist()
    return (north_m + pos[0], east_m + pos[1], down_m + pos[2]), axes


def _global_position(message: Message, flight: FlightData) -> _Group | None:
    """Convert degrees and an altitude above sea level or home to a position from the estimator's origin."""
    frame, state, home = message.coordinate_frame, flight.state, flight.home
    if frame not in AMSL_FRAMES | RELATIVE_FRAMES:
        return None
    lat_deg, lon_deg = message.lat_int * 1e-7, message.lon_int * 1e-7
    group = _group(message.type_mask, (lat_deg, lon_deg, message.alt))
    target, axes = group
    if target is None:
        return group
    if axes[0] is not axes[1] or not state.position_valid:
        return None  # one of the two is no position, and both require an origin
    if axes[0] and not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        return None  # INT32_MAX is MAVLink's mark of a coordinate that is not given
    north_m = east_m = down_m = 0.0
    if axes[0]:
        north_m, east_m = horizontal_ned_m(lat_deg, lon_deg, state).tolist()
    if axes[2]:
        if frame in RELATIVE_FRAMES and home is None:
            return None
        zero_amsl_m = home.alt_m if frame in RELATIVE_FRAMES and home is not None else 0.0
        down_m = state.origin_alt_m - (zero_amsl_m + message.alt)
    return (north_m, east_m, down_m), axes


def _group(ignore_bits: int, values: Vector) -> _Group:
    """Select the values of a group by the lowest three ignore bits."""
    axes = _AXES[ignore_bits & 7]
    if axes is _ALL_AXES:
        return values, axes
    if axes is _NO_AXES:
        return None, _ALL_AXES
    x, y, z = values
    return (x if axes[0] else 0.0, y if axes[1] else 0.0, z if axes[2] else 0.0), axes


def _are_sane(numbers: Sequence[float]) -> bool:
    for number in numbers:  # noqa: SIM110 - a generator expression would double the time
        if not -_GREATEST <= number <= _GREATEST:  # also refuses NaN
            return False
    return True


def _turns(group: _Group) -> bool:
    """Whether it can be rotated by a heading: forward or right alone is not an axis of NED."""
    return group[1][0] is group[1][1]


def _is_located(state: EstimatorState, axes: tuple[bool, bool, bool]) -> bool:
    return (state.position_valid or not (axes[0] or axes[1])) and (state.height_valid or not axes[2])


def _by_heading(group: _Group, state: EstimatorState) -> _Group:
    return group if group[0] is None else (_to_ned(group[0], state), group[1])


def _to_ned(vector: Vector, state: EstimatorState) -> Vector:
    """Rotate forward, right, down by the heading into NED."""
    yaw_rad = quat_to_euler(state.q_ned_frd)[2]
    cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
    x, y, z = vector
    return cos_yaw * x - sin_yaw * y, sin_yaw * x + cos_yaw * y, z


# ---- attitudes and rates


def _attitude(message: Message) -> AttitudeSetpoint | RateSetpoint | None:
    """Attitude with a yaw rate, or body rates, depending on the mask; thrust is required.

    Of a thrust vector only the component along -z is used, the only one that rotors produce. A yaw rate that
    is left out is 0. If attitude and body rates are given, roll and pitch rates are ignored, as in PX4.
    """
    mask = message.type_mask
    thrust = -message.thrust_body[2] if mask & _THRUST_BODY else message.thrust
    if (mask & _THRUST_IGNORED and not mask & _THRUST_BODY) or not math.isfinite(thrust):
        return None
    thrust = min(max(thrust, 0.0), 1.0)
    yaw_rate_rad_s = 0.0 if mask & _BODY_YAW_RATE_IGNORED else message.body_yaw_rate
    if not abs(yaw_rate_rad_s) <= _GREATEST:
        return None
    if not mask & _ATTITUDE_IGNORED:
        q_ned_frd = np.array(message.q, float)
        norm = math.sqrt(q_ned_frd @ q_ned_frd)
        if not abs(norm - 1.0) <= _NORM_ERROR_MAX:  # also refuses NaN
            return None
        return AttitudeSetpoint(q_ned_frd=q_ned_frd / norm, yaw_rate_rad_s=yaw_rate_rad_s, thrust=thrust)
    rate_frd_rad_s = np.array((message.body_roll_rate, message.body_pitch_rate, yaw_rate_rad_s))
    if mask & _ROLL_PITCH_RATE_IGNORED or not _are_sane(rate_frd_rad_s.tolist()):
        return None
    return RateSetpoint(rate_frd_rad_s=rate_frd_rad_s, thrust=thrust)
