"""Environment of the vehicles: wind as a velocity, density, ground effect. 5 s."""

import math

import msgspec
import numpy as np
import pytest
from airframe_changes import changed
from msgspec import structs
from world_truth import truth_with

from autopilot.parameters.config import Site
from foundation.airframe.description import GRAVITY_M_S2
from foundation.airframe.files import IRIS
from foundation.geometry.rotations import quat_from_rotation_vector
from harness.world.physics.bodies import BODY
from harness.world.physics.environment import EnvironmentConfig, Surroundings
from harness.world.physics.rotors import ground_effect, kernel_model, wrenches
from harness.world.physics.truth import TRUTH
from harness.world.physics.world import World
from harness.world.sensors.config import SensorsConfig
from harness.world.sensors.suite import SensorSuite
from harness.world.wind.turbulence import Turbulence, TurbulenceScales

STEP_US = 4_000
STEP_S = 0.004
WEIGHT_N = 1.55 * GRAVITY_M_S2
HOVER_RAD_S = math.sqrt(WEIGHT_N / 4.0 / 5.84e-6)
HOVER = (HOVER_RAD_S - 100.0) / 1000.0
LEVEL = np.array([[1.0, 0.0, 0.0, 0.0]])
HEADWIND_M_S = 8.85
"""Wind at which the drag of the hovering rotors is 5 N: 4 x 1.75e-4 x 806.7 = 0.565 N/(m/s)."""
ROLLED = quat_from_rotation_vector(np.array((0.2, 0.0, 0.0)))[None]
PLAIN = changed(propulsion={"drag_n_s2_m": 0.0, "rolling_moment_n_s2": 0.0}, body={"drag_n_s_m": 0.25})


def wrench(
    *, model=IRIS, speed=HOVER_RAD_S, vel=(0.0, 0.0, 0.0), omega=(0.0, 0.0, 0.0), air=(0.0, 0.0, 0.0),
    density=1.0, height_m=100.0, effectiveness=(1.0, 1.0, 1.0, 1.0), q=LEVEL, ground=False,
):  # fmt: skip
    """Return force and torque (3,) NED on one vehicle."""
    bodies = np.zeros(1, BODY)
    bodies["q_ned_frd"], bodies["vel_ned_m_s"], bodies["omega_ned_rad_s"] = q, vel, omega
    bodies["pos_ned_m"] = 0.0, 0.0, -height_m
    force, torque = wrenches(
        kernel_model([model], step_s=STEP_S, ground_effect=ground),
        bodies,
        np.full((1, 4), speed),
        Surroundings(np.array([air], dtype=float), np.array([density]), np.array([effectiveness])),
    )
    return force[0], torque[0]


def test_five_newtons_are_8_85_metres_per_second():
    force, _ = wrench(air=(HEADWIND_M_S, 0.0, 0.0))
    np.testing.assert_allclose(force, (5.0, 0.0, -WEIGHT_N), atol=0.005)


def test_forces_depend_on_the_motion_through_the_air_only():
    """Flight with the wind equals hover in calm air; flight in calm air equals hover in the opposite wind."""
    q = quat_from_rotation_vector(np.array((0.3, -0.2, 1.0)))[None]
    omega = (0.4, -0.8, 0.2)
    for mine, other in (
        ({"vel": (3.0, -4.0, 1.0), "air": (3.0, -4.0, 1.0)}, {}),
        ({"vel": (3.0, -4.0, 1.0)}, {"air": (-3.0, 4.0, -1.0)}),
    ):
        first, second = (
            wrench(model=changed(body={"drag_n_s_m": 0.3}), q=q, omega=omega, **kw) for kw in (mine, other)
        )
        np.testing.assert_allclose(first, second, atol=1e-12)


def test_an_updraught_adds_the_thrust_that_a_downdraught_removes():
    """A downdraught of 5 m/s, like a climb, leaves 1 - 5/25 of the thrust; an updraught gives 1 + 5/25."""
    down, _ = wrench(air=(0.0, 0.0, 5.0))
    up, _ = wrench(air=(0.0, 0.0, -5.0))
    assert down[2] == pytest.approx(-0.8 * WEIGHT_N)
    assert up[2] == pytest.approx(-1.2 * WEIGHT_N)


