"""Height of the own vehicle from sources that are continuous, whatever the autopilot's own height does.

An autopilot's height may follow its GPS receiver, whose error is metres, may be reset, and may be calibrated
again in flight. A formation needs the height above the ground of the start, without steps:

- With a barometer (ALTITUDE.altitude_monotonic) the height is the integral of the vertical velocity, steered
  to the barometer. The error of that velocity reaches 0.1 m/s where the autopilot fuses GPS heights, so it is
  estimated too: an observer with two states h and v and a double pole at -1/T,

      e = barometer - h,   h' = velocity - v + 2 e / T,   v' = -e / T^2.

  Steps of the barometer are removed from it: changes that two successive samples show.
- Without one, or with one that has stopped or is frozen, it is the autopilot's height less the steps that its
  velocity does not explain.

Its zero is the ground: it follows the source until arming is requested, and is kept from then on.
Everything is down, in metres.
"""

import math

GROUND_TIME_CONSTANT_S = 2.0
"""Of the mean that is the barometer's zero, while the vehicle stands."""
TIME_CONSTANT_S = 1.5
"""T: the barometer's noise of 5 cm at 10 Hz leaves 1.5 cm, a velocity error that changes by 0.02 m/s^2 leaves
4.5 cm."""
BAROMETER_STEP_M = 0.5
"""Change of the barometer's deviation from its mean, in two successive samples, that is a step of it. A
single sample of a barometer has a noise of 9 cm, and lags by up to 15 cm in a climb."""
DEVIATION_GAIN = 0.3
"""Part of a sample's deviation that enters its mean."""
BAROMETER_GAP_US = 1_000_000
"""After this time without a new value the barometer is not used: a step could not be distinguished from a
motion. One that returns continues the present height."""
VEL_ERROR_MAX_M_S = 0.5
"""Limit of the estimated error of the vertical velocity: five times what a PX4 that follows its GPS has."""
STEP_M, STEP_M_S2 = 0.5, 10.0
"""A change of the autopilot's height beyond the motion that its velocity explains is a step above the first
plus the way of the second, an acceleration that reverses halfway between two messages."""


class ContinuousHeight:
    """Height of one vehicle.

    Attributes:
        down_m: the height, positive down from the ground.
        autopilot_down_m: the autopilot's vertical position minus it.
        vel_error_m_s: estimated error of the autopilot's vertical velocity, positive down.
        steps: number of steps removed, of the autopilot's height or of the barometer.

    """

    def __init__(self) -> None:
        self.down_m = 0.0
        self.autopilot_down_m = 0.0
        self.vel_error_m_s = 0.0
        self.steps = 0
        self._time_us = -1
        self._autopilot = (0.0, 0.0)
        """Newest vertical position and velocity of the autopilot."""
        self._zero_m: float | None = None
        """The barometer's altitude at the ground; None without a barometer."""
        self._barometer_us = -1
        """Time of the barometer's last new value."""
        self._altitude_m = math.nan
        self._deviation_m = 0.0
        """Barometer minus height, mean of the last samples."""
        self._step_m: float | None = None
        """Change of the deviation in the last sample, if it may be the first of a step."""

    def on_position(self, time_us: int, down_m: float, vel_down_m_s: float, *, standing: bool) -> None:
        """Process the autopilot's vertical position and velocity at a time later than the last one.

        ``standing``: the vehicle has not been armed yet, so that it is on the ground.
        """
        dt_s = 1e-6 * (time_us - self._time_us) if self._time_us >= 0 else 0.0
        before_m, before_m_s = self._autopilot
        moved_m = 0.5 * dt_s * (before_m_s + vel_down_m_s)
        if self._zero_m is not None and time_us - self._barometer_us <= BAROMETER_GAP_US:
            self.down_m += moved_m - dt_s * self.vel_error_m_s
        elif self._time_us >= 0:
            step_m = down_m - before_m - moved_m
            if abs(step_m) > STEP_M + STEP_M_S2 * (0.5 * dt_s) ** 2:
                self.autopilot_down_m += step_m
                self.steps += not standing
            self.down_m = down_m - self.autopilot_down_m
            self.vel_error_m_s = 0.0
        else:
            self.down_m = down_m
        if standing:
            self.down_m = self.vel_error_m_s = 0.0
        self.autopilot_down_m = down_m - self.down_m
        self._time_us, self._autopilot = time_us, (down_m, vel_down_m_s)

    def on_barometer(self, time_us: int, altitude_m: float, *, standing: bool) -> None:
        """Process a barometric altitude, positive up; its zero is arbitrary."""
        if self._time_us < 0 or not abs(altitude_m) < 1e5 or altitude_m == self._altitude_m:  # also NaN
            return
        self._altitude_m = altitude_m
        gap_us, self._barometer_us = time_us - self._barometer_us, time_us
        if standing or self._zero_m is None or not 0 < gap_us <= BAROMETER_GAP_US:
            self._follow_ground(altitude_m, gap_us, standing=standing)
            return
        # PX4 stamps the mean of its last samples with the time of sending: in a climb the height lags by some
        # centimetres
        ahead_s = 1e-6 * (time_us - self._time_us)
        since_m = ahead_s * (self._autopilot[1] - self.vel_error_m_s)
        deviation_m = self._zero_m - altitude_m - self.down_m - since_m
        step_m = deviation_m - self._deviation_m
        if abs(step_m) > BAROMETER_STEP_M:
            before_m, self._step_m = self._step_m, step_m
            if before_m is None or before_m * step_m < 0.0:
                return
            step_m = 0.5 * (before_m + step_m)
            self._zero_m -= step_m
            deviation_m -= step_m
            self.steps += 1
        self._step_m = None
        dt_s = 1e-6 * gap_us
        self.down_m += 2.0 * deviation_m * dt_s / TIME_CONSTANT_S
        vel_error_m_s = self.vel_error_m_s - deviation_m * dt_s / TIME_CONSTANT_S**2
        self.vel_error_m_s = min(max(vel_error_m_s, -VEL_ERROR_MAX_M_S), VEL_ERROR_MAX_M_S)
        self.autopilot_down_m = self._autopilot[0] - self.down_m
        self._deviation_m += DEVIATION_GAIN * (deviation_m - self._deviation_m)

    def _follow_ground(self, altitude_m: float, gap_us: int, *, standing: bool) -> None:
        """Set the barometer's zero; one that appears in flight continues the present height."""
        zero_m, ground_m = self._zero_m, altitude_m + self.down_m
        if not standing or zero_m is None or abs(ground_m - zero_m) > BAROMETER_STEP_M:
            self._zero_m = ground_m
        else:
            part = min(1e-6 * gap_us / GROUND_TIME_CONSTANT_S, 1.0)
            self._zero_m = zero_m + part * (ground_m - zero_m)
        self._deviation_m = self._zero_m - ground_m
