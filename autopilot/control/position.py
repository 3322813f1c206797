"""Position and velocity control: trajectory setpoint to attitude and collective thrust.

PX4's structure (mc_pos_control): P on position, PID on velocity with acceleration feed-forward, conversion of
acceleration to thrust by the hover thrust, and limits with priority of the vertical over the horizontal.
"""

import math
from struct import Struct

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.control.block import Block, new_block
from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import PositionParams
from foundation.geometry.rotations import quat_from_dcm
from foundation.types import Array, AttitudeSetpoint, EstimatorState, TrajectorySetpoint

# rows of the results of `control_position`, and the column of the thrust's magnitude
VELOCITY, ACCELERATION, THRUST, ATTITUDE = range(4)
COLLECTIVE = 3
# rows of its memory
INTEGRAL, ACC_FILTERED = range(2)
# its limits
TILT_MAX, THR_MIN, THR_MAX, THR_XY_MARGIN, VEL_XY_MAX, VEL_UP_MAX, VEL_DOWN_MAX, ACC_CUTOFF = range(8)
LEAST_THRUST = 1e-6
"""As a fraction of full thrust; a smaller thrust vector has no defined direction."""


@njit(cache=True)
def _velocity_setpoint(
    setpoint: Array,
    mask: NDArray[np.bool_],
    pos: Array,
    gain: Array,
    xy_max: float,
    up_max: float,
    down_max: float,
) -> Array:
    """Return the velocity setpoint (3,), NED: position error times gain, plus feed-forward within the limits.

    ``setpoint`` and ``mask`` (3, 3): rows position, velocity, acceleration.
    """
    vel = np.zeros(3)
    feed = np.zeros(3)
    for i in range(3):
        if mask[0, i]:
            vel[i] = (setpoint[0, i] - pos[i]) * gain[i]
        if mask[1, i]:
            feed[i] = setpoint[1, i]
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


@njit(cache=True)
def _limited_thrust(
    acc: Array, hover: float, tilt_max: float, thr_min: float, thr_max: float, xy_margin: float
) -> tuple[tuple[float, float, float], bool]:
    """Return the NED thrust vector, and whether its horizontal part is limited.

    ``acc`` is the acceleration over ground. The tilt follows from the horizontal acceleration as if the
    vertical thrust were equal to the weight (MPC_ACC_DECOUPLE), so a climb does not change it. The horizontal
    margin is limited to the horizontal part of full thrust at the greatest tilt: a greater one would reduce
    vertical thrust without effect.
    """
    steepest = math.tan(tilt_max)
    demanded_tan = math.hypot(acc[0], acc[1]) / GRAVITY_M_S2
    tilt_tan = min(demanded_tan, steepest)
    cosine = 1.0 / math.sqrt(1.0 + tilt_tan * tilt_tan)
    up = max(hover * (1.0 - acc[2] / GRAVITY_M_S2), thr_min * cosine)
    unlimited = up * demanded_tan
    horizontal = up * tilt_tan
    kept = min(horizontal, xy_margin, thr_max * math.sin(tilt_max))
    up = min(up, math.sqrt(thr_max * thr_max - kept * kept))
    horizontal = min(horizontal, math.sqrt(max(thr_max * thr_max - up * up, 0.0)), up * steepest)
    north, east = 0.0, 0.0
    if demanded_tan > 0.0:
        north = horizontal * acc[0] / (GRAVITY_M_S2 * demanded_tan)
        east = horizontal * acc[1] / (GRAVITY_M_S2 * demanded_tan)
    return (north, east, -up), horizontal < unlimited * (1.0 - 1e-9)


@njit(cache=True)
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


@njit(cache=True)
def integral_shift_m_s2(old_hover: float, new_hover: float, acc_down_m_s2: float) -> float:
    """Return the change of the vertical integral that keeps thrust constant for a new hover thrust.

    Thrust is hover (g - acc) / g; it is equal before and after if acc changes by (g - acc)(1 - old / new).
    """
    return (GRAVITY_M_S2 - acc_down_m_s2) * (1.0 - old_hover / new_hover)


