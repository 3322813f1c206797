"""The whole cascade with a 6-DOF Iris: wind, moves, upsets, take-off and landing."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from control_fixtures import DT_S, Gusts, Iris, estimate, fly, hover_errors
from msgspec.structs import replace
from paths import ROOT, SUPPORT

from autopilot.control import ControlParams, FlightController
from autopilot.control.params import DisturbanceParams, PositionParams
from autopilot.navigation.guide import Guide
from foundation.types import AttitudeSetpoint, TrajectorySetpoint

PARAMS = ControlParams()
WITHOUT_OBSERVER = ControlParams(disturbance=DisturbanceParams(enabled=False))
CALM = np.zeros(3)


def rms_m(params, *, mean_n, gust_rms_n, seeds=(0, 1), seconds=40.0):
    """3-D rms position error, mean over seeds."""
    errors = [
        hover_errors(params, mean_n=mean_n, gust_rms_n=gust_rms_n, seed=seed, seconds=seconds)
        for seed in seeds
    ]
    return np.mean([math.sqrt((e**2).sum(axis=1).mean()) for e in errors])


def hold(height_m, yaw_rad=0.0):
    return TrajectorySetpoint(pos_ned_m=np.array((0.0, 0.0, -height_m)), yaw_rad=yaw_rad)


def test_hover_without_observer_is_like_px4s():
    """A PX4 has 0.39 and 0.46 m in 5 N with 1 N gusts, 0.18 m in 2 N with 0.4 N: mean within 30 %."""
    assert rms_m(WITHOUT_OBSERVER, mean_n=5.0, gust_rms_n=1.0) == pytest.approx(0.425, rel=0.3)
    assert rms_m(WITHOUT_OBSERVER, mean_n=2.0, gust_rms_n=0.4) == pytest.approx(0.18, rel=0.3)


def test_observer_holds_against_gusts():
    """Half of the required 0.20 m, because the estimator's errors add to it (measured here: 0.09 m)."""
    assert rms_m(PARAMS, mean_n=5.0, gust_rms_n=1.0) <= 0.12
    assert rms_m(PARAMS, mean_n=0.0, gust_rms_n=0.0, seeds=(0,)) <= 0.02


def guide_at(pos_ned_m, target_ned_m, yaw_rad=None):
    """Return a reference at rest that moves to a target."""
    guide = Guide(PARAMS.trajectory)
    guide.reset(pos_ned_m.copy(), vel_ned_m_s=np.zeros(3), yaw_rad=0.0)
    guide.go_to(target_ned_m, yaw_rad=yaw_rad)
    return guide


@pytest.mark.parametrize(
    ("distance_m", "minimum_s"),
    # jerk 4 m/s^3, acceleration 3 m/s^2, speed 5 m/s: derived in test_guide
    [(1.0, 2.0), (5.0, 3.44), (20.0, 6.42)],
)
def test_moves_overshoot_little_and_settle(distance_m, minimum_s):
    iris = Iris(height_m=10.0)
    controller = FlightController(PARAMS)
    for _ in range(500):
        iris.step(fly(controller, iris, hold(10.0)), CALM)
    target = iris.pos_ned_m + np.array((distance_m, 0.0, 0.0))
    guide = guide_at(iris.pos_ned_m, target)
    error = []
    for _ in range(3000):
        setpoint = guide.update(DT_S, vehicle_pos_ned_m=iris.pos_ned_m)
        iris.step(fly(controller, iris, setpoint), CALM)
        error.append(iris.pos_ned_m[0] - target[0])
    assert max(error) <= 0.05 * distance_m
    settled_s = (np.nonzero(np.abs(error) > 0.05 * distance_m)[0][-1] + 1) * DT_S
    assert settled_s <= 1.15 * minimum_s + 1.0


@pytest.mark.parametrize("direction", [(2.0, 0.0, 0.0), (0.0, 0.0, -2.0), (0.0, 0.0, 1.0)])
def test_velocity_steps(direction):
    """Velocity steps without a trajectory, from a hover with a converged thrust estimate."""
    iris = Iris(height_m=50.0)
    controller = FlightController(ControlParams(position=PositionParams(thr_hover=0.534)))
    demand = np.array(direction)
    speed = np.linalg.norm(demand)
    for _ in range(500):
        iris.step(fly(controller, iris, TrajectorySetpoint(vel_ned_m_s=np.zeros(3), yaw_rad=0.0)), CALM)
    along = []
    for _ in range(2000):
        iris.step(fly(controller, iris, TrajectorySetpoint(vel_ned_m_s=demand, yaw_rad=0.0)), CALM)
        along.append(iris.vel_ned_m_s @ demand / speed)
    assert max(along) <= 1.1 * speed
    assert along[-1] == pytest.approx(speed, rel=0.06)


