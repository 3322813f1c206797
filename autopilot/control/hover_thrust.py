"""Hover thrust estimate: a Kalman filter with one state on the vertical acceleration, as in PX4."""

from autopilot.control.params import HoverThrustParams
from foundation.kernels.inner import inner

GRAVITY_M_S2 = 9.80665
"""Standard gravity: PX4's constant"""
_NOISE_TIME_CONSTANT_S = 5.0
_ACC_VARIANCE_START = 5.0
_ACC_VARIANCE_MIN = 1.0
_ACC_VARIANCE_MAX = 400.0


class HoverThrust:
    """Record: settings and state of the estimate. Thrusts are fractions of full thrust."""

    lowest: float
    highest: float
    process_noise_1_s: float
    gate_sigma: float
    thrust: float
    """The estimate."""
    variance: float
    acc_variance: float
    """Variance of the measurement, (m/s^2)^2, estimated from the residuals."""
    residual_mean_m_s2: float
    has_learned: bool


@inner
def learn_hover_thrust(h: HoverThrust, acc_up_m_s2: float, thrust_up: float, dt_s: float) -> None:
    """Update the estimate with the acceleration over ground and the vertical thrust, 0..1.

    Measurement model: upward acceleration = g (thrust / hover - 1), so its derivative by the state is
    -g thrust / hover^2.
    """
    h.has_learned = True
    noise = h.process_noise_1_s * dt_s
    h.variance += noise * noise
    hover = h.thrust
    slope = -GRAVITY_M_S2 * thrust_up / (hover * hover)
    innovation = acc_up_m_s2 - GRAVITY_M_S2 * (thrust_up / hover - 1.0)
    innovation_variance = slope * h.variance * slope + h.acc_variance
    if innovation * innovation <= h.gate_sigma * h.gate_sigma * innovation_variance:
        gain = h.variance * slope / innovation_variance
        hover = min(max(hover + gain * innovation, h.lowest), h.highest)
        h.thrust = hover
        h.variance = max((1.0 - gain * slope) * h.variance, 1e-10)
    residual = acc_up_m_s2 - GRAVITY_M_S2 * (thrust_up / hover - 1.0)
    alpha = dt_s / (dt_s + _NOISE_TIME_CONSTANT_S)
    h.residual_mean_m_s2 += alpha * (residual - h.residual_mean_m_s2)
    deviation = residual - h.residual_mean_m_s2
    spread = deviation * deviation + slope * h.variance * slope
    variance = (1.0 - alpha) * h.acc_variance + alpha * spread
    h.acc_variance = min(max(variance, _ACC_VARIANCE_MIN), _ACC_VARIANCE_MAX)


class HoverThrustEstimator:
    """Settings and resets of the record."""

    def __init__(self, params: HoverThrustParams, *, start: float, record: HoverThrust) -> None:
        """``start``: initial estimate."""
        self._record = record
        self.set_params(params, start=start)

    def set_params(self, params: HoverThrustParams, *, start: float) -> None:
        """Change the settings, in effect from the next update; an estimate is kept, within the new range."""
        self._start = start
        self._initial_variance = params.initial_std**2
        record = self._record
        record.lowest, record.highest = max(start - params.range, 0.05), min(start + params.range, 0.95)
        record.process_noise_1_s, record.gate_sigma = params.process_noise_1_s, params.gate_sigma
        if not record.has_learned:
            self.reset()

    def reset(self) -> None:
        """Reset to the initial estimate, for the next take-off."""
        record = self._record
        record.thrust, record.variance = self._start, self._initial_variance
        record.acc_variance, record.residual_mean_m_s2 = _ACC_VARIANCE_START, 0.0
        record.has_learned = False
