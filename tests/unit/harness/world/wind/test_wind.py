"""Deterministic parts of the wind: kinds, profile over height, gusts of the scenario. 1 s."""

import math

import msgspec
import numpy as np
import pytest

from harness.world.wind import GustConfig, GustyWind, Wind, WindConfig
from harness.world.wind.wind import GustProfiles, rise

HEIGHT_M = np.full(2, 10.0)
STILL = {"mean_n": 0.0}


def wind_of(config, vehicles=2, seed=3):
    return Wind(config, vehicles, np.random.default_rng(seed), formation_height_m=10.0)


def test_wind_as_a_force_equals_the_gusty_wind_and_its_air_is_at_rest():
    config = WindConfig()
    wind, alone = wind_of(config), GustyWind(config, 2, np.random.default_rng(3))
    for step in range(120):
        now = wind.step(0.004, time_us=4_000 * step, height_m=HEIGHT_M)
        assert now.force_ned_n.tobytes() == alone.step(0.004).tobytes()
        assert not now.air_vel_ned_m_s.any()


def test_wind_as_a_velocity_is_no_force_and_has_its_direction():
    config = WindConfig(kind="velocity", mean_m_s=6.0, direction_deg=90.0, vertical_fraction=-0.6)
    now = wind_of(config).step(0.004, time_us=0, height_m=HEIGHT_M)
    assert not now.force_ned_n.any()
    np.testing.assert_allclose(now.air_vel_ned_m_s, np.tile((0.0, 4.8, -3.6), (2, 1)), atol=1e-12)


def test_a_velocity_is_refused_where_a_force_is_expected():
    with pytest.raises(ValueError, match='wind of kind "velocity" is no force'):
        GustyWind(WindConfig(kind="velocity"), 1, np.random.default_rng(1))


def test_the_logarithmic_mean_grows_by_equal_parts_per_factor_of_height():
    """ln(h / z0) / ln(10 m / z0): 8 m/s at 10 m over z0 = 0.1 m are 4 m/s at 1 m and 12 m/s at 100 m."""
    config = WindConfig(kind="velocity", mean_m_s=8.0, profile="logarithmic", roughness_length_m=0.1)
    heights_m = np.array([-0.1, 0.0, 0.1, 1.0, 10.0, 100.0])
    speed_m_s = config.velocity_model(10.0).mean_speed_m_s(heights_m)
    np.testing.assert_allclose(speed_m_s, (0.0, 0.0, 0.0, 4.0, 8.0, 12.0), atol=1e-12)
    two = wind_of(config).step(0.004, time_us=0, height_m=np.array([1.0, 100.0])).air_vel_ned_m_s
    np.testing.assert_allclose(np.linalg.norm(two, axis=1), (4.0, 12.0))


def test_no_profile_has_more_than_60_metres_per_second_anywhere():
    """The steepest accepted profile: 60 m/s at ten roughness lengths of 1 m would be 180 m/s at 1000 m."""
    config = WindConfig(
        kind="velocity", mean_m_s=60.0, profile="logarithmic", reference_height_m=10.0, roughness_length_m=1.0
    )
    heights_m = np.array([2.0, 10.0, 1000.0])
    speed_m_s = config.velocity_model(10.0).mean_speed_m_s(heights_m)
    np.testing.assert_allclose(speed_m_s, (60.0 * math.log10(2.0), 60.0, 60.0))


GUSTS = {
    "step": GustConfig(shape="step", start_s=2.0, duration_s=3.0, peak_n=4.0, direction_deg=0.0),
    "ramp": GustConfig(shape="ramp", start_s=2.0, rise_s=1.0, duration_s=3.0, peak_n=4.0, direction_deg=0.0),
    "one_minus_cosine": GustConfig(
        shape="one_minus_cosine", start_s=2.0, rise_s=1.0, duration_s=2.0, peak_n=4.0, direction_deg=0.0
    ),
}


