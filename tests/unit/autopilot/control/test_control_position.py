"""Position control: limits for all setpoints, effect of each group, integrators, estimates."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from control_fixtures import estimate
from control_stages import DisturbanceStage, HoverThrustStage, PositionStage, integral_shift_m_s2

from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import DisturbanceParams, HoverThrustParams, PositionParams
from autopilot.control.takeoff import TakeoffPhase, TakeoffRamp, demands_climb
from foundation.geometry.rotations import quat_from_euler, quat_rotate, quat_to_euler
from foundation.types import TrajectorySetpoint

DT_S = 0.008
GRAVITY_NED_M_S2 = np.array((0.0, 0.0, GRAVITY_M_S2))
P = PositionParams()
AXES = list(itertools.product((False, True), repeat=3))


def update(controller, setpoint, state=None, **kwargs):
    return controller.update(estimate() if state is None else state, setpoint, dt_s=DT_S, **kwargs)


def test_limits_hold_for_all_512_setpoints_and_wild_values():
    rng = np.random.default_rng(3)
    for scale, params in ((3.0, P), (1e3, P), (1e3, PositionParams(tilt_max_rad=0.1, thr_max=0.7))):
        for pos_axes, vel_axes, acc_axes in itertools.product(AXES, AXES, AXES):
            setpoint = TrajectorySetpoint(
                pos_ned_m=scale * rng.standard_normal(3), vel_ned_m_s=scale * rng.standard_normal(3),
                acc_ned_m_s2=scale * rng.standard_normal(3),
                pos_axes=pos_axes, vel_axes=vel_axes, acc_axes=acc_axes,
            )  # fmt: skip
            state = estimate(
                vel_ned_m_s=scale * rng.standard_normal(3), pos_ned_m=scale * rng.standard_normal(3)
            )
            yaw = rng.uniform(-math.pi, math.pi)
            out = update(
                PositionStage(params),
                setpoint,
                state,
                yaw_rad=yaw,
                disturbance_ned_m_s2=rng.standard_normal(3),
            )
            assert math.hypot(*out.vel_ned_m_s[:2]) <= params.xy_vel_max_m_s * (1.0 + 1e-12)
            assert -params.z_vel_max_up_m_s <= out.vel_ned_m_s[2] <= params.z_vel_max_dn_m_s
            assert params.thr_min * (1.0 - 1e-9) <= out.thrust <= params.thr_max * (1.0 + 1e-9)
            up = quat_rotate(out.q_ned_frd, np.array((0.0, 0.0, -1.0)))
            assert math.acos(min(-up[2], 1.0)) <= params.tilt_max_rad + 1e-7
            np.testing.assert_allclose(up * out.thrust, out.thrust_ned, atol=1e-9)
            nose = quat_rotate(out.q_ned_frd, np.array((1.0, 0.0, 0.0)))
            assert math.remainder(math.atan2(nose[1], nose[0]) - yaw, math.tau) == pytest.approx(
                0.0, abs=1e-9
            )


def test_nothing_controlled_hovers_level():
    out = update(PositionStage(P), TrajectorySetpoint())
    assert out.thrust == pytest.approx(0.5)
    np.testing.assert_allclose(out.q_ned_frd, (1.0, 0.0, 0.0, 0.0), atol=1e-12)


def test_position_and_feed_forward_add():
    setpoint = TrajectorySetpoint(
        pos_ned_m=np.array((2.0, 0.0, -1.0)), vel_ned_m_s=np.array((1.0, -0.5, 0.0))
    )
    out = update(PositionStage(P), setpoint)
    np.testing.assert_allclose(out.vel_ned_m_s, (2.0 * P.xy_p + 1.0, -0.5, -P.z_p))
    np.testing.assert_allclose(
        out.acc_ned_m_s2, out.vel_ned_m_s * (P.xy_vel_p_acc, P.xy_vel_p_acc, P.z_vel_p_acc)
    )


def test_position_has_priority_over_feed_forward_at_the_speed_limit():
    setpoint = TrajectorySetpoint(pos_ned_m=np.array((8.0, 0.0, 0.0)), vel_ned_m_s=np.array((0.0, 20.0, 0.0)))
    vel = update(PositionStage(P), setpoint).vel_ned_m_s
    assert vel[0] == pytest.approx(8.0 * P.xy_p)
    assert math.hypot(vel[0], vel[1]) == pytest.approx(P.xy_vel_max_m_s)


def test_acceleration_becomes_tilt_and_thrust():
    out = update(PositionStage(P), TrajectorySetpoint(acc_ned_m_s2=np.array((2.0, 0.0, -1.0))))
    roll, pitch, yaw = quat_to_euler(out.q_ned_frd)
    assert (roll, yaw) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert pitch == pytest.approx(-math.atan(2.0 / GRAVITY_M_S2))  # forward is nose down
    assert -out.thrust_ned[2] == pytest.approx(0.5 * (1.0 + 1.0 / GRAVITY_M_S2))


def test_disturbance_is_subtracted():
    wind = np.array((1.0, -2.0, 0.5))
    against = update(PositionStage(P), TrajectorySetpoint(), disturbance_ned_m_s2=wind)
    demanded = update(PositionStage(P), TrajectorySetpoint(acc_ned_m_s2=-wind))
    np.testing.assert_allclose(against.thrust_ned, demanded.thrust_ned)


def test_vertical_thrust_has_priority_over_horizontal_except_for_the_margin():
    setpoint = TrajectorySetpoint(acc_ned_m_s2=np.array((9.0, 0.0, -30.0)))
    thrust = update(PositionStage(P), setpoint).thrust_ned
    assert thrust[0] == pytest.approx(P.thr_xy_margin)
    assert -thrust[2] == pytest.approx(math.sqrt(1.0 - P.thr_xy_margin**2))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_integral_does_not_wind_up_while_limits_hold(axis, sign):
    """A demand beyond the limits for 20 s does not change it; one below the limit does."""
    controller = PositionStage(P)
    demand = np.zeros(3)
    demand[axis] = sign * 1000.0
    state = estimate(vel_ned_m_s=-demand / 50.0)
    for _ in range(2500):
        update(controller, TrajectorySetpoint(vel_ned_m_s=demand), state)
    assert abs(controller.integral_ned_m_s2[axis]) < 1e-9
    beyond = TrajectorySetpoint(vel_ned_m_s=np.zeros(3), acc_ned_m_s2=demand)
    update(controller, beyond, estimate(vel_ned_m_s=0.001 * demand))
    assert controller.integral_ned_m_s2[axis] * sign < 0.0


def test_integral_grows_with_the_error_and_resets():
    controller = PositionStage(P)
    for _ in range(10):
        update(controller, TrajectorySetpoint(vel_ned_m_s=np.array((0.1, 0.0, 0.0))))
    assert controller.integral_ned_m_s2[0] == pytest.approx(10 * DT_S * 0.1 * P.xy_vel_i_acc)
    controller.reset()
    assert not controller.integral_ned_m_s2.any()


def test_a_new_hover_thrust_causes_no_jump():
    controller = PositionStage(P)
    setpoint = TrajectorySetpoint(pos_ned_m=np.array((0.0, 0.0, -0.3)))
    before = update(controller, setpoint)
    controller.integral_ned_m_s2[2] += integral_shift_m_s2(0.5, 0.56, before.acc_ned_m_s2[2])
    held = float(controller.integral_ned_m_s2[2])
    after = update(controller, setpoint, hover_thrust=0.56)
    # except for the integration of one step
    step = 0.56 / GRAVITY_M_S2 * P.z_vel_i_acc * DT_S * 0.3
    assert held != 0.0
    assert after.thrust == pytest.approx(before.thrust, abs=1.01 * step)


def test_without_position_it_stops_and_without_velocity_it_levels():
    setpoint = TrajectorySetpoint(pos_ned_m=np.array((5.0, 0.0, -5.0)))
    moving = estimate(vel_ned_m_s=np.array((1.0, 0.0, 0.0)), position_valid=False)
    out = update(PositionStage(P), setpoint, moving)
    assert out.acc_ned_m_s2[0] == pytest.approx(-P.xy_vel_p_acc)
    assert out.vel_ned_m_s[2] == -P.z_vel_max_up_m_s  # the height is still valid
    blind = dataclasses.replace(moving, velocity_valid=False)
    out = update(PositionStage(P), setpoint, blind)
    np.testing.assert_allclose(out.thrust_ned[:2], 0.0)
    assert out.vel_ned_m_s[2] == -P.z_vel_max_up_m_s  # a valid height implies a valid climb rate
    out = update(PositionStage(P), setpoint, dataclasses.replace(blind, height_valid=False))
    np.testing.assert_allclose(out.thrust_ned, (0.0, 0.0, -0.5))


def test_axes_can_have_position_and_velocity_setpoints():
    setpoint = TrajectorySetpoint(
        pos_ned_m=np.array((1.0, 1.0, math.nan)), pos_axes=(True, True, False),
        vel_ned_m_s=np.array((math.nan, math.nan, 0.7)), vel_axes=(False, False, True),
    )  # fmt: skip
    np.testing.assert_allclose(update(PositionStage(P), setpoint).vel_ned_m_s, (P.xy_p, P.xy_p, 0.7))


def test_hover_thrust_converges_under_noise():
    rng = np.random.default_rng(2)
    estimator = HoverThrustStage(HoverThrustParams(), start=0.5)
    truth = 0.62
    for _ in range(500):
        thrust = 0.6 + 0.05 * rng.standard_normal()
        acc = GRAVITY_M_S2 * (thrust / truth - 1.0) + 0.3 * rng.standard_normal()
        estimator.update(acc_up_m_s2=acc, thrust_up=thrust, dt_s=DT_S)
    assert estimator.thrust == pytest.approx(truth, abs=0.01)


def test_hover_thrust_rejects_an_impact_and_stays_in_its_range():
    estimator = HoverThrustStage(HoverThrustParams(range=0.1), start=0.5)
    for _ in range(200):
        estimator.update(acc_up_m_s2=0.0, thrust_up=0.5, dt_s=DT_S)
    estimator.update(acc_up_m_s2=60.0, thrust_up=0.5, dt_s=DT_S)
    assert estimator.thrust == pytest.approx(0.5, abs=1e-6)
    for _ in range(20_000):
        estimator.update(acc_up_m_s2=-GRAVITY_M_S2, thrust_up=0.5, dt_s=DT_S)
    assert estimator.thrust <= 0.6


def observed(seconds, *, q, thrust, acc, enabled=True, **kwargs):
    observer = DisturbanceStage(DisturbanceParams(enabled=enabled, **kwargs))
    observer.record.thrust = thrust
    for _ in range(round(seconds / 0.004)):
        observer.update(acc, q, thrust=thrust, hover_thrust=0.5, dt_s=0.004, observe=True)
    return observer.acc_ned_m_s2


def test_observer_estimates_the_force_that_thrust_does_not_explain():
    q = quat_from_euler(0.2, -0.3, 1.0)
    wind = np.array((2.0, -1.0, 0.4))
    acc = wind + GRAVITY_NED_M_S2 + quat_rotate(q, -0.55 / 0.5 * GRAVITY_NED_M_S2)
    np.testing.assert_allclose(observed(2.0, q=q, thrust=0.55, acc=acc), wind, atol=1e-6)
    # after one time constant of the low-pass, 1 - 1/e of it
    part = observed(1.0 / (2.0 * math.pi * 2.0), q=q, thrust=0.55, acc=acc, cutoff_hz=2.0)
    np.testing.assert_allclose(part, wind * (1.0 - math.exp(-1.0)), rtol=0.02)
    assert not observed(2.0, q=q, thrust=0.55, acc=acc, enabled=False).any()


def test_an_attitude_error_does_not_change_the_observers_magnitude():
    """The estimate's error rotates both specific force and thrust: in hover they still cancel."""
    q_wrong = quat_from_euler(0.05, 0.03, 0.0)
    acc = GRAVITY_NED_M_S2 + quat_rotate(q_wrong, -GRAVITY_NED_M_S2)
    assert np.abs(observed(2.0, q=q_wrong, thrust=0.5, acc=acc)).max() < 1e-9


