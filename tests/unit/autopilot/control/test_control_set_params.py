"""Changes of parameters in flight: they act in the next update and keep integrals and estimates (2 s)."""

import math

import numpy as np
import pytest
from control_fixtures import DT_S, Gusts, Iris, estimate, fly
from control_stages import HoverThrustStage
from msgspec.structs import replace

from autopilot.control import ControlParams, FlightController
from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import DisturbanceParams, HoverThrustParams, PositionParams, RateParams
from autopilot.control.takeoff import TakeoffPhase, TakeoffRamp
from foundation.airframe.description import Rotor
from foundation.types import AttitudeSetpoint, TrajectorySetpoint

PARAMS = ControlParams()
WITHOUT_OBSERVER = ControlParams(disturbance=DisturbanceParams(enabled=False))
HERE = TrajectorySetpoint(pos_ned_m=np.array((0.0, 0.0, -5.0)), yaw_rad=0.0)
LEVEL = AttitudeSetpoint(q_ned_frd=np.array((1.0, 0.0, 0.0, 0.0)), yaw_rate_rad_s=0.0, thrust=0.5)


def in_wind(params, seconds=12.0, seed=2):
    """Return a controller and its vehicle after hovering in 3 N of steady wind."""
    iris = Iris(height_m=5.0, noise_seed=seed)
    gusts = Gusts(mean_n=3.0, gust_rms_n=0.0, seed=seed)
    controller = FlightController(params)
    for _ in range(round(seconds / DT_S)):
        iris.step(fly(controller, iris, HERE), gusts.force_ned_n())
    return iris, gusts, controller


def demand_ned_m_s2(controller):
    """Return the acceleration that the thrust has to cause: over ground, minus the disturbance."""
    return controller.block[0].position.output.acc_ned_m_s2 - controller.disturbance_ned_m_s2


def equal_copy(params):
    """Return equal parameters that share no object."""
    return ControlParams(**{
        name: replace(value) if hasattr(value, "__struct_fields__") else value
        for name, value in ((name, getattr(params, name)) for name in params.__struct_fields__)
    })  # fmt: skip


@pytest.mark.parametrize("params", [PARAMS, WITHOUT_OBSERVER])
def test_the_same_parameters_change_nothing_to_the_bit(params):
    """Set at every step from the ground into flight: the same controls as without."""
    flights = []
    for again in (False, True):
        iris, gusts = Iris(noise_seed=4), Gusts(mean_n=3.0, gust_rms_n=0.6, seed=4)
        controller = FlightController(params)
        landed, controls = True, []
        for _ in range(1500):
            if again:
                controller.set_params(equal_copy(params))
            controls.append(fly(controller, iris, HERE, landed=landed))
            iris.step(controls[-1], gusts.force_ned_n())
            landed = landed and bool(iris.pos_ned_m[2] > -0.02)
        assert not landed
        flights.append(np.array(controls))
    np.testing.assert_array_equal(*flights)


def test_a_rate_gain_acts_in_the_next_update():
    """Without I and D the torque is K P (demand - present): twice the P gain is twice the torque."""
    proportional = RateParams(roll_i=0.0, roll_d=0.0)
    params = replace(PARAMS, rate=proportional)
    turning = estimate(omega_frd_rad_s=np.array((0.1, 0.0, 0.0)))
    controller = FlightController(params)
    controller.update(turning, LEVEL, dt_s=DT_S, landed=False)
    assert controller.torque[0] == pytest.approx(-proportional.roll_k * proportional.roll_p * 0.1)
    controller.set_params(replace(params, rate=replace(proportional, roll_p=2.0 * proportional.roll_p)))
    controller.update(turning, LEVEL, dt_s=DT_S, landed=False)
    assert controller.torque[0] == pytest.approx(-2.0 * proportional.roll_k * proportional.roll_p * 0.1)


def test_attitude_and_position_gains_and_limits_act_in_the_next_update():
    controller = FlightController(PARAMS)
    rolled = AttitudeSetpoint(
        q_ned_frd=np.array((math.cos(5e-4), math.sin(5e-4), 0.0, 0.0)), yaw_rate_rad_s=0.0, thrust=0.5
    )
    controller.set_params(replace(PARAMS, attitude=replace(PARAMS.attitude, roll_p=4.0)))
    controller.update(estimate(), rolled, dt_s=DT_S, landed=False)
    assert controller.rate_setpoint_frd_rad_s[0] == pytest.approx(4.0 * 1e-3, rel=1e-6)
    for position, speed_m_s in (
        (PositionParams(xy_p=0.5), 0.5 * 2.0),
        (PositionParams(xy_vel_max_m_s=0.3), 0.3),
    ):
        controller.set_params(replace(PARAMS, position=position))
        for _ in range(PARAMS.position_divider):
            away = TrajectorySetpoint(pos_ned_m=np.array((2.0, 0.0, 0.0)))
            controller.update(estimate(), away, dt_s=DT_S, landed=False)
        assert controller.block[0].position.output.vel_ned_m_s[0] == pytest.approx(speed_m_s)


