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
"""

from struct import Struct
from typing import NamedTuple

import numpy as np

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


LIMITS = np.dtype([(name, "i8") for name in FastStepLimits._fields])
SHARED_STATE = np.dtype([("clock", CLOCK), ("sequence", "i8"), ("flies", "i8"), ("limits", LIMITS)])
"""``sequence``: number of the next frame to the simulator. ``flies``: whether a fast step continues the last
trajectory; else the controls are constant."""
_RUN = Struct(f"={1 + len(FastStepLimits._fields)}q")
"""``flies`` and the limits, the last fields, packed at once because single writes to a record are slow."""
_RUN_AT = SHARED_STATE.itemsize - _RUN.size


class SharedState:
    """The record of one vehicle, with views for the parts that own its fields."""

    def __init__(self) -> None:
        self.block = np.zeros(1, SHARED_STATE)
        """(1,) of `SHARED_STATE`, for compiled code"""
        self.clock = Clock(self.block["clock"])
        self.sequence = self.block["sequence"]
        """(1,) view of the sequence number"""
        self._octets = self.block.view(np.uint8).data

    def begin_run(self, limits: FastStepLimits, *, flies: bool) -> None:
        """Write what a run of fast steps depends on."""
        _RUN.pack_into(self._octets, _RUN_AT, flies, *limits)