def test_observer_models_the_motors_lag_and_limits_an_impact():
    observer = DisturbanceStage(DisturbanceParams(thrust_lag_s=0.02))
    observer.update(
        np.zeros(3), np.array((1.0, 0, 0, 0)), thrust=0.5, hover_thrust=0.5, dt_s=0.02, observe=False
    )
    assert observer.record.thrust == pytest.approx(0.5 * (1.0 - math.exp(-1.0)))
    bump = observed(
        10.0, q=np.array((1.0, 0.0, 0.0, 0.0)), thrust=0.5, acc=np.array((300.0, 0.0, 0.0)), acc_max_m_s2=8.0
    )
    np.testing.assert_allclose(bump, (8.0, 0.0, 0.0), atol=1e-9)


def test_take_off_timeline():
    ramp = TakeoffRamp(P)
    step = {"landed": True, "dt_s": 0.1}
    assert ramp.update(demands_climb=False, **step) is TakeoffPhase.GROUND
    assert ramp.update(demands_climb=True, **step) is TakeoffPhase.RAMP
    limits = []
    for _ in range(30):  # 3 s
        assert ramp.update(demands_climb=True, **step) is TakeoffPhase.RAMP
        limits.append(ramp.climb_max_m_s)
    assert limits[0] < -2.0  # no thrust yet
    assert np.all(np.diff(limits) > 0.0)
    assert limits[-1] == pytest.approx(P.tko_speed_m_s)
    assert ramp.update(landed=False, demands_climb=False, dt_s=0.1) is TakeoffPhase.FLYING
    assert ramp.climb_max_m_s == math.inf
    assert ramp.update(demands_climb=False, **step) is TakeoffPhase.GROUND


def test_aborted_take_off_and_start_in_the_air():
    ramp = TakeoffRamp(P)
    ramp.update(landed=True, demands_climb=True, dt_s=0.1)
    assert ramp.update(landed=True, demands_climb=False, dt_s=0.1) is TakeoffPhase.GROUND
    assert ramp.update(landed=False, demands_climb=False, dt_s=0.1) is TakeoffPhase.FLYING


def test_setpoints_that_demand_a_climb():
    up = np.array((0.0, 0.0, -5.0))
    state = estimate()
    assert demands_climb(state, TrajectorySetpoint(pos_ned_m=up))
    assert demands_climb(state, TrajectorySetpoint(vel_ned_m_s=up))
    assert demands_climb(state, TrajectorySetpoint(acc_ned_m_s2=up))
    assert not demands_climb(state, TrajectorySetpoint(pos_ned_m=-up))
    assert not demands_climb(state, TrajectorySetpoint(pos_ned_m=up, pos_axes=(True, True, False)))
    assert not demands_climb(state, TrajectorySetpoint())