def test_vertical_turbulence_whose_mean_is_zero_pushes_neither_up_nor_down():
    """Of 1.2 m/s rms, which with 5 m/s at four sigma stays where thrust is linear.

    20 s of 1000 vehicles' independent series, each correlated over 2 L/V = 4 s: 5000 samples of 4.8 % of the
    weight, 0.07 %; four of those. A thrust that only falls would lack 1.2 / sqrt(2 pi) / 25 = 1.9 %.
    """
    vehicles = 1000
    rng = np.random.default_rng(5)
    scales = TurbulenceScales(std_m_s=(1.2,) * 3, length_m=(10.0,) * 3)
    air = Turbulence("dryden", scales, passing_speed_m_s=5.0, series=vehicles, rng=rng)
    model = kernel_model([IRIS] * vehicles, step_s=STEP_S)
    bodies = np.zeros(vehicles, BODY)
    bodies["q_ned_frd"] = LEVEL
    lift_n = []
    for _ in range(20):
        surroundings = Surroundings(
            air.step(1.0) * (0.0, 0.0, 1.0),
            np.ones(vehicles),
            np.ones((vehicles, 4)),
        )
        force, _ = wrenches(model, bodies, np.full((vehicles, 4), HOVER_RAD_S), surroundings)
        lift_n.append(-force[:, 2].mean())
    assert np.mean(lift_n) == pytest.approx(WEIGHT_N, rel=4.0 * 0.0007)


def test_body_drag_is_linear_and_points_with_the_wind_whatever_the_attitude():
    for turn in ((0.0, 0.0, 0.0), (0.5, 1.0, -2.0)):
        q = quat_from_rotation_vector(np.array(turn))[None]
        calm, _ = wrench(model=PLAIN, q=q, speed=0.0)
        windy, torque = wrench(model=PLAIN, q=q, speed=0.0, air=(8.0, -4.0, 2.0))
        np.testing.assert_allclose(windy - calm, (2.0, -1.0, 0.5), atol=1e-12)
        np.testing.assert_allclose(torque, 0.0, atol=1e-12)


def drift(world, steps, **options):
    vehicles = len(world.truth.pos_ned_m)
    for _ in range(steps):
        world.step(
            np.zeros((vehicles, 4)),
            np.zeros(vehicles, bool),
            np.zeros((vehicles, 3)),
            rotors_stopped=np.zeros(vehicles, bool),
            **options,
        )
    return world.truth


def test_a_falling_body_reaches_the_winds_speed_and_its_terminal_velocity():
    """By m dv/dt = m g - k (v - air): time constant 1.55 / 0.25 = 6.2 s, towards air + m g / k down.

    Explicit steps of 4 ms are off by (dt / tau) / 2 = 3e-4 of the way at most.
    """
    k, tau_s = 0.25, 1.55 / 0.25
    air = np.array([[4.0, -3.0, 0.0]])
    terminal = air[0] + (0.0, 0.0, WEIGHT_N / k)
    with World(
        airframes=[PLAIN], spawn_pos_ned_m=[(0.0, 0.0, -3000.0)], spawn_yaw_rad=0.7, step_us=STEP_US
    ) as world:
        for seconds in (5.0, 25.0):
            truth = drift(
                world, round(5.0 / STEP_S) if seconds == 5.0 else round(20.0 / STEP_S), air_vel_ned_m_s=air
            )
            expected = terminal * (1.0 - math.exp(-seconds / tau_s))
            np.testing.assert_allclose(truth.vel_ned_m_s[0], expected, rtol=1e-3)


def levelled(truth):
    """Return motor controls (1, 4) of a PD law that keeps one vehicle level at hover thrust."""
    w, x, y, _ = truth.q_ned_frd[0]
    roll, pitch, yaw = -20.0 * w * np.array((x, y, 0.0)) - 2.0 * truth.omega_frd_rad_s[0]
    mix = np.array([-roll + pitch + yaw, roll - pitch + yaw, roll + pitch - yaw, -roll - pitch - yaw])
    return HOVER + 0.05 * mix[None]


def test_a_hovering_iris_in_steady_wind_is_pushed_by_5_newtons_and_ends_up_drifting_with_it():
    """Drag 0.565 N/(m/s) on 1.55 kg: 3.23 m/s^2 at first, then with a time constant of 2.74 s to 8.85 m/s.

    The hubs are 23 mm above the centre of mass, so that the wind tilts it a little: 3 %.
    """
    air = np.array([[HEADWIND_M_S, 0.0, 0.0]])
    with World(
        airframes=[IRIS], spawn_pos_ned_m=[(0.0, 0.0, -100.0)], spawn_yaw_rad=0.0, step_us=STEP_US
    ) as world:
        still = np.zeros((1, 3))
        for step in range(2000):
            # rotors reach their speed in calm air
            now = still if step < 250 else air
            world.step(
                levelled(world.truth),
                np.ones(1, bool),
                still,
                rotors_stopped=np.zeros(1, bool),
                air_vel_ned_m_s=now,
            )
            if step == 250:
                first_m_s2 = world.truth.acc_ned_m_s2[0, 0]
        truth = world.truth
    assert first_m_s2 == pytest.approx(5.0 / 1.55, rel=0.01)
    reached = HEADWIND_M_S * (1.0 - math.exp(-1750 * STEP_S * 0.565 / 1.55))
    assert truth.vel_ned_m_s[0, 0] == pytest.approx(reached, rel=0.03)