@pytest.mark.parametrize(
    ("shape", "course"),
    [
        ("step", {1.999999: 0.0, 2.0: 4.0, 4.999999: 4.0, 5.0: 0.0}),
        ("ramp", {2.0: 0.0, 2.25: 1.0, 3.0: 4.0, 4.0: 4.0, 4.5: 2.0, 5.0: 0.0, 9.0: 0.0}),
        # 4/2 (1 - cos(pi t)): a third of the rise is a quarter of the peak, half of it half
        (
            "one_minus_cosine",
            {1.0: 0.0, 2.0: 0.0, 2 + 1 / 3: 1.0, 2.5: 2.0, 3.0: 4.0, 3.5: 2.0, 4.0: 0.0, 8.0: 0.0},
        ),
    ],
)
def test_a_gust_has_its_shape_at_its_time(shape, course):
    profiles = GustProfiles(WindConfig(gusts=(GUSTS[shape],), **STILL))
    for time_s, expected_n in course.items():
        force = profiles.at(round(time_s * 1e6))
        assert (0.0 if force is None else force[0]) == pytest.approx(expected_n, abs=2e-5)


def test_a_gust_without_an_end_lasts():
    gust = GustConfig(shape="one_minus_cosine", start_s=1.0, rise_s=2.0, peak_n=1.0)
    assert rise(gust, 1_000_000) == pytest.approx(0.5)
    assert rise(gust, 2_000_000) == rise(gust, 10**12) == 1.0


def test_gusts_add_to_the_wind_of_every_vehicle_and_to_each_other():
    """One along the wind by default, one straight down; no effect before and after them."""
    gusts = (
        GustConfig(shape="step", start_s=0.1, duration_s=0.1, peak_m_s=3.0),
        GustConfig(shape="step", start_s=0.15, duration_s=0.1, peak_m_s=-2.0, vertical_fraction=1.0),
    )
    calm = WindConfig(kind="velocity", mean_m_s=5.0, direction_deg=90.0, turbulence="dryden")
    plain, gusty = wind_of(calm), wind_of(msgspec.structs.replace(calm, gusts=gusts))
    for step in range(75):
        time_us = 4_000 * step
        without, with_gusts = (
            wind.step(0.004, time_us=time_us, height_m=HEIGHT_M).air_vel_ned_m_s for wind in (plain, gusty)
        )
        expected = np.zeros(3)
        if 100_000 <= time_us < 200_000:
            expected[1] = 3.0
        if 150_000 <= time_us < 250_000:
            expected[2] = -2.0
        np.testing.assert_allclose(with_gusts - without, np.tile(expected, (2, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ('shape = "step"\nstart_s = 1.0\nrise_s = 1.0', 'rise_s: a gust of shape "step" has none'),
        ('shape = "one_minus_cosine"\nstart_s = 1.0', "rise_s: .* takes time to rise"),
        ('shape = "ramp"\nstart_s = 1.0\nrise_s = 2.0\nduration_s = 3.0', "duration_s: 3 s is too short"),
        ('shape = "step"\nstart_s = -1.0', "start_s"),
        ('shape = "step"\nstart_s = 1.0\nduration_s = 0.0039', "duration_s"),
        ('shape = "sine"\nstart_s = 1.0', "shape"),
    ],
)
def test_an_invalid_gust_is_refused_by_name(toml, message):
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.toml.decode(toml, type=GustConfig)


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        (
            'kind = "velocity"\nmean_n = 5.0\ngust_time_constant_s = 2.0',
            'mean_n, gust_time_constant_s: no effect where kind is "velocity"',
        ),
        ('turbulence = "dryden"', 'turbulence: no effect where kind is "force"'),
        ('profile = "uniform"', 'profile: no effect where kind is "force"'),
        (
            'kind = "velocity"\nroughness_length_m = 0.03\nreference_height_m = 10.0',
            'reference_height_m, roughness_length_m: no effect where profile is "uniform"',
        ),
        (
            'kind = "velocity"\nwind_20ft_m_s = 5.0\nturbulence_height_m = 9.0\ncorrelation = 0.8',
            'correlation, wind_20ft_m_s, turbulence_height_m: no effect where turbulence is "none"',
        ),
        (
            'kind = "velocity"\nturbulence = "none"\nmean_n = 1.0\nleast_passing_speed_m_s = 2.0',
            'mean_n: .* "velocity"; least_passing_speed_m_s: no effect where turbulence is "none"',
        ),
        ('kind = "velocity"\nturbulence = "dryden"\nturbulence_height_m = 1.0', "turbulence_height_m"),
        (
            'kind = "velocity"\nprofile = "logarithmic"\nroughness_length_m = 2.0\nreference_height_m = 19.9',
            "reference_height_m: expected at least 10 times roughness_length_m, 2 m",
        ),
        (
            'kind = "velocity"\nprofile = "logarithmic"\nroughness_length_m = 1.1',
            "reference_height_m: expected at least 10 times roughness_length_m, 1.1 m",
        ),
        ('kind = "velocity"\ngusts = [{shape="step", start_s=0.0, peak_n=1.0}]', "expected peak_m_s"),
    ],
)
def test_fields_of_the_other_kind_of_wind_are_refused(toml, message):
    """Regardless of the value, also with the default value."""
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.toml.decode(toml, type=WindConfig)


