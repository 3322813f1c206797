"""Control allocation: thrust and torque to motor controls.

Demands are normalised as in PX4, but roll and pitch separately: collective thrust 0..1 of full thrust, roll
and pitch torque such that a demand of 1 changes the rotors by 0.71 of full thrust (root mean square), yaw
such that the most used rotor changes by 1. Saturation reduces yaw first, then collective thrust, roll and
pitch last.

The thrust of a rotor, 0..1, is lift (collective + torques), where `autopilot.control.mixing` has the lift of
each rotor. The kernels divide by it: each rotor has the range 0..1/lift for collective and torques.
"""

from collections.abc import Collection
from math import sqrt
from typing import Annotated

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.control.mixing import Mixer, mixer, mixer_without
from autopilot.control.params import AllocationParams
from foundation.airframe.description import MOST_ROTORS
from foundation.kernels.inner import inner
from foundation.kernels.records import new_record
from foundation.types import Array


class Allocation:
    """Record: settings and results of control allocation."""

    rotors: int
    """Number of rotors of the airframe."""
    used: int
    """Number of rotors in use; the next four fields have one row for each."""
    index: Annotated[NDArray[np.int64], MOST_ROTORS]
    """Number of the rotor."""
    mix: Annotated[Array, (MOST_ROTORS, 3)]
    """Relative thrust per normalised roll, pitch and yaw torque, over the lift."""
    lift: Annotated[Array, MOST_ROTORS]
    """Relative thrust per collective thrust."""
    ceiling: Annotated[Array, MOST_ROTORS]
    """1 over the lift."""
    controls_yaw: bool
    yaw_thrust_margin: float
    thrust_model_factor: float
    thrust: float
    """Collective thrust of the last allocation, 0..1."""
    unallocated: Annotated[Array, 3]
    """Normalised roll, pitch and yaw torque of the last demand that was not achieved."""
    controls: Annotated[Array, MOST_ROTORS]
    """Motor controls, 0..1."""


@inner
def _yaw_bounds(fixed: Array, yaw: Array, ceiling: Array, low: float, high: float) -> tuple[float, float]:
    """Return the interval of feasible yaw demands.

    A demand y is feasible if one collective c in [low, high] keeps all of ``fixed + c + y * yaw`` in
    0..``ceiling``, (m,) each. Three conditions: no rotor is over its ceiling at the collective at which
    another is at 0, none at c = low, and none is under 0 at c = high. Each is linear in y, so the set is an
    interval; it may be empty (lower > upper).
    """
    lower, upper = -np.inf, np.inf
    used = fixed.size
    for i in range(used):
        for j in range(used + 2):
            if j < used:
                slope, room = yaw[i] - yaw[j], ceiling[i] - (fixed[i] - fixed[j])
            elif j == used:
                slope, room = yaw[i], ceiling[i] - fixed[i] - low
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
def _extremes(fixed: Array, yaw: Array, ceiling: Array, y: float) -> tuple[float, float]:
    """Return the least element of ``fixed + y * yaw``, and the least distance from the ceiling, (m,) each."""
    least, room = np.inf, np.inf
    for i in range(fixed.size):
        value = fixed[i] + y * yaw[i]
        least, room = min(least, value), min(room, ceiling[i] - value)
    return least, room


