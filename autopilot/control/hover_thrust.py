"""Hover thrust estimate: a Kalman filter with one state on the vertical acceleration, as in PX4."""

from numba import njit

from autopilot.control.block import Block, new_block
from autopilot.control.params import HoverThrustParams
from foundation.types import Array

GRAVITY_M_S2 = 9.80665
"""Standard gravity: PX4's constant"""
_NOISE_TIME_CONSTANT_S = 5.0
_ACC_VARIANCE_START = 5.0
_ACC_VARIANCE_MIN = 1.0
_ACC_VARIANCE_MAX = 400.0
HOVER, VARIANCE, ACC_VARIANCE, RESIDUAL_MEAN, HAS_LEARNED = range(5)
"""Elements of the memory: the estimate, its variance, the measurement's variance and mean residual, 1 or
0."""
LOWEST, HIGHEST, NOISE, GATE = range(4)
"""Elements of the settings: least and greatest estimate, process noise in 1/s, gate in sigma."""


@njit(cache=True)
def learn_hover_thrust(
    memory: Array, settings: Array, acc_up_m_s2: float, thrust_up: float, dt_s: float
) -> None:
    """Update with the acceleration over ground and the vertical thrust, 0..1; changes ``memory``."""
    memory[HAS_LEARNED] = 1.0
    noise = settings[NOISE] * dt_s
    memory[VARIANCE] += noise * noise
    hover = memory[HOVER]
    slope = -GRAVITY_M_S2 * thrust_up / (hover * hover)
    innovation = acc_up_m_s2 - GRAVITY_M_S2 * (thrust_up / hover - 1.0)
    innovation_variance = slope * memory[VARIANCE] * slope + memory[ACC_VARIANCE]
    if innovation * innovation <= settings[GATE] * settings[GATE] * innovation_variance:
        gain = memory[VARIANCE] * slope / innovation_variance
        hover = min(max(hover + gain * innovation, settings[LOWEST]), settings[HIGHEST])
        memory[HOVER] = hover
        memory[VARIANCE] = max((1.0 - gain * slope) * memory[VARIANCE], 1e-10)
    residual = acc_up_m_s2 - GRAVITY_M_S2 * (thrust_up / hover - 1.0)
    alpha = dt_s / (dt_s + _NOISE_TIME_CONSTANT_S)
    memory[RESIDUAL_MEAN] += alpha * (residual - memory[RESIDUAL_MEAN])
    deviation = residual - memory[RESIDUAL_MEAN]
    spread = deviation * deviation + slope * memory[VARIANCE] * slope
    variance = (1.0 - alpha) * memory[ACC_VARIANCE] + alpha * spread
    memory[ACC_VARIANCE] = min(max(variance, _ACC_VARIANCE_MIN), _ACC_VARIANCE_MAX)


class HoverThrustEstimator:
    """Hover thrust as a fraction of full thrust.

    Measurement model: upward acceleration = g (thrust / hover - 1), so its derivative by the state is
    -g thrust / hover^2. The variance of the measurement is estimated from the residuals.
    """

    def __init__(self, params: HoverThrustParams, *, start: float, block: Block | None = None) -> None:
        block = new_block() if block is None else block
        self.memory: Array = block["hover"][0]
        """Layout as in `learn_hover_thrust`, like the settings"""
        self.settings: Array = block["hover_settings"][0]
        self._set(params, start)
        self.reset()

    def set_params(self, params: HoverThrustParams, *, start: float) -> None:
        """Change the settings, in effect from the next update; an estimate is kept, within the new range."""
        self._set(params, start)
        if not self.memory[HAS_LEARNED]:
            self.reset()

    def reset(self) -> None:
        """Reset to the initial estimate, for the next take-off."""
        self.memory[:] = (self._start, self._initial_variance, _ACC_VARIANCE_START, 0.0, 0.0)

    @property
    def hover_thrust(self) -> float:
        """The estimate, 0..1 of full thrust."""
        return self.memory.item(HOVER)

    def update(self, *, acc_up_m_s2: float, thrust_up: float, dt_s: float) -> float:
        """Update with the acceleration over ground and the vertical thrust; returns the new estimate."""
        learn_hover_thrust(self.memory, self.settings, acc_up_m_s2, thrust_up, dt_s)
        return self.hover_thrust

    def _set(self, params: HoverThrustParams, start: float) -> None:
        self._start = start
        self._initial_variance = params.initial_std**2
        lowest, highest = max(start - params.range, 0.05), min(start + params.range, 0.95)
        self.settings[:] = (lowest, highest, params.process_noise_1_s, params.gate_sigma)
