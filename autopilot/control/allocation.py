"""Control allocation: thrust and torque to motor controls.

Demands are normalised as in PX4: collective thrust 0..1 of full thrust, roll and pitch torque such that a
demand of 1 changes the rotors by 0.71 of full thrust (root mean square), yaw such that the most used rotor
changes by 1. Saturation reduces yaw first, then collective thrust, roll and pitch last. The airframe is a
quadrotor, so thrust and three torques determine the four rotor thrusts; collective thrust alone causes no
torque on a balanced frame.
"""

from math import sqrt
from typing import Annotated

import numpy as np
from numba import njit

from autopilot.control.params import AllocationParams
from foundation.kernels.inner import inner
from foundation.kernels.records import new_record
from foundation.types import Array


class Allocation:
    """Record: settings and results of control allocation."""

    mix: Annotated[Array, (4, 3)]
    """Relative thrust of each rotor per normalised roll, pitch and yaw torque."""
    yaw_thrust_margin: float
    thrust_model_factor: float
    thrust: float
    """Collective thrust of the last allocation, 0..1."""
    unallocated: Annotated[Array, 3]
    """Normalised roll, pitch and yaw torque of the last demand that was not achieved."""
    controls: Annotated[Array, 4]
    """Motor controls, 0..1."""


@inner
def _yaw_bounds(fixed: Array, yaw: Array, low: float, high: float) -> tuple[float, float]:
    """Return the interval of feasible yaw demands.

    A demand y is feasible if one collective c in [low, high] keeps all of ``fixed + c + y * yaw`` in 0..1.
    Three conditions: the spread of the rotors is at most 1, none is over 1 at c = low, none under 0 at c =
    high. Each is linear in y, so the set is an interval; it may be empty (lower > upper).
    """
    lower, upper = -np.inf, np.inf
    for i in range(4):
        for j in range(6):
            if j < 4:
                slope, room = yaw[i] - yaw[j], 1.0 - (fixed[i] - fixed[j])
            elif j == 4:
                slope, room = yaw[i], 1.0 - fixed[i] - low
            else:
                slope, room = -yaw[i], fixed[i] + high
            if slope > 1e-9:
                upper = min(upper, room / slope)
            elif slope < -1e-9:
                lower = max(lower, room / slope)
            elif room < -1e-12:  # infeasible for every yaw
                return np.inf, -np.inf
    return lower, upper


@inner
def _extremes(fixed: Array, yaw: Array, y: float) -> tuple[float, float]:
    """Return the least and the greatest element of ``fixed + y * yaw``, (4,) each."""
    least = most = fixed[0] + y * yaw[0]
    for i in range(1, 4):
        value = fixed[i] + y * yaw[i]
        least, most = min(least, value), max(most, value)
    return least, most


