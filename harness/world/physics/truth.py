"""True state of the vehicles after a step, for sensors, recorder and emulator."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foundation.types import Array

TRUTH = np.dtype(
    [
        ("pos_ned_m", "f8", 3),
        ("vel_ned_m_s", "f8", 3),
        ("q_ned_frd", "f8", 4),
        ("omega_frd_rad_s", "f8", 3),
        ("acc_ned_m_s2", "f8", 3),
        ("specific_force_frd_m_s2", "f8", 3),
        ("mean_omega_frd_rad_s", "f8", 3),
    ]
)
"""Row of one vehicle with the fields of `Truth` but the rotors' speeds; one argument of kernels."""


class Truth:
    """State of n vehicles at the end of a step, and means over that step.

    A view of ``rows`` (n,) of `TRUTH` and of the rotors' speeds (n, R), which are not changed afterwards.
    """

    def __init__(self, rows: NDArray[np.void], rotor_speed_rad_s: Array) -> None:
        self.rows = rows
        self.pos_ned_m: Array = rows["pos_ned_m"]
        """(n, 3) centre of mass, from the site's origin; the ground is down = 0."""
        self.vel_ned_m_s: Array = rows["vel_ned_m_s"]
        self.q_ned_frd: Array = rows["q_ned_frd"]
        """(n, 4) wxyz."""
        self.omega_frd_rad_s: Array = rows["omega_frd_rad_s"]
        self.rotor_speed_rad_s = rotor_speed_rad_s
        """(n, R), R the greatest number of rotors of a vehicle; 0 beyond those of the vehicle."""
        self.acc_ned_m_s2: Array = rows["acc_ned_m_s2"]
        """(n, 3) mean acceleration over the step, including contact forces."""
        self.specific_force_frd_m_s2: Array = rows["specific_force_frd_m_s2"]
        """(n, 3) mean specific force over the step at the centre of mass, as an accelerometer measures it.

        Acceleration minus gravity, in the body axes at the middle of the step: (0, 0, -9.8066) for a level
        vehicle at rest, which is also the value before the first step.
        """
        self.mean_omega_frd_rad_s: Array = rows["mean_omega_frd_rad_s"]
        """(n, 3) mean body rate over the step, as a gyroscope measures it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """Two vehicles that touched during the last step."""

    first: int
    second: int
    """Larger than ``first``."""
    pos_ned_m: tuple[float, float, float]
    """One point of contact."""