def random_upsets(count):
    rng = np.random.default_rng(11)
    fixed = [np.array(q, dtype=float) for q in ((0, 1, 0, 0), (0, 0, 1, 0), (1, 0, 1, 0), (0, 1, 0, 1))]
    for k in range(count):
        q = fixed[k] if k < len(fixed) else rng.standard_normal(4)
        rates = rng.standard_normal(3)
        yield q / np.linalg.norm(q), rates * (4.0 * rng.random() ** (1.0 / 3.0) / np.linalg.norm(rates)), k


def up_cosine(iris):
    """Return the cosine between body -z and up."""
    _, x, y, _ = iris.q_ned_frd
    return 1.0 - 2.0 * (x * x + y * y)


def test_upright_within_1_5_s_from_any_attitude():
    level = AttitudeSetpoint(q_ned_frd=np.array((1.0, 0.0, 0.0, 0.0)), yaw_rate_rad_s=0.0, thrust=0.53)
    for q, rates, seed in random_upsets(30):
        iris = Iris(height_m=30.0, q_ned_frd=q, omega_frd_rad_s=rates, noise_seed=seed)
        controller = FlightController(PARAMS)
        tilted_s = 0.0
        for k in range(600):
            iris.step(fly(controller, iris, level), CALM)
            if up_cosine(iris) < math.cos(math.radians(10.0)):
                tilted_s = (k + 1) * DT_S
        assert tilted_s <= 1.5


def test_position_hold_catches_an_upset():
    for q, rates, seed in random_upsets(12):
        iris = Iris(height_m=30.0, q_ned_frd=q, omega_frd_rad_s=rates, noise_seed=seed)
        controller = FlightController(PARAMS)
        lowest_m = 30.0
        for k in range(2500):
            iris.step(fly(controller, iris, hold(30.0)), CALM)
            lowest_m = min(lowest_m, -iris.pos_ned_m[2])
            if k * DT_S > 1.5:
                assert up_cosine(iris) > math.cos(PARAMS.position.tilt_max_rad + math.radians(10.0))
        assert lowest_m > 20.0
        assert np.linalg.norm(iris.pos_ned_m - (0.0, 0.0, -30.0)) < 0.3


@pytest.mark.parametrize("wind_n", [0.0, 5.0])
def test_take_off_hover_and_landing(wind_n):
    iris = Iris(noise_seed=4)
    gusts = Gusts(mean_n=wind_n, gust_rms_n=0.2 * wind_n, seed=4)
    controller = FlightController(PARAMS)
    landed = True
    highest_m, lifted_s = 0.0, 0.0
    for k in range(3000):
        iris.step(fly(controller, iris, hold(5.0), landed=landed), gusts.force_ned_n())
        if landed and iris.pos_ned_m[2] < -0.02:
            landed, lifted_s = False, k * DT_S
        highest_m = max(highest_m, -iris.pos_ned_m[2])
    assert not landed
    assert 1.0 < lifted_s < PARAMS.position.tko_ramp_s
    assert highest_m < 5.25
    assert np.linalg.norm(iris.pos_ned_m - (0.0, 0.0, -5.0)) < 0.3
    assert controller.hover_thrust == pytest.approx(0.534, abs=0.02)

    here = iris.pos_ned_m.copy()
    down = TrajectorySetpoint(
        pos_ned_m=here, pos_axes=(True, True, False), yaw_rad=0.0,
        vel_ned_m_s=np.array((0.0, 0.0, 0.7)), vel_axes=(False, False, True),
    )  # fmt: skip
    touch_speed_m_s = 0.0
    for _ in range(3000):
        if iris.on_ground:
            break
        touch_speed_m_s = iris.vel_ned_m_s[2]
        iris.step(fly(controller, iris, down), gusts.force_ned_n())
    assert iris.on_ground
    assert touch_speed_m_s < 1.0
    assert math.hypot(*(iris.pos_ned_m - here)[:2]) < 0.4
    for _ in range(125):  # within half a second thrust is as low as a land detector requires
        controls = fly(controller, iris, down)
        iris.step(controls, gusts.force_ned_n())
    assert controller.thrust <= PARAMS.position.thr_min * 1.01
    controls = fly(controller, iris, down, landed=True)
    assert not controls.any()


def test_on_the_ground_the_motors_idle_and_nothing_integrates():
    iris = Iris()
    controller = FlightController(PARAMS)
    stay = TrajectorySetpoint(pos_ned_m=np.array((3.0, 0.0, 0.0)), yaw_rad=1.0)
    for _ in range(500):
        controls = fly(controller, iris, stay, landed=True)
        assert not controls.any()
    assert controller.thrust == 0.0
    assert not controller.disturbance_ned_m_s2.any()


