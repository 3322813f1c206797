"""Wind observer: the acceleration of the vehicle by wind, estimated from attitude and velocity.

With thrust T along body -z and wind w, both per mass, a = g e_down - T b + w, where b is the body's z axis in
NED. The wind is assumed horizontal, so the vertical row gives the thrust: T = (g - a_down) / b_down. The
horizontal rows then give w = a + (g - a_down) (b_north, b_east) / b_down. The autopilot's commands do not
enter, so the estimate does not depend on the feed-forward, if attitude and velocity have the same time.

With the time constant tau of the low-pass, gusts of spectrum sigma_g, tau_g leave an error of variance
sigma_g^2 tau / (tau + tau_g); a velocity error sigma_v, tau_v adds sigma_v^2 / (tau (tau + tau_v)). With the
article's gusts and a velocity error of 0.06 m/s, 1 s, the sum is minimal at 0.14 s. If attitude and velocity
are a time d apart, however, the share d / tau of each manoeuvre is estimated as wind.
"""

import math

import numpy as np

from foundation.types import Array

GRAVITY_M_S2 = 9.80665
TIME_CONSTANT_S = 0.25
"""Five times the worst time between attitude and velocity, 50 ms."""
ACC_MAX_M_S2 = 4.0
"""Limit of the feed-forward: a tilt of 22 degrees; 5 N on an Iris is 3.2 m/s^2."""
SAMPLE_MAX_M_S2 = 8.0
"""Limit of a sample, so that a bump or a reset of the autopilot's velocity has at most a gust's effect."""
RATE_MAX_M_S3 = 6.0
"""Rate limit of the feed-forward, 0.6 rad/s of tilt: faster than a gust, slower than the attitude loop."""
UP_COSINE_MIN = 0.5
"""Cosine of 60 degrees: beyond this tilt the vertical acceleration is a poor measure of the thrust."""
GAP_MAX_S = 0.2
"""Largest time between two velocities that are differentiated."""


class WindObserver:
    """Low-passed horizontal acceleration by the wind, and the feed-forward against it.

    Attributes:
        acc_ne_m_s2: (2,) estimated acceleration by wind, NED north and east; 0 on the ground.
        feed_forward_ne_m_s2: acceleration setpoint against the wind, limited in size and rate.

    """

    def __init__(self) -> None:
        self.acc_ne_m_s2: Array = np.zeros(2)
        self.feed_forward_ne_m_s2 = (0.0, 0.0)
        self._tilt_sum = (0.0, 0.0)
        self._tilts = 0
        self._time_us = -1
        self._vel_ned_m_s = (0.0, 0.0, 0.0)

    def on_attitude(self, q_ned_frd: tuple[float, float, float, float]) -> None:
        """Process an attitude (wxyz) of ATTITUDE_QUATERNION; any number of them per velocity."""
        w, x, y, z = q_ned_frd
        # The direction of body z.
        north, east, down = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), w * w - x * x - y * y + z * z
        if down > UP_COSINE_MIN:  # false for NaN
            self._tilt_sum = (self._tilt_sum[0] + north / down, self._tilt_sum[1] + east / down)
            self._tilts += 1

    def on_velocity(self, time_us: int, vel_ned_m_s: tuple[float, float, float], *, flying: bool) -> None:
        """Process a velocity: estimate the wind from its change and the attitudes since the last one.

        ``flying``: the vehicle has no contact with the ground; otherwise the estimate is reset.
        """
        tilt_sum, tilts = self._tilt_sum, self._tilts
        self._tilt_sum, self._tilts = (0.0, 0.0), 0
        dt_s = (time_us - self._time_us) * 1e-6 if self._time_us >= 0 else math.inf
        before, self._vel_ned_m_s, self._time_us = self._vel_ned_m_s, vel_ned_m_s, time_us
        if not flying:
            self.acc_ne_m_s2 = np.zeros(2)
            self.feed_forward_ne_m_s2 = (0.0, 0.0)
            return
        if not (tilts and 0.0 < dt_s <= GAP_MAX_S):
            return
        thrust_down = GRAVITY_M_S2 - (vel_ned_m_s[2] - before[2]) / dt_s
        north = (vel_ned_m_s[0] - before[0]) / dt_s + thrust_down * tilt_sum[0] / tilts
        east = (vel_ned_m_s[1] - before[1]) / dt_s + thrust_down * tilt_sum[1] / tilts
        size = math.hypot(north, east)
        if not size < math.inf:
            return
        gain = 1.0 - math.exp(-dt_s / TIME_CONSTANT_S)
        scale = min(1.0, SAMPLE_MAX_M_S2 / max(size, 1e-9))
        known = self.acc_ne_m_s2
        known[0] += gain * (scale * north - known[0])
        known[1] += gain * (scale * east - known[1])
        self._follow(dt_s)

    def _follow(self, dt_s: float) -> None:
        """Move the feed-forward towards minus the estimate, within its limits."""
        north, east = (-self.acc_ne_m_s2).tolist()
        scale = min(1.0, ACC_MAX_M_S2 / max(math.hypot(north, east), 1e-9))
        feed_n, feed_e = self.feed_forward_ne_m_s2
        north, east = scale * north - feed_n, scale * east - feed_e
        part = min(1.0, RATE_MAX_M_S3 * dt_s / max(math.hypot(north, east), 1e-9))
        self.feed_forward_ne_m_s2 = (feed_n + part * north, feed_e + part * east)
