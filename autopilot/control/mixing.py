"""Mixers: the relative thrust of each rotor for collective thrust, roll, pitch and yaw, from the geometry.

The columns are those of the pseudo-inverse of the effectiveness matrix, so the controls are the least, in the
sense of squares, that cause a demand. After a motor failure the mixer is that of the remaining rotors, scaled
such that a demand causes the same thrust and torque as before.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from autopilot.control.params import AllocationParams
from foundation.types import Array

_ROUNDING = 1e-9
_LEAST_USE = 0.05
"""Share of the greatest change of a rotor's thrust below which a torque does not use a rotor."""
_LEAST_LIFT = 0.05
"""Share of the mean thrust below which a rotor does not contribute to the hover, and is left out."""
_MOST_HOVER = 0.9
"""Share of a rotor's thrust range above which the hover leaves too little for control, and is not flown."""
_LEAST_WITH_YAW = 0.25
"""Share of the intact airframe's torques at the hover, each in both directions, below which yaw is given up:
it would take thrust from roll and pitch for a torque that the first gust exceeds."""
_LEAST_TILT = 0.2
"""Share of the intact airframe's roll and pitch torque below which the airframe does not fly."""
_MOST_SPIN = 0.5
"""Yaw torque of the hover, over the rotors' typical yaw torque for the same thrust, beyond which an airframe
without control of yaw does not fly: the drag of the rotors does not limit the rotation."""
_LITTLE_SPIN = 0.01
"""The same, below which rotor thrusts are not changed further for less rotation."""
_YAW_WEIGHTS = (0.0, 1.0, 2.0, 4.0, 10.0, 30.0)
"""Weights of the yaw torque against rotor thrusts when yaw is given up, over the rotors' typical yaw torque;
the more it weighs, the less thrust is left to some rotors."""
_TOLERANCE = 1e-6


class Mixer(NamedTuple):
    """Relative thrusts of the rotors in use, m of n."""

    rotors: tuple[int, ...]
    """(m,) indices of the rotors in use."""
    lift: Array
    """(m,) per collective thrust, all positive; 1 for an intact airframe whose thrust is balanced."""
    torque: Array
    """(m, 3) per normalised roll, pitch and yaw torque."""
    controls_yaw: bool
    """False: yaw is given up, and its column is 0."""


def effectiveness(params: AllocationParams) -> Array:
    """Return thrust along -z and torque about x, y, z (FRD), N and N m, per newton of each rotor, (4, n)."""
    rows = []
    for rotor in params.rotors:
        axis = np.array(rotor.thrust_axis_frd)
        # the reaction to a counter-clockwise rotor turns the body against the thrust's axis
        torque = np.cross(rotor.position_frd_m, axis) - rotor.direction * params.moment_m * axis
        rows.append((-axis[2], *torque))
    return np.array(rows).T


def mixer(params: AllocationParams) -> Mixer:
    """Return the mixer of all rotors. Raises ValueError for an infeasible airframe."""
    matrix = effectiveness(params)
    count = matrix.shape[1]
    if np.linalg.matrix_rank(matrix) < 4:
        raise ValueError("rotors: they cannot produce thrust, roll, pitch and yaw independently")
    # with as many rotors as demands the pseudo-inverse is the inverse
    inverse = np.asarray(np.linalg.inv(matrix) if count == 4 else np.linalg.pinv(matrix), dtype=np.float64)
    lift = np.ones(count)
    if np.abs(matrix[1:].sum(axis=1)).max() > _ROUNDING:
        lift = inverse[:, 0] * (count / inverse[:, 0].sum())
        if lift.min() < _LEAST_LIFT:
            raise ValueError(
                f"rotors: hover would leave rotors[{lift.argmin()}] without thrust; expected rotors that "
                "balance about the centre of mass"
            )
    return Mixer(tuple(range(count)), lift, inverse[:, 1:] / _norms(inverse), controls_yaw=True)


