"""Position and velocity control: trajectory setpoint to attitude and collective thrust.

PX4's structure (mc_pos_control): P on position, PID on velocity with acceleration feed-forward, conversion of
acceleration to thrust by the hover thrust, and limits with priority of the vertical over the horizontal.
"""

import math
from struct import Struct
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import PositionParams
from foundation.geometry.rotations import quat_from_dcm
from foundation.kernels.inner import inner
from foundation.kernels.records import Records
from foundation.types import Array, EstimatorState, TrajectorySetpoint

LEAST_THRUST = 1e-6
"""As a fraction of full thrust; a smaller thrust vector has no defined direction."""


_Axes = Annotated[NDArray[np.uint8], 3]
"""1 on the axes with a setpoint."""


class PositionSetpoint:
    """Record: a trajectory setpoint without the axes for which the estimate is invalid."""

    pos_ned_m: Annotated[Array, 3]
    vel_ned_m_s: Annotated[Array, 3]
    acc_ned_m_s2: Annotated[Array, 3]
    pos_axes: _Axes
    vel_axes: _Axes
    acc_axes: _Axes


class PositionSettings:
    """Record: gains per axis, NED, and limits of the parameters' names."""

    pos_p: Annotated[Array, 3]
    vel_p: Annotated[Array, 3]
    vel_i: Annotated[Array, 3]
    vel_d: Annotated[Array, 3]
    tilt_max_rad: float
    thr_min: float
    thr_max: float
    thr_xy_margin: float
    vel_xy_max_m_s: float
    vel_up_max_m_s: float
    vel_down_max_m_s: float
    acc_cutoff_hz: float


class PositionOutput:
    """Record: results of the last update."""

    vel_ned_m_s: Annotated[Array, 3]
    """Velocity setpoint; 0 on axes without velocity control."""
    acc_ned_m_s2: Annotated[Array, 3]
    """Acceleration setpoint over ground, before the disturbance is subtracted."""
    thrust_ned: Annotated[Array, 3]
    """Fraction of full thrust, like the collective thrust."""
    thrust: float
    q_ned_frd: Annotated[Array, 4]
    """Attitude setpoint."""


class Position:
    """Record: all of position and velocity control."""

    settings: PositionSettings
    setpoint: PositionSetpoint
    integral_ned_m_s2: Annotated[Array, 3]
    acc_filtered_ned_m_s2: Annotated[Array, 3]
    output: PositionOutput


@inner
def _velocity_setpoint(position: Position, pos: Array, up_max: float) -> Array:
    """Return the velocity setpoint (3,), NED: position error times gain, plus limited feed-forward."""
    setpoint, settings = position.setpoint, position.settings
    xy_max, down_max = settings.vel_xy_max_m_s, settings.vel_down_max_m_s
    vel = np.zeros(3)
    feed = np.zeros(3)
    for i in range(3):
        if setpoint.pos_axes[i]:
            vel[i] = (setpoint.pos_ned_m[i] - pos[i]) * settings.pos_p[i]
        if setpoint.vel_axes[i]:
            feed[i] = setpoint.vel_ned_m_s[i]
    speed = math.hypot(vel[0], vel[1])
    if speed >= xy_max:
        vel[0] *= xy_max / speed
        vel[1] *= xy_max / speed
    else:
        # the largest s <= 1 with |vel + s feed| <= xy_max
        s = 1.0
        if math.hypot(vel[0] + feed[0], vel[1] + feed[1]) > xy_max:
            a = feed[0] * feed[0] + feed[1] * feed[1]
            b = vel[0] * feed[0] + vel[1] * feed[1]
            s = (-b + math.sqrt(b * b + a * (xy_max * xy_max - speed * speed))) / a
        vel[0] += s * feed[0]
        vel[1] += s * feed[1]
    vel[2] = max(min(vel[2] + feed[2], down_max), -up_max)
    return vel


@inner
def _limited_thrust(
    settings: PositionSettings, acc: Array, hover: float
) -> tuple[tuple[float, float, float], bool]:
    """Return the NED thrust vector, and whether its horizontal part is limited.

    ``acc`` is the acceleration over ground. The tilt follows from the horizontal acceleration as if the
    vertical thrust were equal to the weight (MPC_ACC_DECOUPLE), so a climb does not change it. The horizontal
    margin is limited to the horizontal part of full thrust at the greatest tilt: a greater one would reduce
    vertical thrust without effect.
    """
    thr_min, thr_max, tilt_max = settings.thr_min, settings.thr_max, settings.tilt_max_rad
    steepest = math.tan(tilt_max)
    demanded_tan = math.hypot(acc[0], acc[1]) / GRAVITY_M_S2
    tilt_tan = min(demanded_tan, steepest)
    cosine = 1.0 / math.sqrt(1.0 + tilt_tan * tilt_tan)
    up = max(hover * (1.0 - acc[2] / GRAVITY_M_S2), thr_min * cosine)
    unlimited = up * demanded_tan
    horizontal = up * tilt_tan
    kept = min(horizontal, settings.thr_xy_margin, thr_max * math.sin(tilt_max))
    up = min(up, math.sqrt(thr_max * thr_max - kept * kept))
    horizontal = min(horizontal, math.sqrt(max(thr_max * thr_max - up * up, 0.0)), up * steepest)
    north, east = 0.0, 0.0
    if demanded_tan > 0.0:
        north = horizontal * acc[0] / (GRAVITY_M_S2 * demanded_tan)
        east = horizontal * acc[1] / (GRAVITY_M_S2 * demanded_tan)
    return (north, east, -up), horizontal < unlimited * (1.0 - 1e-9)


