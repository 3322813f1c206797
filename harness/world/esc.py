"""What the vehicles' motor controllers report."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.types import Array
from harness.simulator.hil_frames import ESC_STATUS

PERIOD_US = 40_000
"""25 Hz"""
HOVER_CURRENT_A = 4.0
HOVER_SPEED_RAD_S = 806.7
"""Of the Iris: 3.8 N per rotor."""
RPM_PER_RAD_S = 60.0 / (2.0 * np.pi)


class EscReadings(NamedTuple):
    """Of the four motors of each of n vehicles."""

    speed_rpm: Array
    """(n, 4), positive whichever way a rotor is meant to turn"""
    current_a: Array
    """(n, 4)"""


def readings(
    rotor_speed_rad_s: Array, effectiveness: Array | None = None, density_ratio: Array | None = None
) -> EscReadings:
    """Read motors that turn at (n, 4); of rotors (n, 4) that are not whole, None for whole ones.

    ``density_ratio`` (n,) is that of the air over sea level's, None for 1. A rotor's torque goes with the
    square of its speed, with its effectiveness and the density, and so its power, of which the current at the
    battery's voltage is made, with the cube.
    """
    current_a = HOVER_CURRENT_A * (rotor_speed_rad_s / HOVER_SPEED_RAD_S) ** 3
    if density_ratio is not None:
        current_a *= density_ratio[:, None]
    if effectiveness is not None:
        current_a *= effectiveness
    return EscReadings(rotor_speed_rad_s * RPM_PER_RAD_S, current_a)


def statuses(time_us: int, escs: EscReadings) -> NDArray[np.void]:
    """ESC_STATUS of each vehicle, as `harness.simulator.hil_frames` has it; the voltage is 0, not known."""
    rows = np.zeros(len(escs.speed_rpm), ESC_STATUS.dtype)
    rows["time_usec"] = time_us
    rows["rpm"] = np.rint(escs.speed_rpm)
    rows["current"] = escs.current_a
    return rows
