"""Failure detector: excessive roll or pitch, or a motor that draws too little current.

After PX4's FailureDetector. Failsafes act on the failures.
"""

from collections.abc import Sequence
from enum import IntFlag
from math import asin, atan2, cos, pi, radians
from typing import Annotated

from msgspec import Meta, Struct

from foundation.types import Array

US_PER_S = 1_000_000
ESC_TIMEOUT_US = 300_000
"""Age at which ESC telemetry counts as missing."""

Angle = Annotated[float, Meta(ge=0.0, le=pi)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]


class FailureDetectorParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Thresholds and trigger times."""

    roll_max_rad: Angle = radians(60.0)
    """FD_FAIL_R: roll angle that counts as a failure; 0 disables the check"""
    pitch_max_rad: Angle = radians(60.0)
    """FD_FAIL_P: pitch angle that counts as a failure; 0 disables the check"""
    roll_trigger_s: Annotated[float, Meta(ge=0.02, le=5.0)] = 0.3
    """FD_FAIL_R_TTRI: how long the roll angle must be exceeded"""
    pitch_trigger_s: Annotated[float, Meta(ge=0.02, le=5.0)] = 0.3
    """FD_FAIL_P_TTRI: how long the pitch angle must be exceeded"""
    motor_check: Annotated[int, Meta(ge=0, le=1)] = 1
    """FD_ACT_EN: 1 checks the motors' currents"""
    motor_thrust_min: Fraction = 0.2
    """FD_ACT_MOT_THR: fraction of full thrust above which a motor is checked"""
    motor_current_per_thrust_a: Annotated[float, Meta(ge=0.0, le=50.0)] = 2.0
    """FD_ACT_MOT_C2T: least current at full thrust, proportionally less below"""
    motor_timeout_us: Annotated[int, Meta(ge=10_000, le=10_000_000)] = 100_000
    """FD_ACT_MOT_TOUT (there in ms): how long the current must be too low"""


class AttitudeFailure(IntFlag):
    """Detected failures, as bits."""

    ROLL = 1
    PITCH = 2
    """The angle has exceeded its limit for the trigger time."""
    MOTOR = 4
    """`FailureDetector.failed_motors` has the indices; set until disarming."""
    ESC_TELEMETRY = 8
    """Telemetry arrived after arming and has stopped, so motors cannot be checked. No failsafe acts on it."""


def thrust_fraction(control: float, thrust_model_factor: float) -> float:
    """Return the fraction of full thrust for a control u, 0..1: factor u^2 + (1 - factor) u (THR_MDL_FAC)."""
    return control * (thrust_model_factor * control + 1.0 - thrust_model_factor)


class FailureDetector:
    """Failure detector of one vehicle: call `update` several times a second, `on_esc` with new telemetry."""

    def __init__(self, params: FailureDetectorParams) -> None:
        self.failed_motors: frozenset[int] = frozenset()
        """Indices of motor controls; motors are only removed when the vehicle is disarmed."""
        self._attitude = 0
        """`AttitudeFailure` bits of roll and pitch."""
        self._roll_us: int | None = None
        self._pitch_us: int | None = None
        """Since when the angle has exceeded its limit; None if it does not."""
        self._esc_us: int | None = None
        """Time of the last telemetry since arming."""
        self._esc_lost = False
        self._measures_current = False
        """A current above zero was reported; some speed controllers do not measure it."""
        self._low_us: dict[int, int] = {}
        """Since when a motor's current has been too low."""
        self.set_params(params)

    def set_params(self, params: FailureDetectorParams) -> None:
        """Change the settings; without the motor check no motor counts as failed."""
        self.params = params
        limits_rad = [limit for limit in (params.roll_max_rad, params.pitch_max_rad) if limit > 0.0]
        # a tilt below both limits and below 90 degrees exceeds neither
        self._upright_cos = cos(min([*limits_rad, pi / 2.0])) if limits_rad else -2.0
        if not params.motor_check:
            self._reset_motors()

    @property
    def failures(self) -> int:
        """`AttitudeFailure` bits."""
        bits = self._attitude
        if self.failed_motors:
            bits |= _MOTOR
        return bits | _ESC_TELEMETRY if self._esc_lost else bits

    def update(self, now_us: int, q_ned_frd: Array, *, armed: bool) -> int:
        """Update with the attitude (4,), wxyz, and return the `AttitudeFailure` bits.

        Roll and pitch are also checked while disarmed, so that arming can be refused.
        """
        _, x, y, _ = q_ned_frd.tolist()
        if 1.0 - 2.0 * (x * x + y * y) > self._upright_cos:  # the cosine of the tilt
            self._attitude = 0
            self._roll_us = self._pitch_us = None
        else:
            self._judge_attitude(now_us, q_ned_frd)
        if not armed:
            self._esc_us, self._esc_lost, self._measures_current = None, False, False
            self._reset_motors()
        elif self._esc_us is not None:
            self._esc_lost = now_us - self._esc_us > ESC_TIMEOUT_US
        return self.failures

    def on_esc(
        self, time_us: int, currents_a: Sequence[float], controls: Sequence[float], thrust_model_factor: float
    ) -> None:
        """Update with the currents of an armed vehicle's motors (n,) and their demanded controls 0..1.

        A motor has failed if its demand exceeds the minimum thrust and its current is too low in all samples
        over the time-out; samples that are too far apart are not combined.
        """
        if self._esc_us is None or time_us - self._esc_us > ESC_TIMEOUT_US:
            self._low_us.clear()
        self._esc_us = time_us
        params = self.params
        self._measures_current = self._measures_current or max(currents_a) > 0.0
        if not self._measures_current or not params.motor_check:
            return
        for motor, control in enumerate(controls):
            current_a, thrust = currents_a[motor], thrust_fraction(control, thrust_model_factor)
            if thrust <= params.motor_thrust_min or current_a >= thrust * params.motor_current_per_thrust_a:
                self._low_us.pop(motor, None)
            elif time_us - self._low_us.setdefault(motor, time_us) >= params.motor_timeout_us:
                self.failed_motors |= {motor}

    def _judge_attitude(self, now_us: int, q_ned_frd: Array) -> None:
        w, x, y, z = q_ned_frd.tolist()
        roll_rad = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch_rad = asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
        params = self.params
        self._roll_us = _since(self._roll_us, now_us, roll_rad, params.roll_max_rad)
        self._pitch_us = _since(self._pitch_us, now_us, pitch_rad, params.pitch_max_rad)
        self._attitude = 0
        if self._roll_us is not None and now_us - self._roll_us >= params.roll_trigger_s * US_PER_S:
            self._attitude |= _ROLL
        if self._pitch_us is not None and now_us - self._pitch_us >= params.pitch_trigger_s * US_PER_S:
            self._attitude |= _PITCH

    def _reset_motors(self) -> None:
        self.failed_motors = frozenset()
        self._low_us.clear()


_ROLL, _PITCH, _MOTOR, _ESC_TELEMETRY = (int(failure) for failure in AttitudeFailure)
"""As plain integers: operations on the flag type would take longer than the rest of a step."""


def _since(since_us: int | None, now_us: int, angle_rad: float, limit_rad: float) -> int | None:
    """Return since when the angle has exceeded its limit; None if it does not or the limit is 0."""
    if limit_rad == 0.0 or abs(angle_rad) <= limit_rad:
        return None
    return now_us if since_us is None else since_us