def mixer_without(params: AllocationParams, failed: Collection[int]) -> Mixer | None:
    """Return the mixer that flies on without some rotors; None if that is not possible.

    Controls cannot be negative, so rotors that the hover leaves almost without thrust are not used either: of
    a hexacopter the one opposite to the failed one. If the others cannot control yaw in both directions, it
    is given up: of the hovers that leave torque for roll and pitch, that with the least yaw torque is flown,
    and the vehicle rotates as fast as the drag of its rotors permits.
    """
    matrix = effectiveness(params)
    intact = np.asarray(np.linalg.pinv(matrix), dtype=np.float64)
    authority = _authority(matrix, intact)
    remaining = [rotor for rotor in range(matrix.shape[1]) if rotor not in failed]
    hovers = partial(_hovers, matrix, remaining, most_lift=_MOST_HOVER / max(params.hover_share, 1e-3))

    def mixed(used: Sequence[int], inverse: Array, *, controls_yaw: bool) -> Mixer:
        lift = _lift(inverse, matrix.shape[1])
        return Mixer(tuple(used), lift, inverse[:, 1:] / _norms(intact), controls_yaw)

    for used, inverse in hovers(lambda columns: np.asarray(np.linalg.pinv(columns))):
        if np.all(_authority(matrix[:, used], inverse) >= _LEAST_WITH_YAW * authority):
            return mixed(used, inverse, controls_yaw=True)
    typical_m = float(np.sqrt(np.mean(matrix[3] ** 2)))
    best, least_spin = None, _MOST_SPIN * typical_m
    for weight in _YAW_WEIGHTS:
        invert = partial(_inverse_without_yaw, weight_1_m=weight / typical_m)
        for used, inverse in hovers(invert):
            spin_m = abs(float(matrix[3, used] @ inverse[:, 0]))
            tilt = _authority(matrix[:, used], inverse)[:2]
            if spin_m < least_spin and np.all(tilt >= _LEAST_TILT * authority[:2]):
                best, least_spin = mixed(used, inverse, controls_yaw=False), spin_m
        if least_spin <= _LITTLE_SPIN * typical_m:
            break
    return best


def _hovers(
    matrix: Array, remaining: Sequence[int], invert: Callable[[Array], Array], *, most_lift: float
) -> Iterator[tuple[list[int], Array]]:
    """Yield rotors to use (m), fewer and fewer, with the inverse (m, 4) of their columns, if they can hover.

    The rotor to which the hover leaves the least thrust is left out next. None has more than ``most_lift``.
    """
    used = list(remaining)
    while len(used) >= 3:
        columns = matrix[:, used]
        if np.linalg.matrix_rank(columns[:3]) < 3:
            return
        inverse = np.asarray(invert(columns), dtype=np.float64)
        if not np.allclose(columns[:3] @ inverse[:, 0], (1.0, 0.0, 0.0), atol=_TOLERANCE):
            return
        lift = _lift(inverse, matrix.shape[1])
        if lift.min() >= _LEAST_LIFT and lift.max() <= most_lift:
            yield [*used], inverse
        del used[int(lift.argmin())]


def _lift(inverse: Array, count: int) -> Array:
    """Return the lift (m,) of rotors from their inverse, in an airframe with so many rotors."""
    return np.asarray(inverse[:, 0] * (count / inverse[:, 0].sum()))


def _inverse_without_yaw(columns: Array, weight_1_m: float) -> Array:
    """Return the inverse (m, 4) for thrust, roll and pitch, with a column of 0 for yaw.

    Each column is the least, in the sense of squares, of rotor thrusts and ``weight_1_m`` times their yaw
    torque: the weighted pseudo-inverse Q^-1 A' (A Q^-1 A')^-1, Q = I + w^2 y y'.
    """
    demands, yaw = columns[:3], weight_1_m * columns[3]
    spread = np.linalg.solve(np.eye(yaw.size) + np.outer(yaw, yaw), demands.T)
    return np.column_stack((spread @ np.linalg.inv(demands @ spread), np.zeros(yaw.size)))


def _authority(columns: Array, inverse: Array) -> Array:
    """Return the roll, pitch and yaw torque (3,) per thrust that the hover permits in both directions.

    A rotor's thrust cannot be negative, so the torque is that at which the first rotor has none. It is 0
    where the columns do not cause the torque.
    """
    hover, found = inverse[:, 0], np.zeros(3)
    for axis in range(3):
        column = inverse[:, 1 + axis]
        if np.allclose((columns @ column)[1 + axis], 1.0, atol=_TOLERANCE):
            found[axis] = (hover / np.maximum(np.abs(column), 1e-12)).min()
    return found


def _norms(inverse: Array) -> Array:
    """Return the norms (3,) of roll, pitch and yaw from the inverse (n, 4) of all rotors.

    Those of roll and pitch are root mean squares times sqrt(2), over the rotors with more than `_LEAST_USE`
    of the greatest element; that of yaw is the greatest element. PX4 divides roll and pitch by the greater of
    both, here each has its own: the gains of `autopilot.control.airframe_gains` refer to these.
    """
    columns = inverse[:, 1:]
    sizes = np.abs(columns[:, :2])
    used = (sizes > _LEAST_USE * sizes.max(axis=0)).sum(axis=0)
    tilt = np.sqrt((columns[:, :2] ** 2).sum(axis=0) / (used / 2.0))
    return np.array((*tilt, np.abs(columns[:, 2]).max()))
