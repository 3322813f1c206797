"""Shared state: the record that full steps in Python and fast steps in compiled code both work on.

It contains the vehicle's clock, the sequence number of its frames and the limits of a run of fast steps. A
step is a full step if it reaches one of these limits:

| limit            | owner           | a full step is due for                                              |
|------------------|-----------------|---------------------------------------------------------------------|
| `decision_us`    | `Vehicle`       | land state, conditions, failsafes and modes                         |
| `application_us` | `Vehicle`       | the loop of the on-board application                                |
| `services_us`    | `Messaging`     | the deadline of a MAVLink service, or messages that wait for a link |
| `record_us`      | `Host`          | a row of the vehicle's record                                       |
| `aiding_us`      | `SensorInput`   | a magnetic field or pressure that the estimator uses                |
| `horizon_us`     | `Estimator`     | a measurement to be fused, or the end of a validity                 |

Other reasons for a full step are found in the received bytes (`fast_step.inertial_step`) or before the run
begins (`Vehicle.begin_fast_steps`).

While a ULog is written the record also collects a row of each inertial sample, which full steps take out. A
full memory makes the next step a full one.
"""

from collections.abc import Sequence
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from autopilot.estimation.clock import CLOCK, Clock


class FastStepLimits(NamedTuple):
    """Times that end a run of fast steps, in microseconds: see the module's table."""

    decision_us: int
    application_us: int
    services_us: int
    record_us: int
    aiding_us: int
    """Only limits steps with a magnetic field or a pressure in HIL_SENSOR; earlier ones are skipped."""
    horizon_us: int
    """Limits the filter's delayed horizon, not the time of the sample; -1: the estimate is not valid."""

    @property
    def full_step_us(self) -> int:
        """Time of the next full step, if no message and no measurement requires an earlier one."""
        return min(self.decision_us, self.application_us, self.services_us, self.record_us)


SAMPLE_ROW = Struct("=21d")
"""Row of an inertial sample: time in us, specific force and body rates as received (3,) each, FRD; then,
after the step, attitude q_ned_frd (4,), body rates less their bias (3,), rate setpoint (3,), torque (3,),
collective thrust."""
TIME, ACCEL, GYRO, ATTITUDE, RATES, RATE_SETPOINT, TORQUE, THRUST, ROW_VALUES = 0, 1, 4, 7, 11, 14, 17, 20, 21
"""Columns of the row, and their number."""
MOST_ROWS = 512
"""Capacity: the longest run of fast steps, `DECISION_PERIOD_US` at 1 kHz, and a second of earlier samples at
250 Hz."""
SAMPLE_LOG = np.dtype([("open", "i8"), ("count", "i8"), ("rows", "f8", (MOST_ROWS, ROW_VALUES))])
"""``open``: whether steps append rows; ``count`` of ``rows`` are filled."""
LIMITS = np.dtype([(name, "i8") for name in FastStepLimits._fields])
SHARED_STATE = np.dtype(
    [("clock", CLOCK), ("sequence", "i8"), ("samples", SAMPLE_LOG), ("flies", "i8"), ("limits", LIMITS)]
)
"""``sequence``: number of the next frame to the simulator. ``flies``: whether a fast step continues the last
trajectory; else the controls are constant."""
_RUN = Struct(f"={1 + len(FastStepLimits._fields)}q")
"""``flies`` and the limits, the last fields, packed at once because single writes to a record are slow."""
_RUN_AT = SHARED_STATE.itemsize - _RUN.size


class SampleRows:
    """The rows of inertial samples that a ULog needs, over their record."""

    def __init__(self, block: NDArray[np.void]) -> None:
        """``block`` is (1,) of `SAMPLE_LOG`."""
        self._open, self._count = block["open"].data, block["count"].data
        self._rows: NDArray[np.float64] = block["rows"][0]
        self._octets = self._rows.reshape(-1).view(np.uint8).data

    def open(self) -> None:
        """Append a row of each step from now on."""
        self._open[0] = 1

    @property
    def count(self) -> int:
        """Number of rows."""
        return self._count[0]

    def append(self, values: Sequence[float]) -> None:
        """Append the row of a full step, in the layout of `SAMPLE_ROW`; there must be room for it."""
        SAMPLE_ROW.pack_into(self._octets, self._count[0] * SAMPLE_ROW.size, *values)
        self._count[0] += 1

    def take(self) -> NDArray[np.float64]:
        """Return the rows (count, ROW_VALUES) in a new array, and remove them."""
        rows = self._rows[: self._count[0]].copy()
        self._count[0] = 0
        return rows


class SharedState:
    """The record of one vehicle, with views for the parts that own its fields."""

    def __init__(self) -> None:
        self.block = np.zeros(1, SHARED_STATE)
        """(1,) of `SHARED_STATE`, for compiled code"""
        self.clock = Clock(self.block["clock"])
        self.sequence = self.block["sequence"]
        """(1,) view of the sequence number"""
        self.samples = SampleRows(self.block["samples"])
        self._octets = self.block.view(np.uint8).data

    def begin_run(self, limits: FastStepLimits, *, flies: bool) -> None:
        """Write what a run of fast steps depends on."""
        _RUN.pack_into(self._octets, _RUN_AT, flies, *limits)
