"""A controller of the user in place of the cascade: its calls, its demand, and what ends it."""

import math

import numpy as np
import pytest
from control_fixtures import DT_S, Gusts, Iris, estimate
from user_extensions import CascadeAgain

from autopilot.control import ControlParams, FlightController
from autopilot.control.airframe_gains import acceleration_rad_s2, control_params
from autopilot.control.controller import TORQUE_MAX, ThrustTorque
from autopilot.control.user_control import UserFlightController, unit_torque_m
from foundation.airframe.files import load
from foundation.extension_failure import ExtensionFailure
from foundation.geometry.rotations import quat_from_euler
from foundation.types import AttitudeSetpoint, RateSetpoint, TrajectorySetpoint

PARAMS = ControlParams()
HOVER = TrajectorySetpoint(pos_ned_m=np.array((0.0, 0.0, -5.0)), yaw_rad=0.3)
CLIMB = TrajectorySetpoint(vel_ned_m_s=np.array((0.0, 0.0, -1.0)))
DOWN = TrajectorySetpoint(vel_ned_m_s=np.array((0.0, 0.0, 0.7)))
LEVEL = AttitudeSetpoint(q_ned_frd=np.array((1.0, 0.0, 0.0, 0.0)), yaw_rate_rad_s=0.1, thrust=0.5)
RATES = RateSetpoint(rate_frd_rad_s=np.array((0.1, 0.0, -0.1)), thrust=0.5)
HALF = ThrustTorque(0.5, (0.0, 0.0, 0.0))


class Recorder:
    """Returns ``demand``, or raises it, and keeps the inputs; ``calls`` are the names of the methods."""

    def __init__(self, demand=HALF):
        self.demand, self.calls, self.inputs = demand, [], []

    def reset(self, _state):
        self.calls.append("reset")

    def update(self, inputs):
        self.calls.append("update")
        self.inputs.append(inputs)
        if isinstance(self.demand, Exception):
            raise self.demand
        return self.demand


def controlled_by(controller, params=PARAMS, instance=4):
    return UserFlightController(
        params, make=lambda _: controller, title="autopilot.controller my:Own", instance=instance
    )


@pytest.mark.parametrize(
    "setpoint", [HOVER, CLIMB, LEVEL, RATES], ids=["hover", "climb", "attitude", "rates"]
)
@pytest.mark.parametrize("observes", [True, False])
def test_the_cascade_as_the_users_controller_flies_as_the_cascade_to_the_bit(setpoint, observes):
    params = ControlParams(disturbance=type(PARAMS.disturbance)(enabled=observes))
    flown = []
    for make in (
        lambda: FlightController(params),
        lambda: UserFlightController(params, make=CascadeAgain, title="", instance=0),
    ):
        iris, gusts, controller = (
            Iris(height_m=5.0, noise_seed=2),
            Gusts(mean_n=3.0, gust_rms_n=1.0, seed=3),
            make(),
        )
        controls = []
        for _ in range(round(3.0 / DT_S)):
            motors = controller.update(iris.estimate(), setpoint, dt_s=DT_S, landed=False)
            controls.append(motors)
            iris.step(np.array(motors), gusts.force_ned_n())
        flown.append((controls, controller.hover_thrust, controller.disturbance_ned_m_s2.tolist()))
    assert flown[0] == flown[1]
    assert len(set(map(tuple, flown[0][0]))) > 700


def test_it_is_reset_before_the_first_update_after_arming_and_after_each_landing():
    recorder = Recorder()
    controller = controlled_by(recorder)
    ground, air = estimate(pos_ned_m=(0.0, 0.0, 0.0)), estimate(pos_ned_m=(0.0, 0.0, -2.0))
    for _ in range(10):  # armed, without a demand to climb: the motors idle
        assert controller.update(ground, DOWN, dt_s=DT_S, landed=True) == [0.0] * 4
    assert recorder.calls == []
    controller.update(ground, CLIMB, dt_s=DT_S, landed=True)
    assert recorder.calls == ["reset", "update"]
    assert recorder.inputs[-1].landed
    assert recorder.inputs[-1].climb_max_m_s < 0.0  # the take-off ramp
    for _ in range(round((PARAMS.position.tko_ramp_s + 0.1) / DT_S)):
        controller.update(air, CLIMB, dt_s=DT_S, landed=False)
    assert recorder.calls.count("reset") == 1
    assert recorder.inputs[-1].climb_max_m_s == math.inf
    controller.update(ground, DOWN, dt_s=DT_S, landed=True)
    count = len(recorder.calls)
    controller.update(ground, CLIMB, dt_s=DT_S, landed=True)
    assert recorder.calls[count:] == ["reset", "update"]
    controller.idle()  # disarmed
    controller.update(air, LEVEL, dt_s=DT_S, landed=False)
    assert recorder.calls[count + 2 :] == ["reset", "update"]