def test_the_defaults_are_air_at_rest_and_whole_rotors_to_the_last_bit():
    rng = np.random.default_rng(4)
    inputs = [(rng.uniform(0.4, 0.9, (3, 4)), rng.normal(0.0, 2.0, (3, 3))) for _ in range(200)]
    spawn = [(0.0, 5.0 * i, -20.0) for i in range(3)]
    seen = []
    for options in (
        {},
        {"air_vel_ned_m_s": np.zeros((3, 3)), "rotor_effectiveness": np.ones((3, 4))},
    ):
        stopped = np.zeros((3, 4) if options else 3, bool)
        with World(
            airframes=[IRIS] * len(spawn), spawn_pos_ned_m=spawn, spawn_yaw_rad=0.2, step_us=STEP_US
        ) as world:
            for controls, wind_n in inputs:
                world.step(controls, np.ones(3, bool), wind_n, rotors_stopped=stopped, **options)
            truth = world.truth
            seen.append(b"".join(getattr(truth, name).tobytes() for name in TRUTH.names))
    assert seen[0] == seen[1]


def test_thrust_torque_and_drag_are_proportional_to_the_density():
    flight = {"vel": (3.0, 1.0, 0.5), "omega": (0.2, 0.1, -0.5), "model": changed(body={"drag_n_s_m": 0.2})}
    thick, thin = (np.array(wrench(density=density, **flight)) for density in (1.0, 0.8))
    np.testing.assert_allclose(thin, 0.8 * thick, rtol=1e-12)


def test_isa_density_equals_the_standards_table():
    """ISO 2533: 1.2250, 1.1117, 0.9093, 0.7364 kg/m^3 at 0, 1, 3 and 5 km by the tape.

    The model's altitudes are geopotential, r h / (r + h) with r = 6356.766 km. In air 30 K warmer than
    288.15 K the density is 288.15 / 318.15 of that.
    """
    by_tape_m = np.array([0.0, 1000.0, 3000.0, 5000.0])
    altitude_m = by_tape_m / (1.0 + by_tape_m / 6_356_766.0)
    density = 1.225 * EnvironmentConfig(density="isa").density_ratio(altitude_m)
    np.testing.assert_allclose(density, (1.2250, 1.1117, 0.9093, 0.7364), atol=6e-5)
    hot = EnvironmentConfig(density="isa", temperature_offset_k=30.0)
    assert hot.density_ratio(altitude_m)[0] == pytest.approx(288.15 / 318.15, rel=1e-4)
    np.testing.assert_array_equal(EnvironmentConfig().density_ratio(altitude_m), 1.0)


def lift_off_acceleration(environment, ground_altitude_m=0.0, height_m=50.0):
    """Return the upward acceleration, m/s^2, of a vehicle at hover speed."""
    with World(
        airframes=[IRIS], spawn_pos_ned_m=[(0.0, 0.0, -height_m)], spawn_yaw_rad=0.0, step_us=STEP_US,
        environment=environment, ground_altitude_m=ground_altitude_m,
    ) as world:  # fmt: skip
        world.truth.rotor_speed_rad_s[:] = HOVER_RAD_S
        world.step(
            np.full((1, 4), HOVER), np.ones(1, bool), np.zeros((1, 3)), rotors_stopped=np.zeros(1, bool)
        )
        return -world.truth.acc_ned_m_s2[0, 2]


def test_the_world_uses_the_density_at_the_vehicles_altitude():
    """2950 m + 50 m: 0.9093/1.225 of the thrust; "standard" does not depend on altitude."""
    lacking = lift_off_acceleration(EnvironmentConfig(density="isa"), 2950.0)
    assert lacking == pytest.approx(-GRAVITY_M_S2 * (1.0 - 0.9093 / 1.225), rel=1e-3)
    assert lift_off_acceleration(EnvironmentConfig(), 2950.0) == pytest.approx(0.0, abs=1e-9)


def test_the_world_provides_its_density_for_the_motors_current():
    with World(
        airframes=[IRIS] * 2, spawn_pos_ned_m=[(0.0, 0.0, -50.0), (5.0, 0.0, -1050.0)], spawn_yaw_rad=0.0,
        step_us=STEP_US, environment=EnvironmentConfig(density="isa"), ground_altitude_m=1950.0,
    ) as world:  # fmt: skip
        np.testing.assert_array_equal(world.density_ratio, 1.0)
        drift(world, 1)
        np.testing.assert_allclose(world.density_ratio, np.array((1.0066, 0.9093)) / 1.225, rtol=5e-4)


