"""The cascade in one compiled step is equal to its separate parts in sequence, to the bit."""

import dataclasses

import numpy as np
import pytest
from control_fixtures import estimate

from autopilot.control import ControlParams, FlightController
from autopilot.control.allocation import Allocator
from autopilot.control.attitude import AttitudeController
from autopilot.control.block import new_block
from autopilot.control.cascade import airmode_above
from autopilot.control.disturbance import DisturbanceObserver
from autopilot.control.hover_thrust import HoverThrustEstimator
from autopilot.control.inner_loop import InnerLoop
from autopilot.control.position import PositionController
from autopilot.control.rates import RateController
from foundation.types import TrajectorySetpoint

DT_S = 0.004
PARAMS = ControlParams()


class Parts:
    """The same as `FlightController` in flight, with separate parts."""

    def __init__(self) -> None:
        share = PARAMS.disturbance.integral_share
        self.observer = DisturbanceObserver(PARAMS.disturbance)
        self.hover = HoverThrustEstimator(PARAMS.hover_thrust, start=PARAMS.position.thr_hover)
        self.position = PositionController(PARAMS.position, integral_share=share)
        block = new_block()
        self.allocator = Allocator(PARAMS.allocation, block)
        self.attitude = AttitudeController(PARAMS.attitude, block)
        self.inner = InnerLoop(block, RateController(PARAMS.rate, block), self.allocator)
        self.output = None
        self.updates = 0

    def update(self, state, setpoint):
        self.observer.update(
            state.acc_ned_m_s2, state.q_ned_frd, thrust=self.allocator.thrust,
            hover_thrust=self.hover.hover_thrust, dt_s=DT_S, observe=state.velocity_valid,
        )  # fmt: skip
        if self.updates % PARAMS.position_divider == 0:
            dt_s = DT_S if self.updates == 0 else PARAMS.position_divider * DT_S
            if self.output is not None:
                self._learn(state, dt_s)
            self.output = self.position.update(
                state, setpoint, yaw_rad=setpoint.yaw_rad, hover_thrust=self.hover.hover_thrust,
                disturbance_ned_m_s2=self.observer.acc_ned_m_s2, climb_max_m_s=np.inf, dt_s=dt_s,
            )  # fmt: skip
        self.updates += 1
        return self.inner.update(
            state.q_ned_frd, state.omega_frd_rad_s, self.output.attitude, dt_s=DT_S, by_tilt=True,
            integrate=True, airmode_above=airmode_above(landed=False, thr_min=PARAMS.position.thr_min),
        )  # fmt: skip

    def _learn(self, state, dt_s):
        _, x, y, _ = state.q_ned_frd.tolist()
        up = 1.0 - 2.0 * (x * x + y * y)
        if up < 0.5 or not state.velocity_valid:
            return
        old = self.hover.hover_thrust
        new = self.hover.update(
            acc_up_m_s2=-state.acc_ned_m_s2[2], thrust_up=self.observer.thrust * up, dt_s=dt_s
        )
        acc_down_m_s2 = self.output.acc_ned_m_s2[2] - self.observer.acc_ned_m_s2[2]
        self.position.hover_thrust_changed(old=old, new=new, acc_down_m_s2=acc_down_m_s2)


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
        assert controller.hover_thrust == parts.hover.hover_thrust
        assert controller.thrust == parts.allocator.thrust
        np.testing.assert_array_equal(controller.disturbance_ned_m_s2, parts.observer.acc_ned_m_s2)
        np.testing.assert_array_equal(controller.attitude_setpoint.q_ned_frd, parts.output.attitude.q_ned_frd)
