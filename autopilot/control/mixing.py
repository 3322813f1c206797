"""Mixers: the relative thrust of each rotor for collective thrust, roll, pitch and yaw, from the geometry.

The columns are those of the pseudo-inverse of the effectiveness matrix, so the controls are the least, in the
sense of squares, that cause a demand. After a motor failure the mixer is that of the remaining rotors, scaled
such that a demand causes the same thrust and torque as before.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from autopilot.control.params import AllocationParams
from foundation.types import Array

_ROUNDING = 1e-9
_LEAST_LIFT = 0.05
"""Share of the mean thrust below which a rotor does not contribute to the hover, and is left out."""


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

    Rotors that a hover without net torque leaves without thrust are not used either, since controls cannot be
    negative: of a hexacopter the one opposite to the failed one. If the others cannot control yaw, it is
    given up, and the balance of the hover keeps the rate of rotation low.
    """
    matrix = effectiveness(params)
    count = matrix.shape[1]
    norms = _norms(np.asarray(np.linalg.pinv(matrix), dtype=np.float64))
    used = [rotor for rotor in range(count) if rotor not in failed]
    while len(used) >= 3:
        inverse = np.linalg.pinv(matrix[:, used])
        hover = inverse[:, 0]
        if np.abs(matrix[:, used] @ hover - (1.0, 0.0, 0.0, 0.0)).max() > _ROUNDING:
            return None
        lift = hover * (count / hover.sum())
        if lift.min() >= _LEAST_LIFT:
            break
        used = [rotor for rotor, share in zip(used, lift, strict=True) if share >= _LEAST_LIFT]
    else:
        return None
    controls_yaw = bool(np.linalg.matrix_rank(matrix[:, used]) == 4)
    if not controls_yaw:
        if np.linalg.matrix_rank(matrix[:3, used]) < 3:
            return None
        inverse = np.zeros((len(used), 4))
        inverse[:, :3] = np.linalg.pinv(matrix[:3, used])
    return Mixer(tuple(used), lift, inverse[:, 1:] / norms, controls_yaw)


def _norms(inverse: Array) -> Array:
    """Return the norms (3,) of roll, pitch and yaw from the inverse (n, 4) of all rotors.

    Those of roll and pitch are root mean squares times sqrt(2), over the rotors that the torque uses; that of
    yaw is the greatest element. PX4 divides roll and pitch by the greater of both, here each has its own:
    the gains of `autopilot.control.airframe_gains` refer to these.
    """
    columns = inverse[:, 1:]
    used = (np.abs(columns[:, :2]) > _ROUNDING).sum(axis=0)
    tilt = np.sqrt((columns[:, :2] ** 2).sum(axis=0) / (used / 2.0))
    return np.array((*tilt, np.abs(columns[:, 2]).max()))
