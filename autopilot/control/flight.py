"""The cascade of one vehicle: position, attitude, rates and allocation at their rates."""

import math

import numpy as np

from autopilot.control.allocation import Allocator
from autopilot.control.attitude import AttitudeController
from autopilot.control.disturbance import DisturbanceObserver
from autopilot.control.hover_thrust import HoverThrustEstimator
from autopilot.control.inner_loop import InnerLoop
from autopilot.control.params import ControlParams
from autopilot.control.position import PositionController, PositionOutput
from autopilot.control.rates import RateController
from autopilot.control.takeoff import Phase, TakeoffRamp, wants_climb
from autopilot.estimation.rotation import quat_from_euler, quat_to_euler
from autopilot.types import (
    Array,
    AttitudeSetpoint,
    EstimatorState,
    RateSetpoint,
    Setpoint,
    TrajectorySetpoint,
)

_HOVER_LEARN_UP = 0.5
"""Least cosine of the tilt at which the hover thrust is learned"""
_ABOVE_LEAST = 1.001
"""A thrust is the least one up to rounding"""


class FlightController:
    """Motor controls from an estimate and a setpoint."""

    def __init__(self, params: ControlParams) -> None:
        self.params = params
        self.attitude_setpoint: AttitudeSetpoint | None = None
        """What the attitude controller follows; None while the motors idle or rates are flown"""
        self._position = PositionController(params.position, integral_share=_integral_share(params))
        self._disturbance = DisturbanceObserver(params.disturbance)
        self._hover = HoverThrustEstimator(params.hover_thrust, start=params.position.thr_hover)
        self._rates = RateController(params.rate)
        self._allocator = Allocator(params.allocation)
        self._attitude = AttitudeController(params.attitude)
        self._inner = InnerLoop(self._attitude, self._rates, self._allocator)
        self._takeoff = TakeoffRamp(params.position)
        self._setpoint: TrajectorySetpoint | None = None
        self._position_output: PositionOutput | None = None
        self._yaw_rad: float | None = None
        self._reset_counter = 0
        self._updates = 0
        self._since_position_s = 0.0

    def set_params(self, params: ControlParams) -> None:
        """Act by these from the next update on, in flight too. Raises ValueError for a frame that cannot fly.

        What flight has taught stays: integrals, filters, hover thrust, phase of the take-off. The observer's
        estimate and the velocity integrals hold the same thing, so switching the observer on or off moves it
        from one to the other.
        """
        self._allocator.set_params(params.allocation)  # the only one that may refuse: nothing has changed yet
        was_observing, self.params = self.params.disturbance.enabled, params
        self._position.set_params(params.position, integral_share=_integral_share(params))
        self._disturbance.set_params(params.disturbance)
        self._hover.set_params(params.hover_thrust, start=params.position.thr_hover)
        self._attitude.set_params(params.attitude)
        self._rates.set_params(params.rate)
        self._takeoff.set_params(params.position)
        if was_observing != params.disturbance.enabled:
            self._hand_over_disturbance(to_observer=not was_observing)

    @property
    def thrust(self) -> float:
        """Collective thrust that the motors were told to give, 0..1 of full."""
        return self._allocator.thrust

    @property
    def rate_setpoint_frd_rad_s(self) -> Array:
        """(3,) what the rate controller follows."""
        return self._inner.rate_setpoint_frd_rad_s.copy()

    @property
    def torque(self) -> Array:
        """(3,) normalised torque asked of the motors, FRD."""
        return self._inner.torque.copy()

    @property
    def hover_thrust(self) -> float:
        """Present estimate of the thrust that hovers, 0..1 of full."""
        return self._hover.hover_thrust

    @property
    def disturbance_ned_m_s2(self) -> Array:
        """(3,) estimated external acceleration, NED."""
        return self._disturbance.acc_ned_m_s2.copy()

    @property
    def trajectory_setpoint(self) -> TrajectorySetpoint | None:
        """The setpoint flown, velocity and acceleration as the position controller decided; None without."""
        if self._setpoint is None or self._position_output is None:
            return None
        return TrajectorySetpoint(
            pos_ned_m=self._setpoint.pos_ned_m,
            pos_axes=self._setpoint.pos_axes,
            vel_ned_m_s=self._position_output.vel_ned_m_s,
            acc_ned_m_s2=self._position_output.acc_ned_m_s2,
            yaw_rad=self._yaw_rad,
            yaw_rate_rad_s=self._setpoint.yaw_rate_rad_s,
        )

    def idle(self) -> Array:
        """(4,) zeros, for a disarmed vehicle; forgets everything that flight had taught."""
        self._leave_position()
        self._yaw_rad = None
        self._disturbance.reset()
        self._disturbance.thrust = 0.0
        self._hover.reset()
        self._inner.reset()
        self._takeoff.reset()
        self.attitude_setpoint = None
        return np.zeros(4)

    def update(
        self,
        state: EstimatorState,
        setpoint: Setpoint,
        *,
        dt_s: float,
        landed: bool,
    ) -> Array:
        """(4,) motor controls 0..1, in the order of the airframe's rotors, for the next ``dt_s`` (> 0).

        Call it at every inertial sample: rates and attitude act every time, position every
        ``position_divider``-th. While ``landed`` nothing integrates, and a `TrajectorySetpoint` spins the
        motors up only when it asks to climb.
        """
        climb = isinstance(setpoint, TrajectorySetpoint) and landed and wants_climb(state, setpoint)
        phase = self._takeoff.update(landed=landed, wants_climb=climb, dt_s=dt_s)
        if landed:
            self._position.reset()
            self._rates.reset_integral()
            self._disturbance.reset()
        self._disturbance.update(
            state.acc_ned_m_s2, state.q_ned_frd, thrust=self._allocator.thrust,
            hover_thrust=self.hover_thrust, dt_s=dt_s, observe=not landed and state.velocity_valid,
        )  # fmt: skip
        # at the least thrust it may be touching down: torque against the ground must not lift it again
        airmode_above = math.inf if landed else self.params.position.thr_min * _ABOVE_LEAST
        if isinstance(setpoint, TrajectorySetpoint):
            attitude = self._follow(state, setpoint, dt_s=dt_s, phase=phase)
        else:
            self._leave_position()
            self._yaw_rad = None
            if isinstance(setpoint, RateSetpoint):
                self.attitude_setpoint = None
                return self._inner.follow_rates(
                    state.omega_frd_rad_s, setpoint, dt_s=dt_s, integrate=not landed,
                    airmode_above=airmode_above,
                )  # fmt: skip
            attitude = setpoint
        self.attitude_setpoint = attitude
        return self._inner.update(
            state.q_ned_frd, state.omega_frd_rad_s, attitude, dt_s=dt_s,
            by_tilt=isinstance(setpoint, TrajectorySetpoint), integrate=not landed,
            airmode_above=airmode_above,
        )  # fmt: skip

    def _follow(
        self, state: EstimatorState, setpoint: TrajectorySetpoint, *, dt_s: float, phase: Phase
    ) -> AttitudeSetpoint:
        """Position loop at its divider, and the yaw setpoint at every call."""
        if setpoint.yaw_rad is not None:
            self._yaw_rad = setpoint.yaw_rad
        elif self._yaw_rad is None or phase is Phase.GROUND or state.reset_counter != self._reset_counter:
            self._yaw_rad = float(quat_to_euler(state.q_ned_frd)[2])
        else:
            self._yaw_rad = math.remainder(self._yaw_rad + setpoint.yaw_rate_rad_s * dt_s, math.tau)
        self._reset_counter = state.reset_counter

        self._since_position_s += dt_s
        output = self._position_output
        if output is None or self._updates % self.params.position_divider == 0:
            if output is not None and phase is Phase.FLYING:
                self._learn_hover_thrust(state, output, self._since_position_s)
            output = self._position.update(
                state, setpoint, yaw_rad=self._yaw_rad, hover_thrust=self.hover_thrust,
                disturbance_ned_m_s2=self._disturbance.acc_ned_m_s2,
                climb_max_m_s=self._takeoff.climb_max_m_s, dt_s=self._since_position_s,
            )  # fmt: skip
            self._position_output = output
            self._since_position_s = 0.0
        self._updates += 1
        self._setpoint = setpoint
        if phase is Phase.GROUND:
            q_level = quat_from_euler(0.0, 0.0, self._yaw_rad)
            return AttitudeSetpoint(q_ned_frd=q_level, yaw_rate_rad_s=0.0, thrust=0.0)
        return output.attitude

    def _learn_hover_thrust(self, state: EstimatorState, output: PositionOutput, dt_s: float) -> None:
        """Vertical acceleration against the thrust given; the velocity integral makes up for the change."""
        _, x, y, _ = state.q_ned_frd.tolist()
        up = 1.0 - 2.0 * (x * x + y * y)
        if up < _HOVER_LEARN_UP or not state.velocity_valid:
            return
        old = self.hover_thrust
        new = self._hover.update(
            acc_up_m_s2=-float(state.acc_ned_m_s2[2]), thrust_up=self._disturbance.thrust * up, dt_s=dt_s
        )
        acc_down = float(output.acc_ned_m_s2[2] - self._disturbance.acc_ned_m_s2[2])
        self._position.hover_thrust_changed(old=old, new=new, acc_down_m_s2=acc_down)

    def _hand_over_disturbance(self, *, to_observer: bool) -> None:
        """Let the integrals hold what the observer held, or the other way round: the demand stays."""
        held_ned_m_s2 = self._disturbance.acc_ned_m_s2.copy()
        if to_observer:
            held_ned_m_s2 = self._position.integral
            norm_m_s2 = math.sqrt(held_ned_m_s2 @ held_ned_m_s2)
            held_ned_m_s2 *= min(self.params.disturbance.acc_max_m_s2 / max(norm_m_s2, 1e-12), 1.0)
        if self._position_output is not None:  # else nobody flies by the integrals, and they stay empty
            self._position.add_to_integral(-held_ned_m_s2)
        self._disturbance.acc_ned_m_s2[:] = -held_ned_m_s2 if to_observer else 0.0

    def _leave_position(self) -> None:
        """Forget the position loop: idle, or somebody else commands the attitude."""
        if self._position_output is not None:
            self._position.reset()
            self._position_output = None
            self._setpoint = None
            self._updates = 0
            self._since_position_s = 0.0


def _integral_share(params: ControlParams) -> float:
    """Give the part of the velocity integral gains that acts beside the observer."""
    return params.disturbance.integral_share if params.disturbance.enabled else 1.0
