"""Disturbance observer: the acceleration that gravity and the own thrust do not explain.

Wind, rotor drag and a wrong hover thrust all end up here. The balance is a = g + R_ned_frd (0, 0, -f) + d
with the thrust acceleration f from the thrust given, the motors' lag and the hover thrust. In body axes d is
the accelerometer's reading less the thrust's, so an attitude error turns it but does not feed it.
"""

import math

import numpy as np
from numba import njit

from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import DisturbanceParams
from autopilot.estimation.rotation import quat_rotate
from autopilot.types import Array


@njit(cache=True)
def _observe(
    acc_ned: Array,
    q_ned_frd: Array,
    thrust_acc: float,
    dt_s: float,
    cutoff_hz: float,
    acc_max: float,
    estimate: Array,
) -> None:
    alpha = 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * dt_s)
    unexplained = acc_ned - quat_rotate(q_ned_frd, np.array([0.0, 0.0, -thrust_acc]))
    unexplained[2] -= GRAVITY_M_S2
    # limited before the filter: a bump is then worth no more than a gust
    norm = math.sqrt(unexplained[0] ** 2 + unexplained[1] ** 2 + unexplained[2] ** 2)
    scale = min(acc_max / max(norm, 1e-12), 1.0)
    for i in range(3):
        estimate[i] += alpha * (scale * unexplained[i] - estimate[i])


class DisturbanceObserver:
    """Low-passed external acceleration."""

    def __init__(self, params: DisturbanceParams) -> None:
        self._params = params
        self.acc_ned_m_s2: Array = np.zeros(3)
        """(3,) the estimate, NED; zero when the observer is switched off"""
        self.thrust = 0.0
        """Collective thrust 0..1 that the motors have reached by their model"""

    def set_params(self, params: DisturbanceParams) -> None:
        """Act by these from the next update on; the estimate stays, to be judged by the caller."""
        self._params = params

    def reset(self) -> None:
        """Nothing is known of what pushes: on the ground, which pushes too. The motors go on as they are."""
        self.acc_ned_m_s2[:] = 0.0

    def update(
        self,
        acc_ned_m_s2: Array,
        q_ned_frd: Array,
        *,
        thrust: float,
        hover_thrust: float,
        dt_s: float,
        observe: bool,
    ) -> None:
        """Follow the thrust given over the last ``dt_s``; ``observe``: learn from the acceleration now."""
        lag_s = self._params.thrust_lag_s
        self.thrust += (1.0 - math.exp(-dt_s / lag_s) if lag_s > 0.0 else 1.0) * (thrust - self.thrust)
        if observe and self._params.enabled:
            _observe(
                acc_ned_m_s2, q_ned_frd, GRAVITY_M_S2 * self.thrust / hover_thrust, dt_s,
                self._params.cutoff_hz, self._params.acc_max_m_s2, self.acc_ned_m_s2,
            )  # fmt: skip