@njit(cache=True)
def allocate(allocation: Allocation, thrust: float, torque: Array, highest: float) -> None:
    """Compute the controls, the unallocated torque and the achieved collective.

    ``thrust`` 0..1 is collective, ``torque`` (3,) normalised, FRD. Torque may raise the collective up to
    ``highest``, which must be 0 on the ground.
    """
    used, index, lift = allocation.used, allocation.index, allocation.lift
    mix, ceiling = allocation.mix, allocation.ceiling[:used]
    controls, yaw_margin = allocation.controls, allocation.yaw_thrust_margin
    factor = allocation.thrust_model_factor
    fixed, yaw = np.empty(used), mix[:used, 2]
    for i in range(used):
        fixed[i] = mix[i, 0] * torque[0] + mix[i, 1] * torque[1]
    thrust = min(max(thrust, 0.0), 1.0)
    lowest, _ = _extremes(fixed, yaw, ceiling, 0.0)

    scale = 1.0
    high = max(thrust, highest)
    y_lower, y_upper = _yaw_bounds(fixed, yaw, ceiling, 0.0, high)
    if y_lower > y_upper:
        for i in range(used):
            spread = fixed[i] - lowest
            if spread > ceiling[i]:
                scale = min(scale, ceiling[i] / spread)
        if -lowest * scale > high:
            scale = high / -lowest
        for i in range(used):
            fixed[i] *= scale
        y_lower, y_upper = _yaw_bounds(fixed, yaw, ceiling, 0.0, high)
        if y_lower > y_upper:  # a spread is exactly the ceiling: rounding closed the interval
            y_lower = y_upper = 0.0
    y = min(max(0.0, y_lower), y_upper)
    lowest, room = _extremes(fixed, yaw, ceiling, y)
    collective = max(min(thrust, room), min(-lowest, room))

    # yaw within the remaining margin at this collective, or at one lower by at most the yaw margin
    y_lower, y_upper = _yaw_bounds(fixed, yaw, ceiling, max(collective - yaw_margin, 0.0), collective)
    if y_lower <= y_upper and allocation.controls_yaw:
        y = min(max(torque[2], y_lower), y_upper)
        _, room = _extremes(fixed, yaw, ceiling, y)
        collective = max(min(collective, room), 0.0)

    for i in range(used):
        relative_thrust = min(max(lift[i] * (fixed[i] + collective + y * yaw[i]), 0.0), 1.0)
        # positive root of factor u^2 + (1 - factor) u = relative thrust
        linear = 1.0 - factor
        if factor < 1e-6:
            control = relative_thrust
        else:
            root = sqrt(linear * linear + 4.0 * factor * relative_thrust)
            control = min((root - linear) / (2.0 * factor), 1.0)
        controls[index[i]] = control
    allocation.unallocated[0] = torque[0] * (1.0 - scale)
    allocation.unallocated[1] = torque[1] * (1.0 - scale)
    allocation.unallocated[2] = torque[2] - y
    allocation.thrust = collective


class Allocator:
    """Settings and resets of the record; computes motor controls from it."""

    def __init__(self, params: AllocationParams, record: Allocation | None = None) -> None:
        """None creates a record. Raises ValueError for an infeasible airframe."""
        self.record = new_record(Allocation) if record is None else record
        self.failed: frozenset[int] = frozenset()
        """Motors that are known to have failed."""
        self.set_params(params)

    def set_params(self, params: AllocationParams) -> None:
        """Change the settings, in effect from the next demand; failed motors stay removed.

        Raises ValueError for an infeasible airframe.
        """
        intact = mixer(params)
        self.params, self._intact = params, intact
        self.record.rotors = len(params.rotors)
        self.record.yaw_thrust_margin = params.yaw_thrust_margin
        self.record.thrust_model_factor = params.thrust_model_factor
        self.remove(self.failed)

    @property
    def controls_yaw(self) -> bool:
        """Whether yaw is controlled; False after a failure that takes this from the airframe."""
        return bool(self.record.controls_yaw)

    def remove(self, failed: Collection[int]) -> None:
        """Use the airframe without these motors, from the next demand; all are used if it cannot fly so."""
        self.failed = frozenset(failed)
        removed = None
        if failed and self.params.failure_mode:
            removed = mixer_without(self.params, failed)
        self._use(self._intact if removed is None else removed)

    def _use(self, used: Mixer) -> None:
        record, count = self.record, len(used.rotors)
        record.used, record.controls_yaw = count, used.controls_yaw
        record.index[:count], record.lift[:count] = used.rotors, used.lift
        record.ceiling[:count] = 1.0 / used.lift
        record.mix[:count] = used.torque / used.lift[:, np.newaxis]
        record.controls[[rotor for rotor in range(MOST_ROTORS) if rotor not in used.rotors]] = 0.0

    def reset(self) -> None:
        """Reset the collective and the unallocated torque to zero."""
        self.record.thrust = 0.0
        self.record.unallocated[:] = 0.0

    def allocate(self, thrust: float, torque: Array, *, airmode: bool) -> Array:
        """Return the motor controls (n,) of `allocate`; with ``airmode`` torque may raise the thrust."""
        allocate(self.record, thrust, torque, 1.0 if airmode else 0.0)
        return self.record.controls[: self.record.rotors].copy()
