"""Health checks of sensors and estimate over time: failed navigation, stuck barometer, faulty compass.

Pure state machines over the measurements' times; ``fusion`` acts on the results.
"""

import math

import numpy as np

from autopilot.estimation import kernels
from autopilot.estimation.params import EstimatorParams
from foundation.types import Array

NAVIGATION_FAILURE_US = 1_000_000
NAVIGATION_RECOVERY_US = 2_000_000
NAVIGATION_GAP_US = 1_000_000
"""Fixes further apart do not count as consecutive."""
CONFLICT_SIGMA = 3.0
"""PX4's vertical innovation test: both ratios must exceed it, with the same sign."""
CONFLICT_US = 400_000
PROBATION_US = 10_000_000
STUCK_US = 500_000
STUCK_MOTION_M = 1.0
COMPASS_RECOVERY_US = 10_000_000
COMPASS_ERROR_RAD = math.radians(25.0)
"""PX4's limit of a consistent heading."""
HEADING_KNOWN_RAD = math.radians(15.0)
"""PX4's greatest standard deviation of a heading that is used to check others."""
STRENGTH, INCLINATION = 1, 2
"""Bits of EKF2_MAG_CHECK."""


class NavigationTest:
    """PX4's navigation test: it fails if velocity and position of every fix are rejected for one second.

    It clears after both have been accepted for two seconds, as after a reset to the GPS. If only one of them
    is accepted the test has no result.
    """

    def __init__(self) -> None:
        self.failed = False
        self._refused_since_us: int | None = None
        self._taken_since_us: int | None = None
        self._last_us = 0

    def note(self, *, velocity_taken: bool, position_taken: bool, measured_us: int) -> None:
        """Update with the results of one fix."""
        if velocity_taken != position_taken or measured_us - self._last_us > NAVIGATION_GAP_US:
            self._refused_since_us = self._taken_since_us = None
        self._last_us = measured_us
        if velocity_taken and position_taken:
            self._refused_since_us = None
            if self._taken_since_us is None:
                self._taken_since_us = measured_us
            if measured_us - self._taken_since_us >= NAVIGATION_RECOVERY_US:
                self.failed = False
        elif not velocity_taken and not position_taken:
            self._taken_since_us = None
            if self._refused_since_us is None:
                self._refused_since_us = measured_us
            if measured_us - self._refused_since_us >= NAVIGATION_FAILURE_US:
                self.failed = True


class VerticalConflict:
    """Detects a faulty accelerometer: GPS velocity and barometer agree on a climb that it contradicts (PX4).

    It counts as bad until it has not been contradicted for ten seconds.
    """

    def __init__(self) -> None:
        self.bad = False
        self._since_us: int | None = None
        self._last_us = 0

    def note(self, velocity_sigma: float, height_sigma: float, measured_us: int) -> bool:
        """Update with both downward innovations, in sigma; return whether to reset to the measurements."""
        least = min(abs(velocity_sigma), abs(height_sigma))
        if least < CONFLICT_SIGMA or velocity_sigma * height_sigma < 0.0:
            self._since_us = None
            self.bad = self.bad and measured_us - self._last_us < PROBATION_US
            return False
        if self._since_us is None:
            self._since_us = measured_us
        if measured_us - self._since_us < CONFLICT_US:
            return False
        self.bad = True
        self._last_us = measured_us
        self._since_us = None
        return True


class StuckBarometer:
    """Detects a barometer whose reading repeats to the last bit while the vehicle moves vertically.

    An ideal barometer repeats at rest, so detection requires one metre of motion by the filter's velocity.
    """

    def __init__(self) -> None:
        self.stuck = False
        self._altitude_m = math.nan
        self._since_us = self._last_us = 0
        self._moved_m = 0.0

    def repeats(self, altitude_m: float) -> bool:
        """Return whether a reading is equal to the last one."""
        return altitude_m == self._altitude_m

    def note(self, altitude_m: float, vel_down_m_s: float, time_us: int) -> bool:
        """Update with a reading and the filter's velocity; return whether the barometer is stuck."""
        if altitude_m != self._altitude_m:
            self._altitude_m, self._since_us, self._moved_m = altitude_m, time_us, 0.0
            self.stuck = False
        else:
            self._moved_m += vel_down_m_s * (time_us - self._last_us) * 1e-6
            self.stuck |= time_us - self._since_us >= STUCK_US and abs(self._moved_m) > STUCK_MOTION_M
        self._last_us = time_us
        return self.stuck


def field_disturbed(params: EstimatorParams, q_ned_frd: Array, field_frd_gauss: Array) -> bool:
    """Return whether a magnetic field (3,) fails PX4's checks of strength and inclination for the site."""
    field_ned = np.array(params.magnetic_field_ned_gauss)
    return bool(kernels.field_disturbed(q_ned_frd, field_frd_gauss, field_ned, field_checks(params)))


def field_checks(params: EstimatorParams) -> Array:
    """Return tolerances (2,) of strength and inclination for `kernels.field_disturbed`."""
    strength_gauss = params.mag_check_strength_gauss if params.mag_check & STRENGTH else math.inf
    inclination_rad = params.mag_check_inclination_rad if params.mag_check & INCLINATION else math.inf
    return np.array((strength_gauss, inclination_rad))


class Compass:
    """Health of the magnetometer."""

    def __init__(self) -> None:
        self.disturbed = False
        """The last field differed from the site's."""
        self.faulty = False
        """GPS contradicted the compass; see `note`."""
        self._consistent_since_us: int | None = None

    def note(self, *, consistent: bool, time_us: int) -> None:
        """Clear the fault of the compass once it has been consistent with a known heading for ten seconds."""
        if not consistent:
            self._consistent_since_us = None
        elif self._consistent_since_us is None:
            self._consistent_since_us = time_us
        elif time_us - self._consistent_since_us >= COMPASS_RECOVERY_US:
            self.clear()

    def clear(self) -> None:
        """Clear the fault."""
        self.faulty = False
        self._consistent_since_us = None