@inner
def _attitude(thrust_ned: tuple[float, float, float], yaw_rad: float) -> Array:
    """Return q_ned_frd (4,) with -z along the thrust and x along the heading; level if no thrust."""
    norm = math.sqrt(
        thrust_ned[0] * thrust_ned[0] + thrust_ned[1] * thrust_ned[1] + thrust_ned[2] * thrust_ned[2]
    )
    z0, z1, z2 = 0.0, 0.0, 1.0
    if norm > LEAST_THRUST:
        z0, z1, z2 = -thrust_ned[0] / norm, -thrust_ned[1] / norm, -thrust_ned[2] / norm
    # x = (horizontal, right of the heading) x z: perpendicular to both; the tilt limit keeps z2 > 0
    x0, x1 = math.cos(yaw_rad) * z2, math.sin(yaw_rad) * z2
    x2 = -math.sin(yaw_rad) * z1 - math.cos(yaw_rad) * z0
    length = math.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    x0, x1, x2 = x0 / length, x1 / length, x2 / length
    dcm = np.empty((3, 3))
    dcm[0, 0], dcm[1, 0], dcm[2, 0] = x0, x1, x2
    dcm[0, 1], dcm[1, 1], dcm[2, 1] = z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0
    dcm[0, 2], dcm[1, 2], dcm[2, 2] = z0, z1, z2
    return quat_from_dcm(dcm)


@inner
def integral_shift_m_s2(old_hover: float, new_hover: float, acc_down_m_s2: float) -> float:
    """Return the change of the vertical integral that keeps thrust constant for a new hover thrust.

    Thrust is hover (g - acc) / g; it is equal before and after if acc changes by (g - acc)(1 - old / new).
    """
    return (GRAVITY_M_S2 - acc_down_m_s2) * (1.0 - old_hover / new_hover)


@inner
def control_position(
    position: Position, pos: Array, vel: Array, acc: Array, disturbance: Array, hover: float, yaw_rad: float,
    climb_max: float, dt_s: float,
) -> None:  # fmt: skip
    """Compute the output from the setpoint, the estimate and the disturbance, (3,) each, NED.

    An axis without setpoint keeps its velocity (acceleration 0). ``climb_max`` limits the climb in m/s in
    addition to the settings; it is negative early in the take-off ramp.
    """
    setpoint, settings, output = position.setpoint, position.settings, position.output
    integral, acc_filtered = position.integral_ned_m_s2, position.acc_filtered_ned_m_s2
    alpha = 1.0 - math.exp(-2.0 * math.pi * settings.acc_cutoff_hz * dt_s)
    for i in range(3):
        acc_filtered[i] += alpha * (acc[i] - acc_filtered[i])
    vel_sp = _velocity_setpoint(position, pos, min(settings.vel_up_max_m_s, climb_max))
    acc_sp = np.zeros(3)
    error = np.zeros(3)
    for i in range(3):
        if setpoint.acc_axes[i]:
            acc_sp[i] = setpoint.acc_ned_m_s2[i]
        if setpoint.pos_axes[i] or setpoint.vel_axes[i]:
            error[i] = vel_sp[i] - vel[i]
            damped = settings.vel_d[i] * (acc_sp[i] - acc_filtered[i])
            acc_sp[i] += settings.vel_p[i] * error[i] + integral[i] + damped
    demand = np.empty(3)
    for i in range(3):
        demand[i] = acc_sp[i] - disturbance[i]
    thrust, cut = _limited_thrust(settings, demand, hover)

    # anti-windup: while thrust is limited, the integral does not follow an error that demands more
    collective = math.sqrt(thrust[0] * thrust[0] + thrust[1] * thrust[1] + thrust[2] * thrust[2])
    at_least = collective <= settings.thr_min * (1.0 + 1e-9)
    at_most = collective >= settings.thr_max * (1.0 - 1e-9)
    if (at_least and error[2] > 0.0) or (at_most and error[2] < 0.0):
        error[2] = 0.0
    squared = demand[0] * demand[0] + demand[1] * demand[1]
    if cut and squared > 0.0:
        along = error[0] * demand[0] + error[1] * demand[1]
        more = max(along, 0.0) / squared
        error[0] -= more * demand[0]
        error[1] -= more * demand[1]
    for i in range(3):
        if setpoint.pos_axes[i] or setpoint.vel_axes[i]:
            integral[i] += error[i] * settings.vel_i[i] * dt_s
            integral[i] = min(max(integral[i], -GRAVITY_M_S2), GRAVITY_M_S2)
        output.vel_ned_m_s[i], output.acc_ned_m_s2[i], output.thrust_ned[i] = vel_sp[i], acc_sp[i], thrust[i]
    output.thrust = collective
    attitude = _attitude(thrust, yaw_rad)
    for i in range(4):
        output.q_ned_frd[i] = attitude[i]