def test_ground_effect_is_cheeseman_and_bennetts_and_constant_below_half_a_radius():
    """1 / (1 - (R / 4 z)^2): at z = R 16/15, at z = R/2 4/3, far away 1."""
    assert ground_effect(0.128, 0.128) == pytest.approx(16.0 / 15.0)
    assert ground_effect(0.064, 0.128) == ground_effect(0.01, 0.128) == pytest.approx(4.0 / 3.0)
    assert ground_effect(12.8, 0.128) == pytest.approx(1.0, abs=1e-5)
    heights_m = np.linspace(0.064, 3.0, 200)
    assert np.all(np.diff([ground_effect(h, 0.128) for h in heights_m]) < 0.0)


def test_ground_effect_depends_on_the_height_of_each_rotor():
    """Rotors are 23 mm above the centre of mass; rolled right, the lower right ones have more thrust."""
    force, torque = wrench(ground=True, height_m=0.1)
    assert -force[2] / WEIGHT_N == pytest.approx(1.0 / (1.0 - (0.128 / (4.0 * 0.123)) ** 2))
    np.testing.assert_allclose(torque, 0.0, atol=1e-12)
    _, righting = wrench(ground=True, height_m=0.2, q=ROLLED)
    # a hub at this distance to the right is lower by sin(0.2) of it; the cosine multiplies the gain
    expected = 0.0
    for right_m in (0.22, -0.20, -0.22, 0.20):
        z_m = 0.2 + 0.023 * math.cos(0.2) - right_m * math.sin(0.2)
        gain = 1.0 / (1.0 - (0.128 / (4.0 * z_m)) ** 2) - 1.0
        expected -= right_m * WEIGHT_N / 4.0 * (1.0 + gain * math.cos(0.2))
    assert righting[0] == pytest.approx(expected, rel=1e-9)
    assert expected < 0.0


def test_ground_effect_decreases_with_the_tilt_to_zero_at_90_degrees():
    """All hubs at the centre of mass, 0.1 m high: half of the gain remains, the cosine of 60 degrees."""
    model = changed(  # hubs at one place are refused
        rotors=tuple(
            structs.replace(rotor, position_frd_m=(0.0, 0.0, 1e-9 * number))
            for number, rotor in enumerate(IRIS.rotors)
        )
    )

    def gain(roll_deg):
        q = quat_from_rotation_vector(np.array((math.radians(roll_deg), 0.0, 0.0)))[None]
        near, far = (wrench(model=model, ground=ground, height_m=0.1, q=q)[0] for ground in (True, False))
        return np.linalg.norm(near) / np.linalg.norm(far) - 1.0

    level = 1.0 / (1.0 - (0.128 / 0.4) ** 2) - 1.0
    assert gain(0.0) == pytest.approx(level, rel=1e-6)
    assert gain(60.0) == pytest.approx(0.5 * level, rel=1e-6)
    assert gain(89.9) == pytest.approx(level * math.cos(math.radians(89.9)), abs=1e-9)
    assert gain(90.1) == 0.0


def test_ground_effect_is_optional_and_not_for_a_vehicle_upside_down():
    assert wrench(height_m=0.1)[0][2] == pytest.approx(-WEIGHT_N)
    inverted = quat_from_rotation_vector(np.array((math.pi, 0.0, 0.0)))[None]
    assert wrench(ground=True, height_m=0.1, q=inverted)[0][2] == pytest.approx(WEIGHT_N)
    assert lift_off_acceleration(EnvironmentConfig(), height_m=0.1) == pytest.approx(0.0, abs=1e-9)
    extra = 1.0 / (1.0 - (0.128 / (4.0 * 0.123)) ** 2) - 1.0
    with_effect = lift_off_acceleration(EnvironmentConfig(ground_effect=True), height_m=0.1)
    assert with_effect == pytest.approx(extra * GRAVITY_M_S2, rel=1e-6)


def test_thermometers_report_the_offset_and_barometers_do_not():
    truth = truth_with(
        rotor_speed_rad_s=np.zeros((1, 4)),
        **{name: np.zeros((1, 4 if name == "q_ned_frd" else 3)) for name in TRUTH.names},
    )
    samples = [
        SensorSuite(
            config=SensorsConfig(profile="ideal"), site=Site(), vehicles=1, step_us=20_000,
            seed=np.random.SeedSequence(1), temperature_offset_k=offset_k,
        ).sample(20_000, truth).baro
        for offset_k in (0.0, 12.0)
    ]  # fmt: skip
    assert samples[1].temperature_degc[0] - samples[0].temperature_degc[0] == pytest.approx(12.0)
    assert samples[1].pressure_hpa[0] == samples[0].pressure_hpa[0]


@pytest.mark.parametrize(
    ("toml", "path"),
    [('density = "thin"', "density"), ("temperature_offset_k = 99.0", "temperature_offset_k")],
)
def test_wrong_settings_are_refused_by_name(toml, path):
    with pytest.raises(msgspec.ValidationError, match=path):
        msgspec.toml.decode(toml, type=EnvironmentConfig)
