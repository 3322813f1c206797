"""Control allocation: thrust and torque to motor controls.

Demands are normalised as in PX4: collective thrust 0..1 of full thrust, roll and pitch torque such that a
demand of 1 changes the rotors by 0.71 of full thrust (root mean square), yaw such that the most used rotor
changes by 1. Saturation reduces yaw first, then collective thrust, roll and pitch last. The airframe is a
quadrotor, so thrust and three torques determine the four rotor thrusts; collective thrust alone causes no
torque on a balanced frame.
"""

from math import sqrt

import numpy as np
from numba import njit

from autopilot.control.block import Block, new_block
from autopilot.control.params import AllocationParams
from foundation.types import Array


@njit(cache=True)
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


@njit(cache=True)
def _extremes(fixed: Array, yaw: Array, y: float) -> tuple[float, float]:
    """Return the least and the greatest element of ``fixed + y * yaw``, (4,) each."""
    least = most = fixed[0] + y * yaw[0]
    for i in range(1, 4):
        value = fixed[i] + y * yaw[i]
        least, most = min(least, value), max(most, value)
    return least, most


@njit(cache=True)
def allocate(
    thrust: float,
    torque: Array,
    mix: Array,
    yaw_margin: float,
    highest: float,
    factor: float,
    controls: Array,
    unallocated: Array,
) -> float:
    """Compute ``controls`` (4,) and ``unallocated`` (3,); returns the achieved collective.

    Torque may raise the collective up to ``highest``.
    """
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
    unallocated[0] = torque[0] * (1.0 - scale)
    unallocated[1] = torque[1] * (1.0 - scale)
    unallocated[2] = torque[2] - y
    return float(collective)


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
    """Computes motor controls for a demand, and the part of the demand that they do not achieve."""

    def __init__(self, params: AllocationParams, block: Block | None = None) -> None:
        block = new_block() if block is None else block
        self.mix: Array = block["mix"][0]
        """(4, 3)"""
        self.unallocated: Array = block["unallocated"][0]
        """(3,) normalised roll, pitch and yaw torque of the last demand that was not achieved"""
        self._thrust: Array = block["thrust"]
        self._yaw_margin: Array = block["yaw_thrust_margin"]
        self._model_factor: Array = block["thrust_model_factor"]
        self.set_params(params)

    @property
    def thrust(self) -> float:
        """Collective thrust of the last allocation, 0..1."""
        return self._thrust.item()

    def set_params(self, params: AllocationParams) -> None:
        """Change the settings, in effect from the next demand.

        Raises ValueError for an infeasible airframe.
        """
        self.mix[:] = mixer(params)
        self._yaw_margin[0] = params.yaw_thrust_margin
        self._model_factor[0] = params.thrust_model_factor

    def reset(self) -> None:
        """Reset the collective and the unallocated torque to zero."""
        self._thrust[0] = 0.0
        self.unallocated[:] = 0.0

    def allocate(self, thrust: float, torque: Array, *, airmode: bool) -> Array:
        """Return the motor controls (4,), 0..1, for ``thrust`` 0..1 and normalised ``torque`` (3,), FRD.

        ``thrust`` is collective. With ``airmode`` torque may raise it; it must be off on the ground.
        """
        controls = np.empty(4)
        self._thrust[0] = allocate(
            thrust, torque, self.mix, float(self._yaw_margin[0]), 1.0 if airmode else 0.0,
            float(self._model_factor[0]), controls, self.unallocated,
        )  # fmt: skip
        return controls
