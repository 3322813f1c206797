"""Disturbance observer: the acceleration that gravity and the vehicle's thrust do not explain.

The estimate includes wind, rotor drag and the error of the hover thrust. The balance is
a = g + R_ned_frd (0, 0, -f) + d, where the thrust acceleration f follows from the collective thrust, the lag
of the motors and the hover thrust. In body axes d is the accelerometer's reading minus the thrust's, so an
attitude error rotates d but does not change its magnitude.
"""

import math
from typing import Annotated

from numba import njit

from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import DisturbanceParams
from foundation.geometry.rotations import rotate
from foundation.types import Array


class Disturbance:
    """Record: settings and state of the observer."""

    motor_lag_s: float
    cutoff_hz: float
    """Of the low-pass; 0: disabled."""
    acc_max_m_s2: float
    """Greatest estimate."""
    acc_ned_m_s2: Annotated[Array, 3]
    """The estimate; zero if the observer is disabled."""
    thrust: float
    """Collective thrust 0..1 that the motors have reached according to the model."""


@njit(cache=True)
def observe_disturbance(
    d: Disturbance, acc_ned: Array, q_ned_frd: Array, thrust: float, hover_thrust: float,
    dt_s: float, observe: bool,  # noqa: FBT001 - kernels take positions
) -> None:  # fmt: skip
    """Update the modelled thrust over the last ``dt_s``, and the estimate if ``observe``."""
    share = 1.0 - math.exp(-dt_s / d.motor_lag_s) if d.motor_lag_s > 0.0 else 1.0
    d.thrust += share * (thrust - d.thrust)
    if not (observe and d.cutoff_hz > 0.0):
        return
    alpha = 1.0 - math.exp(-2.0 * math.pi * d.cutoff_hz * dt_s)
    thrust_acc = GRAVITY_M_S2 * d.thrust / hover_thrust
    q = (q_ned_frd[0], q_ned_frd[1], q_ned_frd[2], q_ned_frd[3])
    north, east, down = rotate(q, (0.0, 0.0, -thrust_acc))
    unexplained = (acc_ned[0] - north, acc_ned[1] - east, acc_ned[2] - down - GRAVITY_M_S2)
    # limited before the filter, so that an impact has no more effect than a gust
    norm = math.sqrt(
        unexplained[0] * unexplained[0] + unexplained[1] * unexplained[1] + unexplained[2] * unexplained[2]
    )
    scale = min(d.acc_max_m_s2 / max(norm, 1e-12), 1.0)
    for i in range(3):
        d.acc_ned_m_s2[i] += alpha * (scale * unexplained[i] - d.acc_ned_m_s2[i])


class DisturbanceObserver:
    """Settings and resets of the record."""

    def __init__(self, params: DisturbanceParams, record: Disturbance) -> None:
        self.record = record
        self.acc_ned_m_s2 = record.acc_ned_m_s2
        """(3,) view of the estimate"""
        self.set_params(params)

    def set_params(self, params: DisturbanceParams) -> None:
        """Change the settings, in effect from the next update; the estimate is kept."""
        record = self.record
        record.motor_lag_s, record.acc_max_m_s2 = params.thrust_lag_s, params.acc_max_m_s2
        record.cutoff_hz = params.cutoff_hz if params.enabled else 0.0

    def reset(self) -> None:
        """Reset the estimate, for example on the ground; the modelled thrust is kept."""
        self.acc_ned_m_s2[:] = 0.0

    def stop_motors(self) -> None:
        """Reset the estimate and the modelled thrust."""
        self.reset()
        self.record.thrust = 0.0
