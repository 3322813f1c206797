"""Take-off: detection of a climb demand, and PX4's take-off ramp, a climb limit that raises thrust slowly."""

from enum import Enum

from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import PositionParams
from foundation.types import EstimatorState, TrajectorySetpoint

_CLIMB_HEIGHT_M = 0.3
_CLIMB_SPEED_M_S = 0.3
_CLIMB_ACC_M_S2 = 1.0
"""A setpoint demands a climb if it exceeds one of these"""


class TakeoffPhase(Enum):
    """Phases between ground and flight."""

    GROUND = "ground"
    RAMP = "ramp"
    FLYING = "flying"


def demands_climb(state: EstimatorState, setpoint: TrajectorySetpoint) -> bool:
    """Return whether the setpoint is above the vehicle or moves up by more than the thresholds."""
    pos, vel, acc = setpoint.pos_ned_m, setpoint.vel_ned_m_s, setpoint.acc_ned_m_s2
    return bool(
        (pos is not None and setpoint.pos_axes[2] and pos[2] < state.pos_ned_m[2] - _CLIMB_HEIGHT_M)
        or (vel is not None and setpoint.vel_axes[2] and vel[2] < -_CLIMB_SPEED_M_S)
        or (acc is not None and setpoint.acc_axes[2] and acc[2] < -_CLIMB_ACC_M_S2)
    )


class TakeoffRamp:
    """Take-off phase and its climb limit."""

    def __init__(self, params: PositionParams) -> None:
        self._set(params)
        self.phase = TakeoffPhase.GROUND
        self.climb_max_m_s = self._start_m_s
        """Climb limit, m/s; negative early in the ramp, while thrust is less than the weight"""
        self._ramp_s = 0.0

    def set_params(self, params: PositionParams) -> None:
        """Change the settings, in effect from the next update; phase and elapsed time are kept."""
        self._set(params)
        if self.phase is TakeoffPhase.GROUND:
            self.climb_max_m_s = self._start_m_s

    def reset(self) -> None:
        """Return to the ground phase, for a disarmed vehicle."""
        self._enter(TakeoffPhase.GROUND)

    def update(self, *, landed: bool, demands_climb: bool, dt_s: float) -> TakeoffPhase:
        """Advance by ``dt_s``: a climb demand starts the ramp, which ends in flight. Returns the phase."""
        if self.phase is TakeoffPhase.GROUND:
            if landed and demands_climb:
                self._enter(TakeoffPhase.RAMP)
            elif not landed:
                self._enter(TakeoffPhase.FLYING)
        elif self.phase is TakeoffPhase.RAMP:
            self._ramp_s += dt_s
            share = min(self._ramp_s / self._params.tko_ramp_s, 1.0)
            self.climb_max_m_s = self._start_m_s + share * (self._params.tko_speed_m_s - self._start_m_s)
            if landed and not demands_climb:
                self._enter(TakeoffPhase.GROUND)
            elif share >= 1.0 and not landed:
                self._enter(TakeoffPhase.FLYING)
        elif landed:
            self._enter(TakeoffPhase.GROUND)
        return self.phase

    def _set(self, params: PositionParams) -> None:
        self._params = params
        # the vertical speed error at which the velocity P term reduces thrust to zero
        self._start_m_s = -GRAVITY_M_S2 / params.z_vel_p_acc

    def _enter(self, phase: TakeoffPhase) -> None:
        self.phase = phase
        self._ramp_s = 0.0
        self.climb_max_m_s = float("inf") if phase is TakeoffPhase.FLYING else self._start_m_s
