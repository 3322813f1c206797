"""Estimate of the thrust that hovers: a Kalman filter of one state on the vertical acceleration, as PX4's."""

from autopilot.control.params import HoverThrustParams

GRAVITY_M_S2 = 9.80665
"""Standard gravity: PX4's constant"""
_NOISE_TIME_CONSTANT_S = 5.0
_ACC_VARIANCE_START = 5.0
_ACC_VARIANCE_MIN = 1.0
_ACC_VARIANCE_MAX = 400.0


class HoverThrustEstimator:
    """Hover thrust as a fraction of full thrust.

    Measurement model: upward acceleration = g (thrust / hover - 1), so its derivative by the state is
    -g thrust / hover^2. The measurement's variance is learned from the residuals.
    """

    def __init__(self, params: HoverThrustParams, *, start: float) -> None:
        self._params = params
        self._start = start
        self.reset()

    def set_params(self, params: HoverThrustParams, *, start: float) -> None:
        """Act by these from the next update on; what was learned stays, as far as their range lets it."""
        self._params = params
        self._start = start
        if not self._has_learned:
            self.reset()

    def reset(self) -> None:
        """Back to the start, for the next take-off from nothing known."""
        self._has_learned = False
        self.hover_thrust = self._start
        self._variance = self._params.initial_std**2
        self._acc_variance = _ACC_VARIANCE_START
        self._residual_mean = 0.0

    def update(self, *, acc_up_m_s2: float, thrust_up: float, dt_s: float) -> float:
        """Learn from acceleration over ground and the vertical part of the thrust given; the new estimate."""
        p = self._params
        self._has_learned = True
        self._variance += (p.process_noise_1_s * dt_s) ** 2
        slope = -GRAVITY_M_S2 * thrust_up / self.hover_thrust**2
        innovation = acc_up_m_s2 - GRAVITY_M_S2 * (thrust_up / self.hover_thrust - 1.0)
        innovation_variance = slope * self._variance * slope + self._acc_variance
        if innovation * innovation <= p.gate_sigma**2 * innovation_variance:
            gain = self._variance * slope / innovation_variance
            estimate = self.hover_thrust + gain * innovation
            self.hover_thrust = min(max(estimate, self._start - p.range, 0.05), self._start + p.range, 0.95)
            self._variance = max((1.0 - gain * slope) * self._variance, 1e-10)
        residual = acc_up_m_s2 - GRAVITY_M_S2 * (thrust_up / self.hover_thrust - 1.0)
        alpha = dt_s / (dt_s + _NOISE_TIME_CONSTANT_S)
        self._residual_mean += alpha * (residual - self._residual_mean)
        spread = (residual - self._residual_mean) ** 2 + slope * self._variance * slope
        variance = (1.0 - alpha) * self._acc_variance + alpha * spread
        self._acc_variance = min(max(variance, _ACC_VARIANCE_MIN), _ACC_VARIANCE_MAX)
        return self.hover_thrust
