"""Clock of one vehicle: the times of its last step, inertial sample and estimate, in one record.

Full steps in Python and fast steps in compiled code write the same record, so no part stores a copy.
"""

import numpy as np
from numpy.typing import NDArray

CLOCK = np.dtype([("now_us", "i8"), ("inertial_us", "i8"), ("estimate_us", "i8")])
"""Simulated times: see the properties of `Clock`."""
LONG_AGO_US = -(1 << 40)
"""Time of a sample that has not arrived yet."""
NOT_ESTIMATED_US = -1
"""Time of the estimate before the first inertial sample."""


class Clock:
    """The times of one vehicle over their record."""

    __slots__ = ("_estimate_us", "_inertial_us", "_now_us", "block")

    def __init__(self, block: NDArray[np.void] | None = None) -> None:
        """Reset a ``block`` (1,) of `CLOCK`, or create one."""
        self.block = np.zeros(1, CLOCK) if block is None else block
        self._now_us: memoryview = self.block["now_us"].data
        self._inertial_us: memoryview = self.block["inertial_us"].data
        self._estimate_us: memoryview = self.block["estimate_us"].data
        self.now_us = 0
        self.inertial_us = LONG_AGO_US
        self.estimate_us = NOT_ESTIMATED_US

    @property
    def now_us(self) -> int:
        """Time of the last HIL_SENSOR, which is the vehicle's time; 0 before the first."""
        return self._now_us[0]

    @now_us.setter
    def now_us(self, time_us: int) -> None:
        self._now_us[0] = time_us

    @property
    def inertial_us(self) -> int:
        """Time of the last HIL_SENSOR with acceleration and body rates."""
        return self._inertial_us[0]

    @inertial_us.setter
    def inertial_us(self, time_us: int) -> None:
        self._inertial_us[0] = time_us

    @property
    def estimate_us(self) -> int:
        """Time of the estimate: of the last inertial sample that the estimator has accepted."""
        return self._estimate_us[0]

    @estimate_us.setter
    def estimate_us(self, time_us: int) -> None:
        self._estimate_us[0] = time_us