_NO_AXES = (False, False, False)
_ZERO = (0.0, 0.0, 0.0)
_SETPOINT = Struct("=9d9?")
"""`PositionSetpoint`, packed at once because single writes to a record are slow."""


class PositionController:
    """Settings, setpoint and resets of the record; ``integral_share`` scales the I gains."""

    def __init__(self, params: PositionParams, *, integral_share: float = 1.0, records: Records) -> None:
        """``records`` is (1,) of `Position`."""
        record: Position = records[0]
        self._record = record
        self.integral_ned_m_s2 = record.integral_ned_m_s2
        """(3,) view"""
        self._setpoint = record.setpoint
        self._setpoint_octets = records["setpoint"].view(np.uint8).data
        self.set_params(params, integral_share=integral_share)
        self._taken: tuple[TrajectorySetpoint, bool, bool, bool] | None = None
        """Setpoint and validity flags that the record was written from."""

    def set_params(self, params: PositionParams, *, integral_share: float = 1.0) -> None:
        """Change the settings, in effect from the next update; integrals and acceleration filter are kept."""
        p, settings = params, self._record.settings
        settings.pos_p[:] = (p.xy_p, p.xy_p, p.z_p)
        settings.vel_p[:] = (p.xy_vel_p_acc, p.xy_vel_p_acc, p.z_vel_p_acc)
        settings.vel_i[:] = (p.xy_vel_i_acc, p.xy_vel_i_acc, p.z_vel_i_acc)
        settings.vel_i *= integral_share
        settings.vel_d[:] = (p.xy_vel_d_acc, p.xy_vel_d_acc, p.z_vel_d_acc)
        settings.tilt_max_rad, settings.acc_cutoff_hz = p.tilt_max_rad, p.acc_cutoff_hz
        settings.thr_min, settings.thr_max, settings.thr_xy_margin = p.thr_min, p.thr_max, p.thr_xy_margin
        settings.vel_xy_max_m_s = p.xy_vel_max_m_s
        settings.vel_up_max_m_s, settings.vel_down_max_m_s = p.z_vel_max_up_m_s, p.z_vel_max_dn_m_s

    def reset(self) -> None:
        """Reset the integrators and the acceleration filter."""
        self.integral_ned_m_s2[:] = 0.0
        self._record.acc_filtered_ned_m_s2[:] = 0.0

    def take(self, state: EstimatorState, setpoint: TrajectorySetpoint) -> None:
        """Write a changed setpoint to the record, without the axes for which the estimate is invalid.

        Without a valid position the position axes follow the velocity setpoint, or stop; without a valid
        velocity only the acceleration is used. A valid height implies a valid vertical velocity.
        """
        taken = self._taken
        if (
            taken is not None
            and taken[0] is setpoint
            and taken[1:] == (state.position_valid, state.height_valid, state.velocity_valid)
        ):
            return
        self._taken = (setpoint, state.position_valid, state.height_valid, state.velocity_valid)
        pos, vel, acc = setpoint.pos_ned_m, setpoint.vel_ned_m_s, setpoint.acc_ned_m_s2
        _SETPOINT.pack_into(
            self._setpoint_octets, 0,
            *(_ZERO if pos is None else pos),
            *(_ZERO if vel is None else vel),
            *(_ZERO if acc is None else acc),
            *(_NO_AXES if pos is None else setpoint.pos_axes),
            *(_NO_AXES if vel is None else setpoint.vel_axes),
            *(_NO_AXES if acc is None else setpoint.acc_axes),
        )  # fmt: skip
        written = self._setpoint
        if not (state.position_valid and state.height_valid):
            for i, valid in enumerate((state.position_valid, state.position_valid, state.height_valid)):
                if written.pos_axes[i] and not valid:
                    if not written.vel_axes[i]:
                        written.vel_ned_m_s[i] = 0.0
                    written.vel_axes[i], written.pos_axes[i] = True, False
        if not state.velocity_valid:
            # the vertical one comes from barometer and accelerometer and is valid as long as the height is
            written.pos_axes[:2] = written.vel_axes[:2] = False
            written.pos_axes[2] &= state.height_valid
            written.vel_axes[2] &= state.height_valid