def test_unset_fields_have_the_defaults_of_their_kind():
    force, velocity = WindConfig().force_model(), WindConfig(kind="velocity").velocity_model(10.0)
    assert (force.mean_n, force.gust_rms_fraction, force.gust_time_constant_s) == (5.0, 0.2, 2.0)
    assert (velocity.mean_m_s, velocity.profile, velocity.turbulence) == (5.0, "uniform", "none")
    assert force.correlation == velocity.correlation == 0.8
    explicit = WindConfig(mean_n=0.0, gust_rms_fraction=0.0, correlation=0.0).force_model()
    assert (explicit.mean_n, explicit.gust_rms_fraction, explicit.correlation) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("formation_m", "scale_m"), [(2.0, 3.048), (10.0, 10.0), (120.0, 120.0), (500.0, 304.8)]
)
def test_turbulence_is_that_of_the_formations_height_by_default(formation_m, scale_m):
    """Within the 10 to 1000 feet of the specification; its vertical length is the height itself."""
    config = WindConfig(kind="velocity", turbulence="dryden")
    assert config.velocity_model(formation_m).turbulence_height_m == scale_m
    explicit = msgspec.structs.replace(config, turbulence_height_m=50.0)
    assert explicit.velocity_model(formation_m).turbulence_height_m == 50.0
    # the same air as with that height set explicitly, and different from that at 50 m
    courses = [
        Wind(each, 2, np.random.default_rng(3), formation_height_m=formation_m)
        .step(0.004, time_us=0, height_m=HEIGHT_M)
        .air_vel_ned_m_s.tobytes()
        for each in (config, msgspec.structs.replace(config, turbulence_height_m=scale_m), explicit)
    ]
    assert courses[0] == courses[1] != courses[2]


@pytest.mark.parametrize(
    ("field", "most"),
    [("start_s", 1e6), ("rise_s", 1e6), ("duration_s", 1e6), ("peak_n", 100.0), ("peak_m_s", 60.0)],
)
def test_every_number_of_a_gust_has_a_finite_limit(field, most):
    table = {"shape": "ramp", "start_s": 0.0, "rise_s": 0.1, "peak_n": 1.0} | {field: most}
    msgspec.convert(table, GustConfig)
    for value in (most * (1.0 + 1e-9), math.inf, -math.inf, math.nan):
        with pytest.raises(msgspec.ValidationError, match=field):
            msgspec.convert(table | {field: value}, GustConfig)


FLOATS = (
    "direction_deg", "vertical_fraction", "correlation",
    "mean_n", "gust_rms_fraction", "gust_time_constant_s",
    "mean_m_s", "reference_height_m", "roughness_length_m", "wind_20ft_m_s", "turbulence_height_m",
    "least_passing_speed_m_s",
)  # fmt: skip


def test_every_number_of_the_wind_has_a_finite_limit():
    others = {"kind", "gusts", "profile", "turbulence"}
    assert set(WindConfig.__struct_fields__) == others.union(FLOATS)
    for field in FLOATS:
        for value in (math.inf, -math.inf, math.nan):
            with pytest.raises(msgspec.ValidationError, match=rf"\$\.{field}"):
                msgspec.convert({field: value}, WindConfig)


def test_length_of_the_horizontal_part_keeps_the_magnitude():
    gust = GustConfig(shape="step", start_s=0.0, peak_n=5.0, direction_deg=60.0, vertical_fraction=0.8)
    force = GustProfiles(WindConfig(gusts=(gust,))).at(0)
    expected = (3.0 * math.cos(math.radians(60.0)), 3.0 * math.sin(math.radians(60.0)), 4.0)
    np.testing.assert_allclose(force, expected, atol=1e-12)
