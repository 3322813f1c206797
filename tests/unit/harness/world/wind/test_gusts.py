"""Statistics of the gusts compared with the settings: variance, correlation in time and space, direction."""

import math

import msgspec
import numpy as np
import pytest

from harness.world.wind import VERTICAL_GUST_RATIO, GustyWind, WindConfig


def record(config, *, vehicles=2, seconds=4000.0, dt_s=0.1, seed=1):
    """Return forces (T, vehicles, 3), NED."""
    wind = GustyWind(config, vehicles, np.random.default_rng(seed))
    return np.array([wind.step(dt_s) for _ in range(round(seconds / dt_s))])


ARTICLE = record(WindConfig(mean_n=5.0, direction_deg=30.0))
"""4000 s at a time constant of 2 s: 1000 independent samples, or 2.2 % for a standard deviation."""


def test_the_mean_points_in_the_direction_of_the_wind():
    mean = ARTICLE.mean(axis=(0, 1))
    expected = (5.0 * math.cos(math.radians(30.0)), 5.0 * math.sin(math.radians(30.0)), 0.0)
    np.testing.assert_allclose(mean, expected, atol=4.0 * 1.0 / math.sqrt(1000.0))


@pytest.mark.parametrize(
    ("direction_deg", "towards_ned"), [(0.0, (1, 0, 0)), (90.0, (0, 1, 0)), (-90.0, (0, -1, 0))]
)
def test_direction_is_clockwise_from_north(direction_deg, towards_ned):
    config = WindConfig(mean_n=3.0, direction_deg=direction_deg, gust_rms_fraction=0.0)
    np.testing.assert_allclose(record(config, seconds=1.0)[-1, 0], 3.0 * np.array(towards_ned), atol=1e-12)


def test_a_vertical_share_keeps_the_magnitude():
    config = WindConfig(mean_n=5.0, vertical_fraction=-0.6, gust_rms_fraction=0.0)
    (force, _) = record(config, seconds=0.1)[0]
    assert force[2] == pytest.approx(-3.0)
    assert np.linalg.norm(force) == pytest.approx(5.0)


def test_gust_rms_is_a_fifth_of_the_mean_and_less_downwards():
    np.testing.assert_allclose(
        ARTICLE.std(axis=0), np.tile((1.0, 1.0, VERTICAL_GUST_RATIO), (2, 1)), rtol=0.09
    )


def test_gusts_are_correlated_over_their_time_constant():
    """First-order Gauss-Markov: correlation exp(-lag/2 s) at every lag."""
    gusts = ARTICLE - ARTICLE.mean(axis=0)
    for lag_s in (0.1, 1.0, 2.0, 4.0):
        lag = round(lag_s / 0.1)
        correlation = np.mean(gusts[lag:] * gusts[:-lag], axis=(0, 1)) / gusts.var(axis=(0, 1))
        np.testing.assert_allclose(correlation, math.exp(-lag_s / 2.0), atol=0.09)


@pytest.mark.parametrize("correlation", [0.0, 0.8, 1.0])
def test_gusts_at_two_vehicles_are_correlated_as_configured(correlation):
    gusts = record(WindConfig(correlation=correlation))
    for axis in range(3):
        measured = np.corrcoef(gusts[:, 0, axis], gusts[:, 1, axis])[0, 1]
        assert measured == pytest.approx(
            correlation, abs=4.0 * (1.0 - correlation**2) / math.sqrt(1000.0) + 1e-12
        )


def test_axes_are_independent():
    assert np.all(np.abs(np.corrcoef(ARTICLE[:, 0].T) - np.eye(3)) < 4.0 / math.sqrt(1000.0))


def test_gusts_start_stationary():
    """Over 500 seeds, the variance in the first 4 ms is that of any other time."""
    first = np.array(
        [record(WindConfig(), seconds=0.004, dt_s=0.004, seed=seed)[0, 0] for seed in range(500)]
    )
    np.testing.assert_allclose(first.std(axis=0), (1.0, 1.0, 0.3), rtol=4.0 / math.sqrt(2.0 * 500.0))


def test_the_process_does_not_depend_on_the_step():
    """Variance and correlation over one second are equal with steps of 4 ms and 100 ms."""
    gusts = record(WindConfig(), seconds=400.0, dt_s=0.004, vehicles=20)
    gusts = gusts - (5.0 * math.sqrt(0.5), 5.0 * math.sqrt(0.5), 0.0)
    assert gusts[..., :2].std() == pytest.approx(1.0, rel=0.12)
    memory = np.mean(gusts[250:] * gusts[:-250]) / np.mean(gusts**2)
    assert memory == pytest.approx(math.exp(-0.5), abs=0.1)


def test_forces_equal_those_of_the_recursion_for_any_intervals():
    """Bit-identical: draws made for one interval are used for the next."""
    config = WindConfig(mean_n=5.0, direction_deg=0.0, correlation=0.64)
    wind, rng = GustyWind(config, 2, np.random.default_rng(8)), np.random.default_rng(8)
    unit = rng.standard_normal((3, 3))
    for dt_s in [0.004] * 70 + [0.1] * 3 + [0.004] * 130:
        kept = math.exp(-dt_s / 2.0)
        unit = kept * unit + math.sqrt(1.0 - kept * kept) * rng.standard_normal((3, 3))
        gusts = math.sqrt(0.64) * unit[0] + math.sqrt(1.0 - 0.64) * unit[1:]
        expected = np.array([5.0, 0.0, 0.0]) + 1.0 * np.array([1.0, 1.0, VERTICAL_GUST_RATIO]) * gusts
        assert wind.step(dt_s).tobytes() == expected.tobytes()


def test_no_wind_is_no_force():
    assert not record(WindConfig(mean_n=0.0), seconds=1.0).any()


def test_the_seed_determines_the_gusts():
    first, again, other = (record(WindConfig(), seconds=1.0, seed=seed) for seed in (4, 4, 5))
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


@pytest.mark.parametrize(
    ("toml", "path"),
    [
        ("mean_n = -1.0", "mean_n"),
        ("correlation = 1.1", "correlation"),
        ("gust_time_constant_s = 0.0", "gust_time_constant_s"),
        ("gust_time_constant_s = inf", "gust_time_constant_s"),
        ("mean_n = nan", "mean_n"),
    ],
)
def test_values_out_of_range_are_refused_by_name(toml, path):
    with pytest.raises(msgspec.ValidationError, match=path):
        msgspec.toml.decode(toml, type=WindConfig)
