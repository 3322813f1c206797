"""The stages of the control cascade, each over a record of its own, as functions that a test can call."""

import numpy as np
from numba import njit

from autopilot.control import attitude, disturbance, hover_thrust, position, rates
from autopilot.control.params import (
    AttitudeParams,
    DisturbanceParams,
    HoverThrustParams,
    PositionParams,
    RateParams,
)
from foundation.kernels.records import new_record, new_records
from foundation.types import Array, AttitudeSetpoint, EstimatorState, TrajectorySetpoint


@njit
def _rate_setpoint(record, q_ned_frd, q_setpoint, yaw_rate_rad_s):
    return attitude.rate_setpoint(record, q_ned_frd, q_setpoint, yaw_rate_rad_s)


@njit
def _rate_torque(record, rate, setpoint, unallocated, dt_s, integrate):
    return rates.rate_torque(record, rate, setpoint, unallocated, dt_s, integrate)


@njit
def _learn_hover_thrust(record, acc_up_m_s2, thrust_up, dt_s):
    hover_thrust.learn_hover_thrust(record, acc_up_m_s2, thrust_up, dt_s)


@njit
def _control_position(record, pos, vel, acc, observed, hover, yaw_rad, climb_max, dt_s):
    position.control_position(record, pos, vel, acc, observed, hover, yaw_rad, climb_max, dt_s)


@njit
def integral_shift_m_s2(old_hover, new_hover, acc_down_m_s2):
    return position.integral_shift_m_s2(old_hover, new_hover, acc_down_m_s2)


@njit
def attitude_of(thrust_ned, yaw_rad):
    return position._attitude(thrust_ned, yaw_rad)


class AttitudeStage:
    def __init__(self, params: AttitudeParams) -> None:
        self.record = new_record(attitude.Attitude)
        attitude.set_attitude(self.record, params)

    def update(self, q_ned_frd: Array, setpoint: AttitudeSetpoint) -> Array:
        return _rate_setpoint(self.record, q_ned_frd, setpoint.q_ned_frd, setpoint.yaw_rate_rad_s)


class RateStage(rates.RateController):
    def __init__(self, params: RateParams) -> None:
        self.record = new_record(rates.Rates)
        super().__init__(params, self.record)

    def update(
        self, rate_rad_s: Array, setpoint_rad_s: Array, unallocated: Array, *, dt_s: float, integrate: bool
    ) -> Array:
        self.start(rate_rad_s)
        return _rate_torque(self.record, rate_rad_s, setpoint_rad_s, unallocated, dt_s, integrate)


class HoverThrustStage(hover_thrust.HoverThrustEstimator):
    def __init__(self, params: HoverThrustParams, *, start: float) -> None:
        self.record = new_record(hover_thrust.HoverThrust)
        super().__init__(params, start=start, record=self.record)

    @property
    def thrust(self) -> float:
        return float(self.record.thrust)

    def update(self, *, acc_up_m_s2: float, thrust_up: float, dt_s: float) -> float:
        _learn_hover_thrust(self.record, acc_up_m_s2, thrust_up, dt_s)
        return self.thrust


class DisturbanceStage(disturbance.DisturbanceObserver):
    def __init__(self, params: DisturbanceParams) -> None:
        super().__init__(params, new_record(disturbance.Disturbance))

    def update(
        self, acc_ned_m_s2: Array, q_ned_frd: Array, *, thrust: float, hover_thrust: float, dt_s: float,
        observe: bool,
    ) -> None:  # fmt: skip
        disturbance.observe_disturbance(
            self.record, acc_ned_m_s2, q_ned_frd, thrust, hover_thrust, dt_s, observe
        )


class PositionStage(position.PositionController):
    def __init__(self, params: PositionParams, *, integral_share: float = 1.0) -> None:
        records = new_records(position.Position)
        super().__init__(params, integral_share=integral_share, records=records)
        self.record: position.Position = records[0]

    def update(
        self, state: EstimatorState, setpoint: TrajectorySetpoint, *, yaw_rad: float = 0.0,
        hover_thrust: float = 0.5, disturbance_ned_m_s2: Array | None = None, climb_max_m_s: float = np.inf,
        dt_s: float,
    ) -> position.PositionOutput:  # fmt: skip
        """Return a copy of the output."""
        self.take(state, setpoint)
        observed = np.zeros(3) if disturbance_ned_m_s2 is None else disturbance_ned_m_s2
        _control_position(
            self.record, state.pos_ned_m, state.vel_ned_m_s, state.acc_ned_m_s2, observed, hover_thrust,
            yaw_rad, climb_max_m_s, dt_s,
        )  # fmt: skip
        return self.record.output.copy()