def test_yaw_follows_setpoint_rate_and_holds():
    iris = Iris(height_m=5.0)
    controller = FlightController(PARAMS)

    def yaw_rad():
        w, x, y, z = iris.q_ned_frd
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    for _ in range(1000):
        iris.step(fly(controller, iris, hold(5.0, yaw_rad=2.0)), CALM)
    assert yaw_rad() == pytest.approx(2.0, abs=0.02)
    turning = TrajectorySetpoint(pos_ned_m=np.array((0.0, 0.0, -5.0)), yaw_rate_rad_s=0.5)
    for _ in range(500):
        iris.step(fly(controller, iris, turning), CALM)
    assert yaw_rad() == pytest.approx(math.remainder(2.0 + 0.5 * 2.0, math.tau), abs=0.1)
    for _ in range(500):
        iris.step(fly(controller, iris, TrajectorySetpoint(pos_ned_m=np.array((0.0, 0.0, -5.0)))), CALM)
    setpoint_rad = controller.block[0].yaw_rad
    assert setpoint_rad == pytest.approx(math.remainder(3.0, math.tau), abs=0.01)
    assert yaw_rad() == pytest.approx(setpoint_rad, abs=0.02)


def test_a_heading_after_a_reset_of_the_estimate_is_held():
    controller = FlightController(PARAMS)
    keep = TrajectorySetpoint(pos_ned_m=np.zeros(3))
    controller.update(estimate(), keep, dt_s=DT_S, landed=False)
    half = math.sqrt(0.5)
    turned = estimate(q_ned_frd=np.array((half, 0.0, 0.0, half)), reset_counter=1)
    controller.update(turned, keep, dt_s=DT_S, landed=False)
    assert controller.block[0].yaw_rad == pytest.approx(math.pi / 2.0)


@pytest.mark.parametrize("divider", [1, 2, 4])
def test_rates_and_attitude_run_at_every_sample_and_position_at_its_divider(divider):
    """With 250 Hz samples and the default of 2 the position loop runs at 125 Hz."""
    assert PARAMS.position_divider == 2
    iris = Iris(height_m=5.0, noise_seed=3)
    controller = FlightController(replace(PARAMS, position_divider=divider))
    attitudes, rates = [], []
    for _ in range(40):
        iris.step(fly(controller, iris, hold(5.5)), CALM)
        attitudes.append(controller.attitude_setpoint.q_ned_frd)
        rates.append(controller.rate_setpoint_frd_rad_s)
    changes = [k for k in range(1, 40) if not np.array_equal(attitudes[k], attitudes[k - 1])]
    assert changes == list(range(divider, 40, divider))
    assert all(not np.array_equal(rates[k], rates[k - 1]) for k in range(1, 40))


def test_idle_resets_everything():
    fresh, used = FlightController(PARAMS), FlightController(PARAMS)
    iris = Iris(height_m=5.0)
    gusts = Gusts(mean_n=5.0, gust_rms_n=1.0, seed=1)
    for _ in range(500):
        iris.step(fly(used, iris, hold(5.0)), gusts.force_ned_n())
    used.idle()
    assert used.controls == [0.0] * 4
    assert used.attitude_setpoint is None
    assert used.thrust == 0.0
    state = iris.estimate()
    for _ in range(5):
        expected = fresh.update(state, hold(6.0), dt_s=DT_S, landed=False)
        np.testing.assert_array_equal(used.update(state, hold(6.0), dt_s=DT_S, landed=False), expected)


def test_telemetry_reports_the_setpoints_in_use():
    controller = FlightController(PARAMS)
    controller.update(estimate(), hold(2.0, yaw_rad=0.5), dt_s=DT_S, landed=False)
    assert controller.attitude_setpoint.thrust > 0.5
    level = AttitudeSetpoint(q_ned_frd=np.array((1.0, 0.0, 0.0, 0.0)), yaw_rate_rad_s=0.0, thrust=0.4)
    controller.update(estimate(), level, dt_s=DT_S, landed=False)
    assert controller.attitude_setpoint is level


def first_controls():
    """Return the controls after 50 steps that use every kernel."""
    iris = Iris(height_m=5.0, noise_seed=1)
    controller = FlightController(PARAMS)
    guide = guide_at(np.array((0.0, 0.0, -5.0)), np.array((3.0, 2.0, -7.0)), yaw_rad=1.0)
    controls = []
    for _ in range(50):
        controls.append(fly(controller, iris, guide.update(DT_S)))
        iris.step(controls[-1], np.array((3.0, 1.0, 0.0)))
    return np.array(controls)


def test_same_flight_without_the_compiler():
    code = "import json, test_control_flight as t; print(json.dumps(t.first_controls().tolist()))"
    path = os.pathsep.join((str(Path(__file__).parent), str(SUPPORT), str(ROOT)))
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path},
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    np.testing.assert_allclose(first_controls(), json.loads(done.stdout), atol=1e-9)
