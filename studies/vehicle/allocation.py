"""Control allocation for random demands, compared with the motors' torque and with the achievable set.

The reference is independent of the allocator: thrust follows Gazebo's motor curve, and the achievable torques
follow from geometry. Four rotors with 0 to 1 of their range reach a zonotope in the plane of roll and pitch
torque: the sum of four segments, one for each rotor's lever.
"""

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from autopilot.control.allocation import Allocator
from autopilot.control.mixing import effectiveness, mixer
from autopilot.control.params import AllocationParams
from foundation.airframe.files import IRIS
from foundation.types import Array

_UNIT = IRIS.propulsion
IDLE_N = _UNIT.thrust_n_s2 * _UNIT.idle_rad_s**2
RANGE_N = _UNIT.thrust_n_s2 * (_UNIT.idle_rad_s + _UNIT.range_rad_s) ** 2 - IDLE_N
"""Thrust of an armed rotor at control 0 (`IDLE_N`), and the increase at control 1 (`RANGE_N`)."""
_MARGIN = 1e-6
"""Distance from the border of the achievable set within which rounding decides."""


class AllocationResult(Struct, frozen=True, kw_only=True):
    """Largest errors over all demands."""

    demands: int
    achievable: int
    """Demands with airmode whose roll and pitch torque is achievable"""
    lowest_control: float
    highest_control: float
    lost_torque_n_m: float
    """Achievable roll and pitch torque that was not produced"""
    turned_rad: float
    """Angle between the produced and the demanded roll and pitch torque, where that is not achievable"""
    misreported_n_m: float
    """Produced torque about any axis less the torque that the allocator reports"""
    added_thrust: float
    """Collective thrust above the demand without airmode"""


def check_allocation(demands: int, seed: int) -> AllocationResult:
    """Allocate ``demands`` random thrusts 0..1 and torques -2..2, with and without airmode."""
    params = AllocationParams()
    rng = np.random.default_rng(seed)
    thrusts = rng.uniform(0.0, 1.0, demands)
    torques = rng.uniform(-2.0, 2.0, (demands, 3)) * rng.choice((0.1, 0.5, 1.0), (demands, 1))
    airmode = rng.random(demands) < 0.5
    allocator = Allocator(params)
    controls, unallocated, collective = np.empty((demands, 4)), np.empty((demands, 3)), np.empty(demands)
    for k in range(demands):
        controls[k] = allocator.allocate(float(thrusts[k]), torques[k], airmode=bool(airmode[k]))
        unallocated[k] = allocator.record.unallocated
        collective[k] = allocator.record.thrust

    levers = effectiveness(params)[1:]  # (3, 4) N m per N
    scale = levers @ mixer(params).torque * RANGE_N  # (3, 3) N m per normalised torque
    speed_rad_s = _UNIT.idle_rad_s + _UNIT.range_rad_s * controls
    given_n_m = _UNIT.thrust_n_s2 * speed_rad_s**2 @ levers.T
    demanded_n_m = torques @ scale.T
    # without airmode the collective may not rise, which limits the torque: only airmode guarantees it
    promised = airmode & _is_achievable(demanded_n_m[:, :2], levers[:2] * RANGE_N)
    refused = airmode & ~_is_achievable(demanded_n_m[:, :2], levers[:2] * RANGE_N, margin=-_MARGIN)
    turned = _angle(given_n_m[refused, :2], demanded_n_m[refused, :2])
    return AllocationResult(
        demands=demands,
        achievable=int(promised.sum()),
        lowest_control=float(controls.min()),
        highest_control=float(controls.max()),
        lost_torque_n_m=float(np.abs(given_n_m - demanded_n_m)[promised, :2].max()),
        turned_rad=float(np.abs(turned).max()),
        misreported_n_m=float(np.abs(given_n_m - (torques - unallocated) @ scale.T).max()),
        added_thrust=float((collective - thrusts)[~airmode].max()),
    )


def _is_achievable(torque_n_m: Array, generators_n_m: Array, margin: float = _MARGIN) -> NDArray[np.bool_]:
    """Return (n,) whether torques (n, 2) are inside the zonotope of ``generators_n_m`` (2, 4) by a margin.

    For each side's normal, |normal . (torque - centre)| is at most half the sum of |normal . generator|.
    """
    centre = generators_n_m.sum(axis=1) / 2.0
    inside = np.ones(len(torque_n_m), dtype=np.bool_)
    for generator in generators_n_m.T:
        normal = np.array((-generator[1], generator[0])) / np.linalg.norm(generator)
        reach = np.abs(normal @ generators_n_m).sum() / 2.0
        inside &= np.abs((torque_n_m - centre) @ normal) <= reach - margin
    return inside


def _angle(first: Array, second: Array) -> Array:
    """Return the angles (n,) between vectors (n, 2), 0 where the first is zero."""
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.asarray(np.where(np.hypot(*first.T) > 1e-9, np.arctan2(cross, (first * second).sum(axis=1)), 0))
