"""Reports of the vehicles' electronic speed controllers (ESCs)."""

import numpy as np
from numpy.typing import NDArray

from autopilot.mavlink.hil_schema import ESC_STATUS
from foundation.types import Array

PERIOD_US = 40_000
"""25 Hz"""
HOVER_CURRENT_A = 4.0
HOVER_SPEED_RAD_S = 806.7
"""Rotor speed of the hovering Iris, 3.8 N per rotor."""
RPM_PER_RAD_S = 60.0 / (2.0 * np.pi)


def statuses(
    time_us: int,
    rotor_speed_rad_s: Array,
    effectiveness: Array | None = None,
    density_ratio: Array | None = None,
) -> NDArray[np.void]:
    """Return ESC_STATUS (n,) for rotor speeds (n, 4) and effectivenesses (n, 4), None for 1.

    ``density_ratio`` (n,) is the air density over that at sea level, None for 1. A rotor's torque is
    proportional to its effectiveness, the density and the square of its speed; its power, and thus the
    current at constant voltage, to the cube of its speed. Speeds are positive for either direction of
    rotation; the voltage is 0: unknown.
    """
    current_a = HOVER_CURRENT_A * (rotor_speed_rad_s / HOVER_SPEED_RAD_S) ** 3
    if density_ratio is not None:
        current_a *= density_ratio[:, None]
    if effectiveness is not None:
        current_a *= effectiveness
    rows = np.zeros(len(rotor_speed_rad_s), ESC_STATUS.dtype)
    rows["time_usec"] = time_us
    rows["rpm"] = np.rint(rotor_speed_rad_s * RPM_PER_RAD_S)
    rows["current"] = current_a
    return rows