def test_integrals_filters_and_hover_thrust_stay():
    """All gains of the position loop change: the integral keeps compensating the wind, without a jump."""
    iris, gusts, controller = in_wind(WITHOUT_OBSERVER)
    held_before = controller._position.integral_ned_m_s2.copy()
    hover_before, rate_integral = controller.hover_thrust, controller._rates.integral.copy()
    assert np.linalg.norm(held_before[:2]) > 1.0
    position = PositionParams(xy_vel_i_acc=0.8, xy_p=0.7, z_p=0.8, thr_hover=0.45)
    controller.set_params(replace(WITHOUT_OBSERVER, position=position))
    np.testing.assert_array_equal(controller._position.integral_ned_m_s2, held_before)
    np.testing.assert_array_equal(controller._rates.integral, rate_integral)
    assert controller.hover_thrust == hover_before
    start = iris.pos_ned_m.copy()
    for _ in range(1000):
        iris.step(fly(controller, iris, HERE), gusts.force_ned_n())
    assert np.linalg.norm(iris.pos_ned_m - start) < 0.1


@pytest.mark.parametrize(("before", "after"), [(PARAMS, WITHOUT_OBSERVER), (WITHOUT_OBSERVER, PARAMS)])
def test_switching_the_observer_transfers_the_estimated_wind(before, after):
    """3 N on 1.55 kg are 1.94 m/s^2, which would displace the vehicle by more than a metre."""
    iris, gusts, controller = in_wind(before)
    demand = demand_ned_m_s2(controller)
    assert np.linalg.norm(demand[:2]) == pytest.approx(3.0 / 1.55, rel=0.1)
    observed = controller.disturbance_ned_m_s2
    integral = controller._position.integral_ned_m_s2.copy()
    controller.set_params(after)
    np.testing.assert_allclose(
        controller._position.integral_ned_m_s2 - controller.disturbance_ned_m_s2,
        integral - observed,
        atol=1e-12,
    )
    assert controller.disturbance_ned_m_s2.any() == after.disturbance.enabled
    farthest_m = 0.0
    for _ in range(2000):
        iris.step(fly(controller, iris, HERE), gusts.force_ned_n())
        farthest_m = max(farthest_m, float(np.linalg.norm(iris.pos_ned_m - (0.0, 0.0, -5.0))))
    assert farthest_m < 0.15
    np.testing.assert_allclose(demand_ned_m_s2(controller), demand, atol=0.3)


def test_switching_the_observer_off_with_attitude_setpoints_leaves_no_integral():
    iris, gusts, controller = in_wind(PARAMS)
    for _ in range(5):
        iris.step(fly(controller, iris, LEVEL), gusts.force_ned_n())
    assert controller.disturbance_ned_m_s2.any()
    controller.set_params(WITHOUT_OBSERVER)
    assert not controller.disturbance_ned_m_s2.any()
    assert not controller._position.integral_ned_m_s2.any()


def test_the_transfer_to_the_observer_is_limited():
    controller = FlightController(WITHOUT_OBSERVER)
    controller.update(estimate(), HERE, dt_s=DT_S, landed=False)
    controller._position.reset()
    controller._position.integral_ned_m_s2[:] = (3.0, 4.0, 0.0)
    controller.set_params(replace(PARAMS, disturbance=DisturbanceParams(acc_max_m_s2=1.0)))
    np.testing.assert_allclose(controller.disturbance_ned_m_s2, (-0.6, -0.8, 0.0))
    np.testing.assert_allclose(controller._position.integral_ned_m_s2, (2.4, 3.2, 0.0))


def test_hover_thrust_uses_a_new_initial_value_until_its_first_update():
    estimator = HoverThrustStage(HoverThrustParams(), start=0.5)
    estimator.set_params(HoverThrustParams(), start=0.4)
    assert estimator.thrust == 0.4
    for _ in range(300):
        estimator.update(acc_up_m_s2=0.0, thrust_up=0.45, dt_s=0.008)
    learned = estimator.thrust
    assert learned == pytest.approx(0.45, abs=0.005)
    estimator.set_params(HoverThrustParams(process_noise_1_s=0.01), start=0.5)
    assert estimator.thrust == learned
    estimator.reset()
    assert estimator.thrust == 0.5


def test_the_take_off_ramp_continues():
    """Half-way through 3 s the new limit is half-way between the new start and the new end."""
    ramp = TakeoffRamp(PARAMS.position)
    step = {"landed": True, "demands_climb": True, "dt_s": 0.1}
    ramp.update(**step)
    for _ in range(14):
        ramp.update(**step)
    new = PositionParams(z_vel_p_acc=8.0, tko_speed_m_s=2.5)
    ramp.set_params(new)
    assert ramp.update(**step) is TakeoffPhase.RAMP
    start_m_s = -GRAVITY_M_S2 / 8.0
    assert ramp.climb_max_m_s == pytest.approx(0.5 * (start_m_s + 2.5))


def test_an_infeasible_airframe_is_rejected_and_nothing_changes():
    controller = FlightController(PARAMS)
    in_line = tuple(
        Rotor(position_frd_m=(x, 0.0, 0.0), turns=turns)
        for x, turns in ((1.0, "ccw"), (2.0, "cw"), (-1.0, "ccw"), (-2.0, "cw"))
    )
    wrong = replace(
        WITHOUT_OBSERVER, allocation=replace(PARAMS.allocation, rotors=in_line), rate=RateParams(roll_p=0.3)
    )
    with pytest.raises(ValueError, match="independently"):
        controller.set_params(wrong)
    assert controller.params is PARAMS
    same = FlightController(PARAMS)
    turning = estimate(omega_frd_rad_s=np.array((0.1, 0.2, 0.0)))
    np.testing.assert_array_equal(
        controller.update(turning, HERE, dt_s=DT_S, landed=False),
        same.update(turning, HERE, dt_s=DT_S, landed=False),
    )