@njit(cache=True)
def control_position(
    setpoint: Array, mask: NDArray[np.bool_], pos: Array, vel: Array, acc: Array, disturbance: Array,
    hover: float, yaw_rad: float, climb_max: float, dt_s: float,
    gains: Array, limits: Array, memory: Array, decided: Array,
) -> None:  # fmt: skip
    """Compute ``decided`` (4, 4): velocity, acceleration, thrust (3,) with its magnitude, attitude (4,).

    ``gains`` (4, 3): position P, velocity P, I, D; ``limits``: elements `TILT_MAX` and the following;
    ``memory`` (2, 3), updated in place: integrals and filtered acceleration.
    """
    integral, acc_filtered = memory[INTEGRAL], memory[ACC_FILTERED]
    alpha = 1.0 - math.exp(-2.0 * math.pi * limits[ACC_CUTOFF] * dt_s)
    for i in range(3):
        acc_filtered[i] += alpha * (acc[i] - acc_filtered[i])
    up_max = min(limits[VEL_UP_MAX], climb_max)
    vel_sp = _velocity_setpoint(
        setpoint, mask, pos, gains[0], limits[VEL_XY_MAX], up_max, limits[VEL_DOWN_MAX]
    )
    acc_sp = np.zeros(3)
    error = np.zeros(3)
    for i in range(3):
        if mask[2, i]:
            acc_sp[i] = setpoint[2, i]
        if mask[0, i] or mask[1, i]:
            error[i] = vel_sp[i] - vel[i]
            acc_sp[i] += gains[1, i] * error[i] + integral[i] + gains[3, i] * (acc_sp[i] - acc_filtered[i])
    demand = np.empty(3)
    for i in range(3):
        demand[i] = acc_sp[i] - disturbance[i]
    thr_min, thr_max = limits[THR_MIN], limits[THR_MAX]
    thrust, cut = _limited_thrust(demand, hover, limits[TILT_MAX], thr_min, thr_max, limits[THR_XY_MARGIN])

    # anti-windup: while thrust is limited, the integral does not follow an error that demands more
    collective = math.sqrt(thrust[0] * thrust[0] + thrust[1] * thrust[1] + thrust[2] * thrust[2])
    at_least = collective <= thr_min * (1.0 + 1e-9)
    at_most = collective >= thr_max * (1.0 - 1e-9)
    if (at_least and error[2] > 0.0) or (at_most and error[2] < 0.0):
        error[2] = 0.0
    squared = demand[0] * demand[0] + demand[1] * demand[1]
    if cut and squared > 0.0:
        along = error[0] * demand[0] + error[1] * demand[1]
        more = max(along, 0.0) / squared
        error[0] -= more * demand[0]
        error[1] -= more * demand[1]
    for i in range(3):
        if mask[0, i] or mask[1, i]:
            integral[i] += error[i] * gains[2, i] * dt_s
            integral[i] = min(max(integral[i], -GRAVITY_M_S2), GRAVITY_M_S2)
    for i in range(3):
        decided[VELOCITY, i], decided[ACCELERATION, i], decided[THRUST, i] = vel_sp[i], acc_sp[i], thrust[i]
    decided[THRUST, COLLECTIVE] = collective
    attitude = _attitude(thrust, yaw_rad)
    for i in range(4):
        decided[ATTITUDE, i] = attitude[i]


_NO_AXES = (False, False, False)
_ZERO = (0.0, 0.0, 0.0)
_ROWS = Struct("=9d")
"""The block's setpoint, packed at once because single writes to an array are slow"""


class PositionOutput:
    """Results of the position controller, for telemetry."""

    def __init__(self, decided: Array, yaw_rate_rad_s: float) -> None:
        """Use the results (4, 4) of `control_position`."""
        self._decided = decided
        self._yaw_rate_rad_s = yaw_rate_rad_s

    @property
    def attitude(self) -> AttitudeSetpoint:
        """Setpoint of the attitude controller."""
        return AttitudeSetpoint(
            q_ned_frd=self._decided[ATTITUDE],
            yaw_rate_rad_s=self._yaw_rate_rad_s,
            thrust=float(self._decided[THRUST, COLLECTIVE]),
        )

    @property
    def vel_ned_m_s(self) -> Array:
        """Velocity setpoint (3,); 0 on axes whose velocity is not controlled."""
        return self._decided[VELOCITY, :3]

    @property
    def acc_ned_m_s2(self) -> Array:
        """Acceleration setpoint (3,) over ground, before the disturbance is subtracted."""
        return self._decided[ACCELERATION, :3]

    @property
    def thrust_ned(self) -> Array:
        """Thrust vector (3,), NED, as a fraction of full thrust."""
        return self._decided[THRUST, :3]