def test_the_heading_is_kept_or_turned_where_the_setpoint_has_none():
    recorder = Recorder()
    controller = controlled_by(recorder)
    state = estimate(pos_ned_m=(0.0, 0.0, -5.0), q_ned_frd=quat_from_euler(0.0, 0.0, 1.0))
    controller.update(state, CLIMB, dt_s=DT_S, landed=False)
    assert recorder.inputs[-1].yaw_rad == pytest.approx(1.0)
    turning = TrajectorySetpoint(vel_ned_m_s=np.zeros(3), yaw_rate_rad_s=0.5)
    for _ in range(100):
        controller.update(state, turning, dt_s=DT_S, landed=False)
    assert recorder.inputs[-1].yaw_rad == pytest.approx(1.0 + 100 * 0.5 * DT_S)
    controller.update(state, HOVER, dt_s=DT_S, landed=False)
    assert recorder.inputs[-1].yaw_rad == 0.3


def test_a_unit_of_torque_is_that_of_the_rotors_thrusts():
    torque = np.array((0.1, -0.05, 0.1))
    controller = controlled_by(Recorder(ThrustTorque(0.5, torque)))
    motors = np.array(controller.update(estimate(pos_ned_m=(0.0, 0.0, -5.0)), LEVEL, dt_s=DT_S, landed=False))
    factor = PARAMS.allocation.thrust_model_factor
    thrusts = factor * motors**2 + (1.0 - factor) * motors  # relative to a rotor's full thrust
    moments = [
        np.cross(rotor.position_frd_m, (0.0, 0.0, -thrust))
        + np.array((0.0, 0.0, rotor.direction * PARAMS.allocation.moment_m * thrust))
        for rotor, thrust in zip(PARAMS.allocation.rotors, thrusts, strict=True)
    ]
    np.testing.assert_allclose(np.sum(moments, axis=0), torque * unit_torque_m(PARAMS), atol=1e-12)
    assert thrusts.mean() == pytest.approx(0.5)
    assert controller.thrust == pytest.approx(0.5)


def test_a_controller_knows_its_airframe_and_that_yaw_is_given_up():
    hexacopter, recorder, contexts = load("hexacopter"), Recorder(), []
    controller = UserFlightController(
        control_params(hexacopter),
        make=lambda context: contexts.append(context) or recorder,
        title="autopilot.controller my:Own",
        instance=0,
        airframe=hexacopter,
    )
    assert contexts[0].airframe is hexacopter
    unit_n_m = np.array(contexts[0].unit_torque_m) * hexacopter.propulsion.range_n
    np.testing.assert_allclose(unit_n_m / hexacopter.inertia_kg_m2, acceleration_rad_s2(hexacopter))
    air = estimate(pos_ned_m=(0.0, 0.0, -5.0))
    controller.update(air, LEVEL, dt_s=DT_S, landed=False)
    controller.remove_motors(frozenset({1}))
    controller.update(air, LEVEL, dt_s=DT_S, landed=False)
    assert [each.controls_yaw for each in recorder.inputs] == [True, False]


def test_the_part_of_a_demand_that_the_rotors_cannot_produce_is_reported():
    recorder = Recorder(ThrustTorque(0.5, (3.0, 0.0, 0.0)))
    controller = controlled_by(recorder)
    for _ in range(2):
        controller.update(estimate(pos_ned_m=(0.0, 0.0, -5.0)), LEVEL, dt_s=DT_S, landed=False)
    assert recorder.inputs[0].unallocated.tolist() == [0.0, 0.0, 0.0]
    assert 0.0 < recorder.inputs[1].unallocated[0] < 3.0
    assert not controller.flies_on


@pytest.mark.parametrize(
    ("demand", "what"),
    [
        (ValueError("no\nsolution"), "ValueError: no solution ("),
        ((0.5, (0.0, 0.0, 0.0)), "update returned a tuple; expected a ThrustTorque"),
        (None, "update returned a NoneType; expected a ThrustTorque"),
        (ThrustTorque(0.5, (0.0, 0.0)), "update returned a torque of shape (2,); expected (3,)"),
        (ThrustTorque(0.5, None), "update returned a torque of shape (); expected (3,)"),
        (ThrustTorque(math.nan, (0.0, 0.0, 0.0)), "update returned a thrust of nan; expected 0 to 1"),
        (ThrustTorque(1.01, (0.0, 0.0, 0.0)), "update returned a thrust of 1.01; expected 0 to 1"),
        (ThrustTorque(-0.1, (0.0, 0.0, 0.0)), "update returned a thrust of -0.1; expected 0 to 1"),
        (
            ThrustTorque(0.5, (0.0, math.nan, 0.0)),
            f"update returned a torque of (0, nan, 0); expected -{TORQUE_MAX:g} to {TORQUE_MAX:g}",
        ),
        (ThrustTorque(0.5, (0.0, 0.0, 11.0)), "update returned a torque of (0, 0, 11); expected -10 to 10"),
    ],
)
def test_a_failure_is_one_line_that_names_field_class_and_value(demand, what):
    controller = controlled_by(Recorder(demand))
    with pytest.raises(ExtensionFailure) as caught:
        controller.update(estimate(pos_ned_m=(0.0, 0.0, -5.0)), HOVER, dt_s=DT_S, landed=False)
    text = str(caught.value)
    assert text.startswith(f"autopilot.controller my:Own: {what}")
    assert "\n" not in text
    if isinstance(demand, Exception):
        assert text.endswith(")")
        assert "test_user_control.py:" in text
        assert caught.value.__cause__ is demand
