"""Everybody's odometry of the last seconds, to ask where they were."""

import struct
from collections.abc import Sequence

import numpy as np

from autopilot.onboard.kernels import Array, odometry_at, odometry_between

SAMPLES = 64
"""Kept per UAV: `REMEMBERED_S` of the own ones at 30 Hz, six seconds of a neighbour's at 10 Hz."""
JUMP_M = 0.5
"""No step of odometry, beside what velocity explains, is that large in flight..."""
JUMP_M_S2 = 10.0
"""...but for what an acceleration that is over between two samples may come to."""
EXTRAPOLATED_S = 1.0
"""A neighbour is moved on by its velocity for so long at most."""
_SAMPLE = struct.Struct("6d")
"""Of an array's row: written into its memory, for a fifth of the time that assigning it takes."""


class Tracks:
    """Odometry of N UAVs.

    Attributes:
        newest: (N, 6) position NED, m, and velocity NED, m/s.
        newest_us: (N,) when that was; -1 before the first.
        times_us, samples, pushed: (N, L), (N, L, 6) and (N,): rings of the last, and how many came.

    """

    def __init__(self, count: int) -> None:
        self.newest = np.zeros((count, 6))
        self.newest_us = np.full(count, -1, np.int64)
        self.times_us = np.zeros((count, SAMPLES), np.int64)
        self.samples = np.zeros((count, SAMPLES, 6))
        self.pushed = np.zeros(count, np.int64)
        self._newest_bytes, self._samples_bytes = self.newest.data.cast("B"), self.samples.data.cast("B")
        self._last: list[tuple[float, ...]] = [()] * count

    def push(
        self, station: int, time_us: int, odometry_ned_m: Sequence[float], vel_ned_m_s: Sequence[float]
    ) -> tuple[float, float] | None:
        """Take a sample; one that is not newer than the newest is ignored.

        Gives the step (north, east) that the odometry has made beside what the velocities explain, if that is
        none of flight: what came before it is then forgotten.
        """
        before_us = self.newest_us.item(station)
        if time_us <= before_us:
            return None
        jump = None
        pushed = self.pushed.item(station)
        if pushed:
            then_n, then_e, _, then_vel_n, then_vel_e, _ = self._last[station]
            half_s = 0.5e-6 * (time_us - before_us)
            jump_n = odometry_ned_m[0] - then_n - half_s * (vel_ned_m_s[0] + then_vel_n)
            jump_e = odometry_ned_m[1] - then_e - half_s * (vel_ned_m_s[1] + then_vel_e)
            if abs(jump_n) + abs(jump_e) > JUMP_M + JUMP_M_S2 * half_s * half_s:
                jump, pushed = (jump_n, jump_e), 0
        slot = pushed % SAMPLES
        self.times_us[station, slot] = self.newest_us[station] = time_us
        self._last[station] = sample = (*odometry_ned_m, *vel_ned_m_s)
        _SAMPLE.pack_into(self._newest_bytes, station * _SAMPLE.size, *sample)
        _SAMPLE.pack_into(self._samples_bytes, (station * SAMPLES + slot) * _SAMPLE.size, *sample)
        self.pushed[station] = pushed + 1
        return jump

    def forget(self, station: int) -> None:
        """Forget the odometry of a UAV: what comes next has nothing to do with it."""
        self.pushed[station] = 0

    def at(self, station: int, time_us: int, out_ned_m: Array) -> int:
        """Odometry (3,) of a UAV at a time; see `odometry_at`."""
        return int(
            odometry_at(
                self.times_us[station], self.samples[station], self.pushed[station], time_us, out_ned_m
            )
        )

    def between(self, i: int, j: int, time_us: int, out_ned_m: Array) -> int:
        """Odometry (3,) of i less that of j; see `odometry_between`."""
        return int(odometry_between(self.times_us, self.samples, self.pushed, i, j, time_us, out_ned_m))

    def now_ned_m(self, now_us: int) -> Array:
        """(N, 3) odometry now, by the newest velocities."""
        age_s = np.minimum((now_us - self.newest_us) * 1e-6, EXTRAPOLATED_S)
        return np.asarray(self.newest[:, :3] + self.newest[:, 3:] * age_s[:, None])