@njit(cache=True)
def allocate(allocation: Allocation, thrust: float, torque: Array, highest: float) -> None:
    """Compute the controls, the unallocated torque and the achieved collective.

    ``thrust`` 0..1 is collective, ``torque`` (3,) normalised, FRD. Torque may raise the collective up to
    ``highest``, which must be 0 on the ground.
    """
    mix, controls, yaw_margin = allocation.mix, allocation.controls, allocation.yaw_thrust_margin
    factor = allocation.thrust_model_factor
    fixed, yaw = np.empty(4), mix[:, 2]
    for i in range(4):
        fixed[i] = mix[i, 0] * torque[0] + mix[i, 1] * torque[1]
    thrust = min(max(thrust, 0.0), 1.0)
    lowest, most = _extremes(fixed, yaw, 0.0)
    spread = most - lowest

    scale = 1.0
    high = max(thrust, highest)
    y_lower, y_upper = _yaw_bounds(fixed, yaw, 0.0, high)
    if y_lower > y_upper:
        if spread > 1.0:
            scale = 1.0 / spread
        if -lowest * scale > high:
            scale = high / -lowest
        for i in range(4):
            fixed[i] *= scale
        y_lower, y_upper = _yaw_bounds(fixed, yaw, 0.0, high)
        if y_lower > y_upper:  # the spread is exactly 1: rounding closed the interval
            y_lower = y_upper = 0.0
    y = min(max(0.0, y_lower), y_upper)
    lowest, most = _extremes(fixed, yaw, y)
    collective = max(min(thrust, 1.0 - most), min(-lowest, 1.0 - most))

    # yaw within the remaining margin at this collective, or at one lower by at most the yaw margin
    y_lower, y_upper = _yaw_bounds(fixed, yaw, max(collective - yaw_margin, 0.0), collective)
    if y_lower <= y_upper:
        y = min(max(torque[2], y_lower), y_upper)
        _, most = _extremes(fixed, yaw, y)
        collective = max(min(collective, 1.0 - most), 0.0)

    for i in range(4):
        relative_thrust = min(max(fixed[i] + collective + y * yaw[i], 0.0), 1.0)
        # positive root of factor u^2 + (1 - factor) u = relative thrust
        linear = 1.0 - factor
        if factor < 1e-6:
            controls[i] = relative_thrust
        else:
            root = sqrt(linear * linear + 4.0 * factor * relative_thrust)
            controls[i] = min((root - linear) / (2.0 * factor), 1.0)
    allocation.unallocated[0] = torque[0] * (1.0 - scale)
    allocation.unallocated[1] = torque[1] * (1.0 - scale)
    allocation.unallocated[2] = torque[2] - y
    allocation.thrust = collective


def effectiveness(params: AllocationParams) -> Array:
    """Return thrust along -z and torque about x, y, z (FRD), N and N m, per newton of each rotor, (4, 4)."""
    rows = []
    for rotor in params.rotors:
        x_m, y_m, _ = rotor.pos_frd_m
        # r x (0, 0, -1) = (-y, x, 0); a counter-clockwise rotor turns the body clockwise, which is +z down
        rows.append((1.0, -y_m, x_m, rotor.torque_ratio_m))
    return np.array(rows).T


def mixer(params: AllocationParams) -> Array:
    """Return the relative thrust of each rotor per normalised roll, pitch and yaw torque, (4, 3)."""
    matrix = effectiveness(params)
    if np.linalg.matrix_rank(matrix) < 4:
        raise ValueError("the rotors cannot produce thrust, roll, pitch and yaw independently")
    if np.abs(matrix[1:3].sum(axis=1)).max() > 1e-9:
        raise ValueError("the rotors' thrust is not balanced about the centre of mass")
    mix = np.asarray(np.linalg.inv(matrix)[:, 1:], dtype=np.float64)
    mix[:, :2] /= np.sqrt((mix[:, :2] ** 2).sum(axis=0) / 2.0)
    mix[:, 2] /= np.abs(mix[:, 2]).max()
    return np.ascontiguousarray(mix)


class Allocator:
    """Settings and resets of the record; computes motor controls from it."""

    def __init__(self, params: AllocationParams, record: Allocation | None = None) -> None:
        """None creates a record. Raises ValueError for an infeasible airframe."""
        self.record = new_record(Allocation) if record is None else record
        self.set_params(params)

    def set_params(self, params: AllocationParams) -> None:
        """Change the settings, in effect from the next demand.

        Raises ValueError for an infeasible airframe.
        """
        self.record.mix[:] = mixer(params)
        self.record.yaw_thrust_margin = params.yaw_thrust_margin
        self.record.thrust_model_factor = params.thrust_model_factor

    def reset(self) -> None:
        """Reset the collective and the unallocated torque to zero."""
        self.record.thrust = 0.0
        self.record.unallocated[:] = 0.0

    def allocate(self, thrust: float, torque: Array, *, airmode: bool) -> Array:
        """Return the motor controls (4,) of `allocate`; with ``airmode`` torque may raise the thrust."""
        allocate(self.record, thrust, torque, 1.0 if airmode else 0.0)
        return self.record.controls.copy()
