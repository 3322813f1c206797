"""Odometry history of all UAVs over the last seconds, with interpolation."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.kernels import Array
from autopilot.onboard.localisation.members import Members

SAMPLES = 64
"""Samples per UAV: 2.1 s of the own odometry at 30 Hz, which `REMEMBERED_S` of `autopilot.parameters.config`
must not exceed, and 6 s of a neighbour's at 10 Hz."""
JUMP_M, JUMP_M_S2 = 0.5, 10.0
"""A step of odometry beyond the motion that its velocity explains is a jump above the first plus the way of
the second, an acceleration that reverses halfway between the two samples."""
EXTRAPOLATED_S = 1.0
"""Longest time by which a neighbour's odometry is extrapolated by its velocity."""
BACK_LIMIT_US = 500_000
"""Longest time by which odometry is extrapolated back before its first sample."""
RING = np.dtype([("pushed", "i8"), ("times_us", "i8", SAMPLES), ("samples", "f8", (SAMPLES, 6))])
"""Ring buffer of a UAV's last samples, position and velocity NED, and the number of all samples so far."""
Rings = NDArray[np.void]
"""(N,) array of `RING`."""


@njit(cache=True)
def push(members: Members, rings: Rings, row: int, time_us: int, sample: Array, step_ne_m: Array) -> bool:
    """Append a sample (6,) of odometry, unless it is not newer than the newest one.

    Returns whether the odometry has made a step that velocities and accelerations do not explain; step_ne_m
    (2,) is then set to it and earlier samples are dropped.
    """
    member, ring = members[row], rings[row]
    before_us, pushed = member["newest_us"], ring["pushed"]
    if time_us <= before_us:
        return False
    newest = member["newest"]
    jumped = False
    if pushed:
        half_s = 0.5e-6 * (time_us - before_us)
        for a in range(2):
            step_ne_m[a] = sample[a] - newest[a] - half_s * (sample[3 + a] + newest[3 + a])
        if abs(step_ne_m[0]) + abs(step_ne_m[1]) > JUMP_M + JUMP_M_S2 * half_s * half_s:
            jumped, pushed = True, 0
    slot = pushed % SAMPLES
    kept = ring["samples"]
    for a in range(6):
        newest[a] = kept[slot, a] = sample[a]
    ring["times_us"][slot] = time_us
    ring["pushed"] = pushed + 1
    member["newest_us"] = time_us
    return jumped


@njit(cache=True)
def odometry_at(rings: Rings, row: int, time_us: int, out_ned_m: Array) -> bool:
    """Interpolate one UAV's odometry at a time (cubic Hermite); fills out_ned_m (3,).

    Returns False if the newest sample is older, or the samples do not reach back that far.
    """
    ring = rings[row]
    times_us, samples, pushed = ring["times_us"], ring["samples"], ring["pushed"]
    held = min(pushed, SAMPLES)
    if held == 0 or time_us > times_us[(pushed - 1) % SAMPLES]:
        return False
    for back in range(1, held + 1):
        k = (pushed - back) % SAMPLES
        if times_us[k] <= time_us:
            if times_us[k] == time_us:
                for a in range(3):
                    out_ned_m[a] = samples[k, a]
                return True
            after = (k + 1) % SAMPLES
            span_s = (times_us[after] - times_us[k]) * 1e-6
            u = (time_us - times_us[k]) * 1e-6 / span_s
            for a in range(3):
                step = samples[after, a] - samples[k, a]
                start = samples[k, 3 + a] * span_s
                end = samples[after, 3 + a] * span_s
                out_ned_m[a] = samples[k, a] + u * (
                    start + u * (3.0 * step - 2.0 * start - end + u * (start + end - 2.0 * step))
                )
            return True
    oldest = (pushed - held) % SAMPLES
    if pushed > SAMPLES or times_us[oldest] - time_us > BACK_LIMIT_US:
        return False
    back_s = (times_us[oldest] - time_us) * 1e-6
    for a in range(3):
        out_ned_m[a] = samples[oldest, a] - samples[oldest, 3 + a] * back_s
    return True


@njit(cache=True, inline="always")
def odometry_between(rings: Rings, i: int, j: int, time_us: int, out_ned_m: Array) -> bool:
    """Fill out_ned_m (3,) with the odometry of UAV i minus that of j at a time; returns as `odometry_at`."""
    far_ned_m = np.empty(3)
    known = odometry_at(rings, i, time_us, out_ned_m) and odometry_at(rings, j, time_us, far_ned_m)
    if known:
        for a in range(3):
            out_ned_m[a] -= far_ned_m[a]
    return known


class Tracks:
    """Odometry of N UAVs: all samples in ``rings`` (N,), and the newest (N, 6) with its time, -1: none."""

    def __init__(self, members: Members) -> None:
        self.rings: Rings = np.zeros(len(members), RING)
        self.newest: Array = members["newest"]
        self.newest_us: NDArray[np.int64] = members["newest_us"]

    def forget(self, row: int) -> None:
        """Drop the samples of a UAV, whose next odometry has another origin."""
        self.rings["pushed"][row] = 0

    def now_ned_m(self, now_us: int) -> Array:
        """Return (N, 3) odometry extrapolated to ``now_us`` by the newest velocities."""
        age_s = np.minimum((now_us - self.newest_us) * 1e-6, EXTRAPOLATED_S)
        return np.asarray(self.newest[:, :3] + self.newest[:, 3:] * age_s[:, None])
