"""The acceleration that wind gives the vehicle, learned from how it leans and how it moves.

With thrust T along body -z and wind w, per mass, a = g e_down - T b + w, b being the body's z axis in NED.
Its vertical row, the wind being level, gives the thrust: T = (g - a_down) / b_down. What the level rows
leave is w = a + (g - a_down) (b_north, b_east) / b_down. Nothing of the autopilot's commands is in it, so
what is learned does not depend on what is then done with it, as far as attitude and velocity are of one time.

The low-pass has a time constant tau. Gusts of spectrum sigma_g, tau_g leave an error of variance
sigma_g^2 tau / (tau + tau_g); a velocity error sigma_v, tau_v adds sigma_v^2 / (tau (tau + tau_v)). With the
article's gusts (1 N on 1.5 kg, 2 s) and a velocity error of 0.06 m/s, 1 s, the sum is least at 0.14 s. But
where attitude and velocity are a time d apart, d / tau of each manoeuvre feeds back as wind, so the time
constant is longer.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY_M_S2 = 9.80665
TIME_CONSTANT_S = 0.25
"""Five times what 20 Hz setpoints and telemetry put between attitude and velocity at the worst, 50 ms."""
ACC_MAX_M_S2 = 4.0
"""Largest feed-forward: a tilt of 22 degrees; 5 N on an Iris is 3.2 m/s^2."""
SAMPLE_MAX_M_S2 = 8.0
"""A larger sample is cut: a bump or a reset of the autopilot's velocity is then worth no more than a gust."""
RATE_MAX_M_S3 = 6.0
"""Of the feed-forward, 0.6 rad/s of tilt: faster than a gust, slower than the attitude loop."""
UP_COSINE_MIN = 0.5
"""Beyond 60 degrees of tilt the vertical says little of the thrust."""
GAP_MAX_S = 0.2
"""Velocities farther apart in time are not differentiated."""


class WindObserver:
    """Low-passed horizontal acceleration by the wind, and the feed-forward against it.

    Attributes:
        acc_ne_m_s2: (2,) what the wind gives, NED north and east; zero on the ground.

    """

    def __init__(self, *, time_constant_s: float = TIME_CONSTANT_S) -> None:
        self.acc_ne_m_s2: Array = np.zeros(2)
        self._feed_ne_m_s2 = (0.0, 0.0)
        self._time_constant_s = time_constant_s
        self._tilt_sum = (0.0, 0.0)
        self._tilts = 0
        self._time_us = -1
        self._vel_ned_m_s = (0.0, 0.0, 0.0)

    @property
    def feed_forward_ne_m_s2(self) -> tuple[float, float]:
        """Acceleration to ask the autopilot for beside the formation's own, limited in size and rate."""
        return self._feed_ne_m_s2

    def on_attitude(self, q_ned_frd: tuple[float, float, float, float]) -> None:
        """Take an attitude (wxyz), as of ATTITUDE_QUATERNION; any number per velocity."""
        w, x, y, z = q_ned_frd
        # The direction of body z.
        north, east, down = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), w * w - x * x - y * y + z * z
        if down > UP_COSINE_MIN:  # NaN is not
            self._tilt_sum = (self._tilt_sum[0] + north / down, self._tilt_sum[1] + east / down)
            self._tilts += 1

    def on_velocity(self, time_us: int, vel_ned_m_s: tuple[float, float, float], *, flying: bool) -> None:
        """Take a velocity, and learn from its change since the last and the attitudes in between.

        ``flying``: nothing but air touches the vehicle; else what was learned is dropped.
        """
        tilt_sum, tilts = self._tilt_sum, self._tilts
        self._tilt_sum, self._tilts = (0.0, 0.0), 0
        dt_s = (time_us - self._time_us) * 1e-6 if self._time_us >= 0 else math.inf
        before, self._vel_ned_m_s, self._time_us = self._vel_ned_m_s, vel_ned_m_s, time_us
        if not flying:
            self.acc_ne_m_s2 = np.zeros(2)
            self._feed_ne_m_s2 = (0.0, 0.0)
            return
        if not (tilts and 0.0 < dt_s <= GAP_MAX_S):
            return
        thrust_down = GRAVITY_M_S2 - (vel_ned_m_s[2] - before[2]) / dt_s
        north = (vel_ned_m_s[0] - before[0]) / dt_s + thrust_down * tilt_sum[0] / tilts
        east = (vel_ned_m_s[1] - before[1]) / dt_s + thrust_down * tilt_sum[1] / tilts
        size = math.hypot(north, east)
        if not size < math.inf:
            return
        gain = 1.0 - math.exp(-dt_s / self._time_constant_s)
        scale = min(1.0, SAMPLE_MAX_M_S2 / max(size, 1e-9))
        known = self.acc_ne_m_s2
        known[0] += gain * (scale * north - known[0])
        known[1] += gain * (scale * east - known[1])
        self._follow(dt_s)

    def _follow(self, dt_s: float) -> None:
        """Bring the feed-forward nearer to minus what is known."""
        north, east = (-self.acc_ne_m_s2).tolist()
        scale = min(1.0, ACC_MAX_M_S2 / max(math.hypot(north, east), 1e-9))
        north, east = scale * north - self._feed_ne_m_s2[0], scale * east - self._feed_ne_m_s2[1]
        part = min(1.0, RATE_MAX_M_S3 * dt_s / max(math.hypot(north, east), 1e-9))
        self._feed_ne_m_s2 = (self._feed_ne_m_s2[0] + part * north, self._feed_ne_m_s2[1] + part * east)
