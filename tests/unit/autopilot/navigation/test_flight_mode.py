"""The interface of a flight mode: a minimal behaviour flies in place of the built-in one."""

import numpy as np
from control_fixtures import estimate
from navigation_fixtures import CONTROL, HOME

from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import ModeInputs
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.setpoints import Navigator
from foundation.types import Course, TrajectorySetpoint


class ClimbForASecond:
    """Climbs for a second, then changes to hold."""

    course = Course.TAKE_OFF

    def enter(self, _entry):
        self._left_s = 1.0

    def update(self, inputs):
        self._left_s -= inputs.dt_s
        return TrajectorySetpoint(vel_ned_m_s=np.array((0.0, 0.0, -1.0)))

    def next_mode(self, _state):
        return FlightMode.HOLD if self._left_s <= 1e-9 else None

    def apply_limits(self):
        pass

    def change_speed(self, speed_m_s):
        pass


def test_another_behaviour_flies_a_mode_until_it_ends():
    level_state = estimate()
    navigator = Navigator(NavigationParams(), CONTROL.trajectory, CONTROL.position)
    navigator.behaviours[FlightMode.TAKEOFF] = ClimbForASecond()
    navigator.enter(FlightMode.TAKEOFF, level_state, landed=False, takeoff_down_m=-2.5, home_ned_m=HOME)
    assert navigator.course is Course.TAKE_OFF
    navigator.change_speed(3.0)
    navigator.set_params(NavigationParams(), CONTROL.trajectory, CONTROL.position)
    steps = 0
    while navigator.next_mode(level_state) is None:
        inputs = ModeInputs(state=level_state, dt_s=0.008, landed=False, touching=False)
        setpoint = navigator.update(inputs)
        steps += 1
    assert steps == 125
    np.testing.assert_array_equal(setpoint.vel_ned_m_s, (0.0, 0.0, -1.0))
    navigator.enter(FlightMode.HOLD, level_state, landed=False, takeoff_down_m=-2.5)
    assert navigator.course is Course.OTHER
