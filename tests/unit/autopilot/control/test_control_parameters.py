"""For all accepted parameters and all setpoints the motors' controls are finite numbers (12 s)."""

import math

import numpy as np
import pytest
from control_fixtures import DT_S, estimate
from control_stages import PositionStage, attitude_of
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from autopilot.control import FlightController
from autopilot.control.params import PositionParams
from autopilot.parameters.table import NOT_OVER, TABLE, ParameterError, ParameterSet, Settings
from foundation.geometry.rotations import quat_rotate
from foundation.types import TrajectorySetpoint

CONTROL = [parameter for parameter in TABLE if parameter.group == "control"]
WIRE_MAX = 3.4e38
"""Greatest value of an offboard setpoint: a float32."""


def within(parameter):
    """Any value of a row, with its limits more often than by chance."""
    ends = st.sampled_from((parameter.minimum, parameter.maximum))
    if parameter.is_integer:
        return ends | st.integers(int(parameter.minimum), int(parameter.maximum))
    return ends | st.floats(parameter.minimum, parameter.maximum)


some_parameters = st.fixed_dictionaries({}, optional={row.name: within(row) for row in CONTROL})
wild = st.sampled_from((0.0, 200.0, -200.0, 1e9, WIRE_MAX, -WIRE_MAX)) | st.floats(-WIRE_MAX, WIRE_MAX)
vectors = st.tuples(wild, wild, wild).map(np.array)
axes = st.tuples(*[st.booleans()] * 3)
setpoints = st.builds(
    TrajectorySetpoint, pos_ned_m=st.none() | vectors, vel_ned_m_s=st.none() | vectors,
    acc_ned_m_s2=st.none() | vectors, pos_axes=axes, vel_axes=axes, acc_axes=axes,
    yaw_rad=st.none() | st.floats(-math.pi, math.pi), yaw_rate_rad_s=st.floats(-1e3, 1e3),
)  # fmt: skip
FAR = TrajectorySetpoint(pos_ned_m=np.array((200.0, 0.0, -5.0)), yaw_rad=0.0)
STOP = TrajectorySetpoint(vel_ned_m_s=np.zeros(3))
ALL_MARGIN = {"MPC_THR_MAX": 0.5, "MPC_THR_XY_MARG": 0.5, "MPC_TILTMAX_AIR": 60.0}


def accepted(overrides):
    try:
        return ParameterSet(Settings(), overrides).settings.control
    except ParameterError:
        assume(False)  # noqa: FBT003  # discards the example
        raise


@settings(max_examples=300, deadline=None)
@example(ALL_MARGIN, [FAR], (0.0, 0.0, 0.0))
@given(
    some_parameters, st.lists(setpoints, min_size=1, max_size=4), st.tuples(*[st.floats(-100.0, 100.0)] * 3)
)
def test_controls_are_finite_for_all_accepted_parameters_and_wild_setpoints(overrides, commands, vel_m_s):
    params = accepted(overrides)
    controller = FlightController(params)
    state = estimate(vel_ned_m_s=np.array(vel_m_s), omega_frd_rad_s=np.array((3.0, -3.0, 1.0)))
    for setpoint in commands:
        for _ in range(2 * params.position_divider):
            controls = np.array(controller.update(state, setpoint, dt_s=DT_S, landed=False))
            assert ((controls >= 0.0) & (controls <= 1.0)).all()
        q_ned_frd = controller.attitude_setpoint.q_ned_frd
        assert q_ned_frd @ q_ned_frd == pytest.approx(1.0)


@settings(max_examples=300, deadline=None)
@example(ALL_MARGIN, FAR, (0.0, 0.0, 0.0), 0.5)
@example({}, STOP, (1.7e-291, 0.0, 3.0), 0.5)  # its square underflows
@given(some_parameters, setpoints, st.tuples(*[st.floats(-100.0, 100.0)] * 3), st.floats(0.05, 0.95))
def test_thrust_and_tilt_keep_their_limits_for_all_accepted_parameters(overrides, setpoint, vel_m_s, hover):
    """Thrust is at least the least thrust, also with a margin of all of it: vertical thrust is not wasted."""
    params = accepted(overrides).position
    output = PositionStage(params).update(
        estimate(vel_ned_m_s=np.array(vel_m_s)), setpoint, yaw_rad=0.3, hover_thrust=hover, dt_s=DT_S
    )
    assert params.thr_min * (1.0 - 1e-9) <= output.thrust <= params.thr_max * (1.0 + 1e-9)
    up = quat_rotate(output.q_ned_frd, np.array((0.0, 0.0, -1.0)))
    assert -up[2] >= math.cos(params.tilt_max_rad) - 1e-7


def test_the_margin_reduces_a_climb_only_by_what_the_steepest_tilt_can_use():
    """200 m away and 200 m up at 20 degrees: all of the 0.5 is along the steepest tilt."""
    params = PositionParams(thr_max=0.5, thr_xy_margin=0.5, tilt_max_rad=math.radians(20.0))
    setpoint = TrajectorySetpoint(acc_ned_m_s2=np.array((100.0, 0.0, -100.0)))
    thrust = PositionStage(params).update(estimate(), setpoint, dt_s=DT_S).thrust_ned
    expected = 0.5 * np.array((math.sin(params.tilt_max_rad), 0.0, -math.cos(params.tilt_max_rad)))
    np.testing.assert_allclose(thrust, expected, atol=1e-12)


@pytest.mark.parametrize("yaw_rad", [0.0, 2.0])
def test_no_thrust_is_level(yaw_rad):
    q_ned_frd = attitude_of((0.0, 0.0, 0.0), yaw_rad)
    np.testing.assert_allclose(
        q_ned_frd, (math.cos(yaw_rad / 2.0), 0.0, 0.0, math.sin(yaw_rad / 2.0)), atol=1e-12
    )


def test_pairs_out_of_order_do_not_reach_the_controller():
    assert ("MPC_THR_MIN", "MPC_THR_MAX") in NOT_OVER
    with pytest.raises(ParameterError, match="at most MPC_THR_MAX"):
        ParameterSet(Settings(), {"MPC_THR_MIN": 0.5, "MPC_THR_MAX": 0.4})
