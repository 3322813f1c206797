"""Control cascade of one vehicle: position, attitude, rates and allocation, each at its own rate."""

import math
from struct import Struct

import numpy as np

from autopilot.control.allocation import Allocator
from autopilot.control.attitude import set_attitude
from autopilot.control.cascade import airmode_above, follow_trajectory
from autopilot.control.disturbance import DisturbanceObserver, observe_disturbance
from autopilot.control.hover_thrust import HoverThrustEstimator
from autopilot.control.inner_loop import follow_attitude, follow_rates
from autopilot.control.params import ControlParams
from autopilot.control.position import PositionController
from autopilot.control.rates import RateController
from autopilot.control.state import CascadeState
from autopilot.control.takeoff import TakeoffPhase, TakeoffRamp, demands_climb
from foundation.geometry.rotations import quat_to_euler
from foundation.kernels.records import new_records
from foundation.types import (
    Array,
    AttitudeSetpoint,
    EstimatorState,
    RateSetpoint,
    Setpoint,
    TrajectorySetpoint,
)

INPUTS = Struct("=4d4q")
"""Fields of the record up to ``flies``, packed at once because single writes to a record are slow."""


class FlightController:
    """Computes motor controls from an estimate and a setpoint."""

    def __init__(self, params: ControlParams) -> None:
        self.params = params
        self.block = block = new_records(CascadeState)
        """(1,) settings and states of all controllers, for compiled code"""
        self._state: CascadeState = block[0]
        self._octets = block.view(np.uint8).data
        # views, because an attribute of a record takes longer
        self._updates: Array = block["updates"]
        self._hover_thrust: Array = block["hover"]["thrust"]
        self._thrust: Array = block["allocation"]["thrust"]
        self._controls: Array = block["allocation"]["controls"][0, : len(params.allocation.rotors)]
        self._unallocated: Array = block["allocation"]["unallocated"][0]
        self._rate_setpoint_frd_rad_s: Array = block["rate_setpoint_frd_rad_s"][0]
        self._torque: Array = block["torque"][0]
        self._output = self._state.position.output
        self._position = PositionController(
            params.position, integral_share=_integral_share(params), records=block["position"]
        )
        self._disturbance = DisturbanceObserver(params.disturbance, self._state.disturbance)
        self._hover = HoverThrustEstimator(
            params.hover_thrust, start=params.position.thr_hover, record=self._state.hover
        )
        self._rates = RateController(params.rate, self._state.rates)
        self._allocator = Allocator(params.allocation, self._state.allocation)
        set_attitude(self._state.attitude, params.attitude)
        self._takeoff = TakeoffRamp(params.position)
        self._setpoint: TrajectorySetpoint | AttitudeSetpoint | None = None
        """Setpoint in use; None while the motors idle or a rate setpoint is used"""
        self._yaw_rad: float | None = None
        self._reset_counter = 0
        block["position_divider"] = params.position_divider

    def set_params(self, params: ControlParams) -> None:
        """Change the settings, in effect from the next update, also in flight.

        Integrals, filters, hover thrust and take-off phase are kept. Observer estimate and velocity integrals
        represent the same disturbance, so enabling or disabling the observer moves it from one to the other.
        Raises ValueError for an infeasible airframe.
        """
        self._allocator.set_params(params.allocation)  # first: it alone may raise, with nothing changed yet
        was_observing, self.params = self.params.disturbance.enabled, params
        self._position.set_params(params.position, integral_share=_integral_share(params))
        self._disturbance.set_params(params.disturbance)
        self._hover.set_params(params.hover_thrust, start=params.position.thr_hover)
        set_attitude(self._state.attitude, params.attitude, controls_yaw=self._allocator.controls_yaw)
        self._rates.set_params(params.rate)
        self._takeoff.set_params(params.position)
        self.block["position_divider"] = params.position_divider
        if was_observing != params.disturbance.enabled:
            self._hand_over_disturbance(to_observer=not was_observing)

    def remove_motors(self, failed: frozenset[int]) -> None:
        """Fly without these motors from the next update, without control of yaw if need be.

        All are used if the others cannot fly (a quadrotor), or CA_FAILURE_MODE is 0.
        """
        if failed != self._allocator.failed:
            self._allocator.remove(failed)
            set_attitude(
                self._state.attitude, self.params.attitude, controls_yaw=self._allocator.controls_yaw
            )

    @property
    def thrust(self) -> float:
        """Commanded collective thrust, 0..1 of full thrust."""
        return self._thrust.item()

    @property
    def rate_setpoint_frd_rad_s(self) -> Array:
        """Rate setpoint (3,), FRD."""
        return self._rate_setpoint_frd_rad_s.copy()

    @property
    def torque(self) -> Array:
        """Normalised torque demand (3,), FRD."""
        return self._torque.copy()

    @property
    def controls(self) -> list[float]:
        """Motor controls (n,) of the last update."""
        controls: list[float] = self._controls.tolist()
        return controls

    @property
    def flies_on(self) -> bool:
        """Whether `cascade.follow_trajectory` on the block is equivalent to another update.

        This is so in flight, if nothing except the estimate has changed since the last update.
        """
        setpoint = self._setpoint
        return (
            isinstance(setpoint, TrajectorySetpoint)
            and (setpoint.yaw_rad is not None or setpoint.yaw_rate_rad_s == 0.0)  # else the heading changes
            and self._takeoff.phase is TakeoffPhase.FLYING
        )

    @property
    def hover_thrust(self) -> float:
        """Hover thrust estimate, 0..1 of full thrust."""
        return self._hover_thrust.item()

    @property
    def disturbance_ned_m_s2(self) -> Array:
        """Estimated external acceleration (3,), NED."""
        return self._disturbance.acc_ned_m_s2.copy()

    @property
    def attitude_setpoint(self) -> AttitudeSetpoint | None:
        """Attitude setpoint; None while the motors idle or a rate setpoint is used."""
        setpoint = self._setpoint
        if not isinstance(setpoint, TrajectorySetpoint):
            return setpoint
        idles = self._takeoff.phase is TakeoffPhase.GROUND
        return AttitudeSetpoint(
            q_ned_frd=self._output.q_ned_frd.copy(),
            yaw_rate_rad_s=0.0 if idles else setpoint.yaw_rate_rad_s,
            thrust=float(self._output.thrust),
        )

    def idle(self) -> None:
        """Stop the motors of a disarmed vehicle, and reset all controllers and estimates."""
        self._leave_position()
        self._yaw_rad = None
        self._disturbance.stop_motors()
        self._hover.reset()
        self._rate_setpoint_frd_rad_s[:] = self._torque[:] = 0.0
        self._rates.reset()
        self._allocator.reset()
        self._takeoff.reset()
        self._controls[:] = 0.0

    def update(self, state: EstimatorState, setpoint: Setpoint, *, dt_s: float, landed: bool) -> list[float]:
        """Return the motor controls (n,), 0..1, for the next ``dt_s`` (> 0).

        Controls are in the order of the airframe's rotors. Call it at every inertial sample: rates and
        attitude run every time, position every ``position_divider``-th time. While ``landed`` nothing
        integrates, and a `TrajectorySetpoint` raises the motor controls only if it demands a climb.
        """
        self._prepare(state, setpoint, dt_s=dt_s, landed=landed)
        if isinstance(setpoint, TrajectorySetpoint):
            self._follow(state, setpoint, dt_s=dt_s, landed=landed)
            return self.controls
        self._leave_position()
        self._yaw_rad = None
        observe_disturbance(
            self._disturbance.record, state.acc_ned_m_s2, state.q_ned_frd, self.thrust, self.hover_thrust,
            dt_s, not landed and state.velocity_valid,
        )  # fmt: skip
        self._rates.start(state.omega_frd_rad_s)
        above = airmode_above(landed, self.params.position.thr_min)
        if isinstance(setpoint, RateSetpoint):
            follow_rates(
                self.block, state.omega_frd_rad_s, setpoint.rate_frd_rad_s, setpoint.thrust, dt_s,
                not landed, above,
            )  # fmt: skip
        else:
            self._setpoint = setpoint
            self.block["by_tilt"] = False
            follow_attitude(
                self.block, state.q_ned_frd, state.omega_frd_rad_s, setpoint.q_ned_frd,
                setpoint.yaw_rate_rad_s, setpoint.thrust, dt_s, not landed, above,
            )  # fmt: skip
        return self.controls

    def _prepare(self, state: EstimatorState, setpoint: Setpoint, *, dt_s: float, landed: bool) -> None:
        """Update the take-off phase; on the ground, reset the integrals and the disturbance."""
        takeoff = self._takeoff
        if landed or takeoff.phase is not TakeoffPhase.FLYING:
            climb = isinstance(setpoint, TrajectorySetpoint) and landed and demands_climb(state, setpoint)
            takeoff.update(landed=landed, demands_climb=climb, dt_s=dt_s)
        if landed:
            self._position.reset()
            self._rates.integral[:] = 0.0
            self._disturbance.reset()

    def _follow(
        self, state: EstimatorState, setpoint: TrajectorySetpoint, *, dt_s: float, landed: bool
    ) -> None:
        """Run the whole cascade, the position loop at its divider."""
        phase = self._takeoff.phase
        yaw_rad = self._update_yaw(state, setpoint, dt_s=dt_s)
        self._position.take(state, setpoint)
        INPUTS.pack_into(
            self._octets, 0, yaw_rad, setpoint.yaw_rate_rad_s, self._takeoff.climb_max_m_s,
            dt_s, state.velocity_valid, phase is TakeoffPhase.GROUND, landed, phase is TakeoffPhase.FLYING,
        )  # fmt: skip
        self._setpoint = setpoint
        self._rates.start(state.omega_frd_rad_s)
        follow_trajectory(self.block, state.estimate)

    def _update_yaw(self, state: EstimatorState, setpoint: TrajectorySetpoint, *, dt_s: float) -> float:
        """Return the heading to follow: the setpoint's, or the present one, turned by its yaw rate."""
        if setpoint.yaw_rad is not None:
            self._yaw_rad = setpoint.yaw_rad
        elif (
            self._yaw_rad is None
            or self._takeoff.phase is TakeoffPhase.GROUND
            or state.reset_counter != self._reset_counter
        ):
            self._yaw_rad = float(quat_to_euler(state.q_ned_frd)[2])
        else:
            self._yaw_rad = math.remainder(self._yaw_rad + setpoint.yaw_rate_rad_s * dt_s, math.tau)
        self._reset_counter = state.reset_counter
        return self._yaw_rad

    def _hand_over_disturbance(self, *, to_observer: bool) -> None:
        """Move the disturbance between observer and integrals, so that the demand stays the same."""
        held_ned_m_s2 = self._disturbance.acc_ned_m_s2.copy()
        if to_observer:
            held_ned_m_s2 = self._position.integral_ned_m_s2.copy()
            norm_m_s2 = math.sqrt(held_ned_m_s2 @ held_ned_m_s2)
            held_ned_m_s2 *= min(self.params.disturbance.acc_max_m_s2 / max(norm_m_s2, 1e-12), 1.0)
        if self._updates[0] > 0:  # else the integrals are not in use and stay zero
            self._position.integral_ned_m_s2[:] -= held_ned_m_s2
        self._disturbance.acc_ned_m_s2[:] = -held_ned_m_s2 if to_observer else 0.0

    def _leave_position(self) -> None:
        """Reset the position loop: the vehicle idles or receives attitude or rate setpoints."""
        self._setpoint = None
        if self._updates[0] > 0:
            self._position.reset()
            self._updates[0] = 0
            self.block["since_position_s"] = 0.0


def _integral_share(params: ControlParams) -> float:
    """Return the scale of the velocity integral gains."""
    return params.disturbance.integral_share if params.disturbance.enabled else 1.0