class PositionController:
    """Position P and velocity PID with limits and anti-windup; ``integral_share`` scales the I gains."""

    def __init__(
        self, params: PositionParams, *, integral_share: float = 1.0, block: Block | None = None
    ) -> None:
        block = new_block() if block is None else block
        self.gains: Array = block["position_gains"][0]
        """Layout as in `control_position`, like limits and memory"""
        self.limits: Array = block["position_limits"][0]
        self.memory: Array = block["position"][0]
        self.setpoint: Array = block["setpoint"][0]
        """Rows position, velocity, acceleration; ``mask`` has the axes in use"""
        self.mask: NDArray[np.bool_] = block["mask"][0].view(np.bool_)
        self._setpoint_octets = self.setpoint.reshape(9).data
        self._mask_octets = block["mask"][0].reshape(9).data
        self.set_params(params, integral_share=integral_share)
        self._taken: tuple[TrajectorySetpoint, bool, bool, bool] | None = None
        """Setpoint and validity flags that ``setpoint`` and ``mask`` were written from."""

    def set_params(self, params: PositionParams, *, integral_share: float = 1.0) -> None:
        """Change the settings, in effect from the next update; integrals and acceleration filter are kept."""
        p = params
        self.gains[:] = (
            (p.xy_p, p.xy_p, p.z_p),
            (p.xy_vel_p_acc, p.xy_vel_p_acc, p.z_vel_p_acc),
            (p.xy_vel_i_acc, p.xy_vel_i_acc, p.z_vel_i_acc),
            (p.xy_vel_d_acc, p.xy_vel_d_acc, p.z_vel_d_acc),
        )
        self.gains[2] *= integral_share
        self.limits[:] = (
            p.tilt_max_rad, p.thr_min, p.thr_max, p.thr_xy_margin,
            p.xy_vel_max_m_s, p.z_vel_max_up_m_s, p.z_vel_max_dn_m_s, p.acc_cutoff_hz,
        )  # fmt: skip

    @property
    def integral(self) -> Array:
        """Acceleration (3,) of the integrators, NED, m/s^2."""
        integral: Array = self.memory[INTEGRAL].copy()
        return integral

    def reset(self) -> None:
        """Reset the integrators and the acceleration filter."""
        self.memory[:] = 0.0

    def add_to_integral(self, acc_ned_m_s2: Array) -> None:
        """Add an acceleration (3,), m/s^2, NED, to the integrators."""
        self.memory[INTEGRAL] += acc_ned_m_s2

    def hover_thrust_changed(self, *, old: float, new: float, acc_down_m_s2: float) -> None:
        """Change the vertical integral so that a new hover thrust does not change the present thrust."""
        self.memory[INTEGRAL, 2] += integral_shift_m_s2(old, new, acc_down_m_s2)

    def update(
        self, state: EstimatorState, setpoint: TrajectorySetpoint, *, yaw_rad: float, hover_thrust: float,
        disturbance_ned_m_s2: Array, climb_max_m_s: float, dt_s: float,
    ) -> PositionOutput:  # fmt: skip
        """Compute attitude and thrust for ``setpoint``.

        An axis without setpoint keeps its velocity (acceleration 0). Without a valid position estimate the
        position axes follow the velocity setpoint, or stop; without a valid velocity estimate only the
        acceleration is used. A valid height implies a valid vertical velocity. ``climb_max_m_s`` limits the
        climb in addition to the parameters; it is negative early in the take-off ramp.
        """
        self.take(state, setpoint)
        decided = np.zeros((4, 4))
        control_position(
            self.setpoint, self.mask, state.pos_ned_m, state.vel_ned_m_s, state.acc_ned_m_s2,
            disturbance_ned_m_s2, hover_thrust, yaw_rad, climb_max_m_s, dt_s,
            self.gains, self.limits, self.memory, decided,
        )  # fmt: skip
        return PositionOutput(decided, setpoint.yaw_rate_rad_s)

    def take(self, state: EstimatorState, setpoint: TrajectorySetpoint) -> None:
        """Write a changed setpoint to the kernel's arrays, without the axes whose estimate is invalid."""
        taken = self._taken
        if (
            taken is not None
            and taken[0] is setpoint
            and taken[1:] == (state.position_valid, state.height_valid, state.velocity_valid)
        ):
            return
        self._taken = (setpoint, state.position_valid, state.height_valid, state.velocity_valid)
        pos, vel, acc = setpoint.pos_ned_m, setpoint.vel_ned_m_s, setpoint.acc_ned_m_s2
        _ROWS.pack_into(
            self._setpoint_octets, 0,
            *(_ZERO if pos is None else pos),
            *(_ZERO if vel is None else vel),
            *(_ZERO if acc is None else acc),
        )  # fmt: skip
        self._mask_octets[:] = bytes((
            *(_NO_AXES if pos is None else setpoint.pos_axes),
            *(_NO_AXES if vel is None else setpoint.vel_axes),
            *(_NO_AXES if acc is None else setpoint.acc_axes),
        ))  # fmt: skip
        if not (state.position_valid and state.height_valid):
            known = np.array((state.position_valid, state.position_valid, state.height_valid))
            lost = self.mask[0] & ~known
            self.setpoint[1, lost & ~self.mask[1]] = 0.0
            self.mask[1] |= lost
            self.mask[0] &= known
        if not state.velocity_valid:
            # the vertical one comes from barometer and accelerometer and is valid as long as the height is
            self.mask[:2, :2] = False
            self.mask[:2, 2] &= state.height_valid
