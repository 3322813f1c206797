"""Everybody's odometry of the last seconds, to ask where they were."""

from collections.abc import Sequence

import numpy as np

from autopilot.onboard.kernels import Array, odometry_at, odometry_between

SAMPLES = 64
"""Kept per UAV: two seconds of the own ones at 30 Hz, six of a neighbour's at 10 Hz."""
EXTRAPOLATED_S = 1.0
"""A neighbour is moved on by its velocity for so long at most."""


class Tracks:
    """Odometry of N UAVs.

    Attributes:
        newest: (N, 6) position NED, m, and velocity NED, m/s.
        newest_us: (N,) when that was; -1 before the first.

    """

    def __init__(self, count: int) -> None:
        self.newest = np.zeros((count, 6))
        self.newest_us = np.full(count, -1, np.int64)
        self._times_us = np.zeros((count, SAMPLES), np.int64)
        self._samples = np.zeros((count, SAMPLES, 6))
        self._pushed = np.zeros(count, np.int64)

    def push(
        self, station: int, time_us: int, odometry_ned_m: Sequence[float], vel_ned_m_s: Sequence[float]
    ) -> None:
        """Take a sample; one that is not newer than the newest is ignored."""
        if time_us <= self.newest_us[station]:
            return
        pushed = self._pushed[station]
        slot = pushed % SAMPLES
        self._times_us[station, slot] = self.newest_us[station] = time_us
        self._samples[station, slot] = self.newest[station] = (*odometry_ned_m, *vel_ned_m_s)
        self._pushed[station] = pushed + 1

    def at(self, station: int, time_us: int, out_ned_m: Array) -> int:
        """Odometry (3,) of a UAV at a time; see `odometry_at`."""
        return int(
            odometry_at(
                self._times_us[station], self._samples[station], self._pushed[station], time_us, out_ned_m
            )
        )

    def between(self, i: int, j: int, time_us: int, out_ned_m: Array) -> int:
        """Odometry (3,) of i less that of j; see `odometry_between`."""
        return int(odometry_between(self._times_us, self._samples, self._pushed, i, j, time_us, out_ned_m))

    def now_ned_m(self, now_us: int) -> Array:
        """(N, 3) odometry now, by the newest velocities."""
        age_s = np.minimum((now_us - self.newest_us) * 1e-6, EXTRAPOLATED_S)
        return np.asarray(self.newest[:, :3] + self.newest[:, 3:] * age_s[:, None])
