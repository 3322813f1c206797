import numpy as np
import pytest

from antenna.statistics import gain_density, gain_statistics


def test_statistics_of_known_gains():
    result = gain_statistics(np.array([10.0, 11.0, 12.0, 13.0, 14.0]))
    assert (result.samples, result.mean_dbi, result.min_dbi, result.max_dbi) == (5, 12.0, 10.0, 14.0)
    assert result.std_db == pytest.approx(np.sqrt(2.5))
    assert result.quantiles_dbi == pytest.approx({0.05: 10.2, 0.25: 11.0, 0.5: 12.0, 0.75: 13.0, 0.95: 13.8})


def test_single_gain_has_no_spread():
    result = gain_statistics(np.array([13.26]))
    assert (result.mean_dbi, result.std_db) == (13.26, 0.0)


def test_statistics_of_nothing_are_refused():
    with pytest.raises(ValueError):
        gain_statistics(np.empty(0))


def test_densities_integrate_to_one_and_follow_the_distribution():
    gains_dbi = np.random.default_rng(4).normal(12.0, 0.5, 4000)
    density = gain_density(gains_dbi)
    assert np.sum(density.histogram_per_db * np.diff(density.bin_edges_dbi)) == pytest.approx(1.0)
    assert np.trapezoid(density.kernel_per_db, density.gain_dbi) == pytest.approx(1.0, abs=1e-3)
    normal = np.exp(-0.5 * ((density.gain_dbi - 12.0) / 0.5) ** 2) / (0.5 * np.sqrt(2.0 * np.pi))
    # Scott's kernel widens a normal by 1 + K**-0.4: 1.8 % here, and the sample adds its own noise.
    assert np.abs(density.kernel_per_db - normal).max() < 0.06 * normal.max()


def test_equal_gains_have_a_histogram_and_no_curve():
    density = gain_density(np.full(20, 13.26))
    assert np.sum(density.histogram_per_db * np.diff(density.bin_edges_dbi)) == pytest.approx(1.0)
    assert density.bin_edges_dbi[0] < 13.26 < density.bin_edges_dbi[1]
    assert len(density.gain_dbi) == len(density.kernel_per_db) == 0
