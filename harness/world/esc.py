"""Reports of the vehicles' electronic speed controllers (ESCs)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from autopilot.mavlink.hil_schema import ESC_STATUS
from foundation.airframe.description import Airframe
from foundation.types import Array

PERIOD_US = 40_000
"""25 Hz"""
RPM_PER_RAD_S = 60.0 / (2.0 * np.pi)
MOTORS = 4
"""Motors of one ESC_STATUS."""


class EscStatus(NamedTuple):
    """ESC_STATUS of four motors of n vehicles."""

    rows: NDArray[np.void]
    """(n,)"""
    absent: frozenset[int]
    """Vehicles that do not have these motors."""


class SpeedControllers:
    """Speed controllers of n vehicles; one ESC_STATUS reports four motors."""

    def __init__(self, airframes: Sequence[Airframe]) -> None:
        self._current_a = np.array([[airframe.motor_current_a] for airframe in airframes])
        self._speed_rad_s = np.array([[airframe.current_speed_rad_s] for airframe in airframes])
        rotors = [len(airframe.rotors) for airframe in airframes]
        self._absent = {
            first: frozenset(i for i, count in enumerate(rotors) if count <= first)
            for first in range(0, max(rotors), MOTORS)
        }
        """Vehicles without motor ``first`` and those that follow, by the first motor of each message."""

    def statuses(
        self,
        time_us: int,
        rotor_speed_rad_s: Array,
        effectiveness: Array | None = None,
        density_ratio: Array | None = None,
    ) -> list[EscStatus]:
        """Return ESC_STATUS of the first four motors, the next four and so on.

        ``rotor_speed_rad_s`` and ``effectiveness`` are (n, R), the latter None for 1; ``density_ratio`` (n,)
        is the air density over that at sea level, None for 1. A rotor's torque is proportional to its
        effectiveness, the density and the square of its speed; its power, and thus the current at constant
        voltage, to the cube of its speed. Speeds are positive for either direction of rotation; the voltage
        is 0: unknown.
        """
        current_a = self._current_a * (rotor_speed_rad_s / self._speed_rad_s) ** 3
        if density_ratio is not None:
            current_a *= density_ratio[:, None]
        if effectiveness is not None:
            current_a *= effectiveness
        rpm = np.rint(rotor_speed_rad_s * RPM_PER_RAD_S)
        messages = []
        for first, absent in self._absent.items():
            rows = np.zeros(len(rotor_speed_rad_s), ESC_STATUS.dtype)
            motors = slice(first, first + MOTORS)
            count = rpm[:, motors].shape[1]
            rows["time_usec"] = time_us
            rows["rpm"][:, :count] = rpm[:, motors]
            rows["current"][:, :count] = current_a[:, motors]
            rows["index"] = first
            messages.append(EscStatus(rows, absent))
        return messages
