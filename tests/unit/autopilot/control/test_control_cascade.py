"""The cascade in one compiled step is equal to its separate parts in sequence, to the bit."""

import dataclasses

import numpy as np
import pytest
from control_fixtures import estimate
from control_stages import (
    AttitudeStage,
    DisturbanceStage,
    HoverThrustStage,
    PositionStage,
    RateStage,
    integral_shift_m_s2,
)

from autopilot.control import ControlParams, FlightController
from autopilot.control.allocation import Allocator
from autopilot.control.cascade import airmode_above
from foundation.types import AttitudeSetpoint, TrajectorySetpoint

DT_S = 0.004
PARAMS = ControlParams()


class Parts:
    """The same as `FlightController` in flight, with separate parts."""

    def __init__(self) -> None:
        share = PARAMS.disturbance.integral_share
        self.observer = DisturbanceStage(PARAMS.disturbance)
        self.hover = HoverThrustStage(PARAMS.hover_thrust, start=PARAMS.position.thr_hover)
        self.position = PositionStage(PARAMS.position, integral_share=share)
        self.attitude = AttitudeStage(PARAMS.attitude)
        self.rates = RateStage(PARAMS.rate)
        self.allocator = Allocator(PARAMS.allocation)
        self.output = None
        self.updates = 0

    def update(self, state, setpoint):
        self.observer.update(
            state.acc_ned_m_s2, state.q_ned_frd, thrust=self.allocator.record.thrust,
            hover_thrust=self.hover.thrust, dt_s=DT_S, observe=state.velocity_valid,
        )  # fmt: skip
        if self.updates % PARAMS.position_divider == 0:
            dt_s = DT_S if self.updates == 0 else PARAMS.position_divider * DT_S
            if self.output is not None:
                self._learn(state, dt_s)
            self.output = self.position.update(
                state, setpoint, yaw_rad=setpoint.yaw_rad, hover_thrust=self.hover.thrust,
                disturbance_ned_m_s2=self.observer.acc_ned_m_s2, climb_max_m_s=np.inf, dt_s=dt_s,
            )  # fmt: skip
        self.updates += 1
        goal = AttitudeSetpoint(
            q_ned_frd=self.output.q_ned_frd, yaw_rate_rad_s=setpoint.yaw_rate_rad_s, thrust=self.output.thrust
        )
        rate = self.attitude.update(state.q_ned_frd, goal)
        torque = self.rates.update(
            state.omega_frd_rad_s, rate, self.allocator.record.unallocated, dt_s=DT_S, integrate=True
        )
        thrust = goal.thrust * max(self.attitude.record.tilt_cosine, 0.0)
        above = airmode_above(landed=False, thr_min=PARAMS.position.thr_min)
        return self.allocator.allocate(thrust, torque, airmode=goal.thrust > above)

    def _learn(self, state, dt_s):
        _, x, y, _ = state.q_ned_frd.tolist()
        up = 1.0 - 2.0 * (x * x + y * y)
        if up < 0.5 or not state.velocity_valid:
            return
        old = self.hover.thrust
        new = self.hover.update(
            acc_up_m_s2=-state.acc_ned_m_s2[2], thrust_up=self.observer.record.thrust * up, dt_s=dt_s
        )
        acc_down_m_s2 = self.output.acc_ned_m_s2[2] - self.observer.acc_ned_m_s2[2]
        self.position.integral_ned_m_s2[2] += integral_shift_m_s2(old, new, acc_down_m_s2)


@pytest.mark.parametrize("velocity_valid", [True, False])
def test_equals_its_parts_in_sequence(velocity_valid):
    rng = np.random.default_rng(5)
    controller, parts = FlightController(PARAMS), Parts()
    for step in range(300):
        tilt = 0.3 if step % 50 else 3.0  # sometimes upside down
        q = np.array((1.0, *(tilt * rng.normal(size=3))))
        state = dataclasses.replace(
            estimate(),
            q_ned_frd=q / np.linalg.norm(q),
            omega_frd_rad_s=rng.normal(size=3),
            pos_ned_m=rng.normal(size=3),
            vel_ned_m_s=rng.normal(size=3),
            acc_ned_m_s2=3.0 * rng.normal(size=3),
            velocity_valid=velocity_valid,
        )
        setpoint = TrajectorySetpoint(
            pos_ned_m=rng.normal(size=3), vel_ned_m_s=rng.normal(size=3), yaw_rad=float(rng.normal())
        )
        controls = controller.update(state, setpoint, dt_s=DT_S, landed=False)
        np.testing.assert_array_equal(controls, parts.update(state, setpoint))
        assert controller.hover_thrust == parts.hover.thrust
        assert controller.thrust == parts.allocator.record.thrust
        np.testing.assert_array_equal(controller.disturbance_ned_m_s2, parts.observer.acc_ned_m_s2)
        np.testing.assert_array_equal(controller.attitude_setpoint.q_ned_frd, parts.output.q_ned_frd)
