"""Disturbance observer: the acceleration that gravity and the vehicle's thrust do not explain.

The estimate includes wind, rotor drag and the error of the hover thrust. The balance is
a = g + R_ned_frd (0, 0, -f) + d, where the thrust acceleration f follows from the collective thrust, the lag
of the motors and the hover thrust. In body axes d is the accelerometer's reading minus the thrust's, so an
attitude error rotates d but does not change its magnitude.
"""

import math

from numba import njit

from autopilot.control.block import Block, new_block
from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import DisturbanceParams
from foundation.geometry.rotations import rotate
from foundation.types import Array

OBSERVED, THRUST = 0, 3
"""Elements of the memory: the estimate (3,), NED; the collective thrust 0..1 that the motors have reached."""
LAG, CUTOFF, ACC_MAX = range(3)
"""Elements of the settings: motor lag, s; cutoff of the low-pass, Hz (0: disabled); greatest estimate."""


@njit(cache=True)
def observe_disturbance(
    memory: Array, settings: Array, acc_ned: Array, q_ned_frd: Array, thrust: float, hover_thrust: float,
    dt_s: float, observe: bool,  # noqa: FBT001 - kernels take positions
) -> None:  # fmt: skip
    """Update ``memory``: the modelled thrust over the last ``dt_s``, and the estimate if ``observe``."""
    lag_s = settings[LAG]
    share = 1.0 - math.exp(-dt_s / lag_s) if lag_s > 0.0 else 1.0
    memory[THRUST] += share * (thrust - memory[THRUST])
    if not (observe and settings[CUTOFF] > 0.0):
        return
    alpha = 1.0 - math.exp(-2.0 * math.pi * settings[CUTOFF] * dt_s)
    thrust_acc = GRAVITY_M_S2 * memory[THRUST] / hover_thrust
    q = (q_ned_frd[0], q_ned_frd[1], q_ned_frd[2], q_ned_frd[3])
    north, east, down = rotate(q, (0.0, 0.0, -thrust_acc))
    unexplained = (acc_ned[0] - north, acc_ned[1] - east, acc_ned[2] - down - GRAVITY_M_S2)
    # limited before the filter, so that an impact has no more effect than a gust
    norm = math.sqrt(
        unexplained[0] * unexplained[0] + unexplained[1] * unexplained[1] + unexplained[2] * unexplained[2]
    )
    scale = min(settings[ACC_MAX] / max(norm, 1e-12), 1.0)
    for i in range(3):
        memory[OBSERVED + i] += alpha * (scale * unexplained[i] - memory[OBSERVED + i])


class DisturbanceObserver:
    """Low-pass filtered external acceleration."""

    def __init__(self, params: DisturbanceParams, block: Block | None = None) -> None:
        block = new_block() if block is None else block
        self.memory: Array = block["observer"][0]
        """Layout as in `observe_disturbance`, like the settings"""
        self.settings: Array = block["observer_settings"][0]
        self.acc_ned_m_s2: Array = self.memory[OBSERVED:THRUST]
        """(3,) the estimate, NED; zero if the observer is disabled"""
        self.set_params(params)

    @property
    def thrust(self) -> float:
        """Collective thrust 0..1 that the motors have reached according to the model."""
        return float(self.memory[THRUST])

    def set_params(self, params: DisturbanceParams) -> None:
        """Change the settings, in effect from the next update; the estimate is kept."""
        cutoff_hz = params.cutoff_hz if params.enabled else 0.0
        self.settings[:] = (params.thrust_lag_s, cutoff_hz, params.acc_max_m_s2)

    def reset(self) -> None:
        """Reset the estimate, for example on the ground; the modelled thrust is kept."""
        self.acc_ned_m_s2[:] = 0.0

    def stop_motors(self) -> None:
        """Reset the estimate and the modelled thrust."""
        self.memory[:] = 0.0

    def update(
        self, acc_ned_m_s2: Array, q_ned_frd: Array, *, thrust: float, hover_thrust: float, dt_s: float,
        observe: bool,
    ) -> None:  # fmt: skip
        """Update the modelled thrust over the last ``dt_s``, and the estimate if ``observe``."""
        observe_disturbance(
            self.memory, self.settings, acc_ned_m_s2, q_ned_frd, thrust, hover_thrust, dt_s, observe
        )
