"""Geometric tracking control of a multirotor on SE(3).

T. Lee, M. Leok, N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", 49th IEEE
Conference on Decision and Control, 2010: equations (10), (11) for the errors, (15) for the thrust, (16) for
the moment. Here forces are divided by the mass and moments by the inertia, so gains have units of
1/s^2 and 1/s; the desired body rate is that of the heading, and its derivative is neglected. The wind is the
autopilot's estimate, which the demanded acceleration cancels.

Frames are NED and FRD: the third body axis points down, and thrust acts against it.
"""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from coflight import (
    AttitudeSetpoint,
    ControllerContext,
    ControllerInputs,
    EstimatorState,
    RateSetpoint,
    ThrustTorque,
    TrajectorySetpoint,
)

Array = NDArray[np.float64]
Positive = Annotated[float, Meta(gt=0.0)]

GRAVITY_M_S2 = 9.80665
DOWN = np.array((0.0, 0.0, 1.0))
TORQUE_MAX = 1.5
"""Limit of the demand, normalised: the allocation gives up what the rotors cannot produce."""


class Settings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Gains."""

    position_1_s2: tuple[Positive, Positive, Positive] = (2.5, 2.5, 4.0)
    """Acceleration per position error; north, east, down."""
    velocity_1_s: tuple[Positive, Positive, Positive] = (2.6, 2.6, 4.0)
    """Acceleration per velocity error; north, east, down."""
    attitude_1_s2: Positive = 180.0
    """Angular acceleration per attitude error, about roll and pitch; yaw has a fifth of it."""
    rate_1_s: Positive = 26.0
    """Angular acceleration per body rate error, about roll and pitch; yaw has half of it."""
    position_error_max_m: Positive = 2.0
    """Greater position errors count as this one, per axis."""


class GeometricController:
    """Controls position, velocity, attitude and body rates by one law each for force and moment."""

    Settings = Settings

    def __init__(self, context: ControllerContext, settings: Settings) -> None:
        self._settings = settings
        self._params = context.params.position
        self._inertia = np.array(context.airframe.inertia_kg_m2)
        self._torque_nm = np.array(context.unit_torque_m) * context.airframe.propulsion.range_n
        """(3,) torque of a normalised demand of 1."""
        self._attitude_gain = settings.attitude_1_s2 * np.array((1.0, 1.0, 0.2))
        self._rate_gain = settings.rate_1_s * np.array((1.0, 1.0, 0.5))

    def reset(self, state: EstimatorState) -> None:
        """Do nothing: the law has no state."""

    def update(self, inputs: ControllerInputs) -> ThrustTorque:
        """Return thrust and torque for the setpoint, of any kind."""
        state, setpoint = inputs.state, inputs.setpoint
        omega_frd = state.omega_frd_rad_s
        attitude = rotation(state.q_ned_frd)
        if isinstance(setpoint, RateSetpoint):
            desired_frd, error = setpoint.rate_frd_rad_s, np.zeros(3)
            thrust = setpoint.thrust
        else:
            if isinstance(setpoint, AttitudeSetpoint):
                desired, thrust = rotation(setpoint.q_ned_frd), setpoint.thrust
            else:
                force_ned = self._acceleration(inputs, setpoint) - GRAVITY_M_S2 * DOWN
                desired = frame(force_ned, inputs.yaw_rad)
                # equation (15): the component of the demanded force along the present thrust axis
                share = max(-float(force_ned @ attitude[:, 2]), 0.0) / GRAVITY_M_S2
                thrust = max(inputs.hover_thrust * share, self._params.thr_min)
            if not inputs.controls_yaw:  # an error of half a turn would hide those of roll and pitch
                desired = frame(-desired[:, 2], math.atan2(attitude[1, 0], attitude[0, 0]))
            desired_frd = attitude.T @ (setpoint.yaw_rate_rad_s * DOWN)
            error = attitude_error(attitude, desired)
        alpha = -self._attitude_gain * error - self._rate_gain * (omega_frd - desired_frd)
        moment_nm = self._inertia * alpha + np.cross(omega_frd, self._inertia * omega_frd)
        torque = np.clip(moment_nm / self._torque_nm, -TORQUE_MAX, TORQUE_MAX)
        return ThrustTorque(min(thrust, 1.0), torque)

    def _acceleration(self, inputs: ControllerInputs, setpoint: TrajectorySetpoint) -> Array:
        """Return the demanded acceleration (3,), NED, without the wind and within the limit of the tilt."""
        settings, state, limits = self._settings, inputs.state, self._params
        position_valid = (state.position_valid, state.position_valid, state.height_valid)
        velocity_valid = (state.velocity_valid, state.velocity_valid, state.height_valid)
        acc = np.zeros(3)
        for i in range(3):
            has_position = setpoint.pos_ned_m is not None and setpoint.pos_axes[i]
            has_velocity = setpoint.vel_ned_m_s is not None and setpoint.vel_axes[i]
            if setpoint.acc_ned_m_s2 is not None and setpoint.acc_axes[i]:
                acc[i] += setpoint.acc_ned_m_s2[i]
            if (has_position or has_velocity) and velocity_valid[i]:
                desired_m_s = setpoint.vel_ned_m_s[i] if has_velocity else 0.0
                acc[i] -= settings.velocity_1_s[i] * (state.vel_ned_m_s[i] - desired_m_s)
            if has_position and position_valid[i]:
                error_m = state.pos_ned_m[i] - setpoint.pos_ned_m[i]
                most_m = settings.position_error_max_m
                acc[i] -= settings.position_1_s2[i] * min(max(error_m, -most_m), most_m)
        if math.isfinite(inputs.climb_max_m_s):  # thrust rises slowly for take-off
            least = -settings.velocity_1_s[2] * (inputs.climb_max_m_s + state.vel_ned_m_s[2])
            acc[2] = max(acc[2], least)
        acc -= inputs.disturbance_ned_m_s2
        acc[2] = min(acc[2], GRAVITY_M_S2 * (1.0 - limits.thr_min / inputs.hover_thrust))
        level_max = math.tan(limits.tilt_max_rad) * (GRAVITY_M_S2 - acc[2])
        level = math.hypot(acc[0], acc[1])
        if level > level_max:
            acc[:2] *= level_max / level
        return acc


def rotation(q_ned_frd: Array) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,), wxyz."""
    w, x, y, z = q_ned_frd.tolist()
    return np.array((
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    ))  # fmt: skip


def frame(force_ned: Array, yaw_rad: float) -> Array:
    """Return the attitude (3, 3) in which thrust has the direction of a force (3,), with a heading."""
    down = -force_ned / np.linalg.norm(force_ned)
    right = np.cross(down, (math.cos(yaw_rad), math.sin(yaw_rad), 0.0))
    right /= np.linalg.norm(right)
    return np.column_stack((np.cross(right, down), right, down))


def attitude_error(attitude: Array, desired: Array) -> Array:
    """Return the attitude error (3,) of equation (10), about the body's axes."""
    skew = desired.T @ attitude - attitude.T @ desired
    return 0.5 * np.array((skew[2, 1], skew[0, 2], skew[1, 0]))
