import tracemalloc

import numpy as np
import pytest
from antenna_arrays import perturbed
from antenna_hertzian import exact_patterns, gain_dbi
from scipy.stats import gaussian_kde

from antenna.analysis.patterns import FLOOR_DBI, Pattern, directions_deg
from antenna.analysis.statistics import (
    LEVEL_STEP_DB,
    QUANTILES,
    RunningEnvelope,
    gain_density,
    gain_statistics,
    gain_towards_dbi,
    pointing_errors_deg,
    pointing_statistics,
    refined_gain_dbi,
)
from antenna.lab.hertzian import hertzian_pattern
from antenna.model.geometry import Snapshot, along

LAMBDA_M = 10.0


def _with_gains(gains_dbi):
    """Make a pattern with these gains (T, P), all in the theta polarisation."""
    theta_deg, phi_deg = directions_deg(180.0 / (len(gains_dbi) - 1))
    return Pattern(
        theta_deg=theta_deg, phi_deg=phi_deg,
        theta_gain_dbi=gains_dbi, phi_gain_dbi=np.full_like(gains_dbi, FLOOR_DBI),
        max_gain_dbi=float(gains_dbi.max()), max_theta_deg=90.0, max_phi_deg=0.0,
        average_gain=1.0, backend="test",
    )  # fmt: skip


def _pointing_at(theta_deg, phi_deg):
    pattern = _with_gains(np.zeros((7, 12)))
    fields = {name: getattr(pattern, name) for name in Pattern.__slots__}
    return Pattern(**{**fields, "max_theta_deg": theta_deg, "max_phi_deg": phi_deg})


def test_statistics_of_known_gains():
    result = gain_statistics(np.array([10.0, 11.0, 12.0, 13.0, 14.0]))
    assert (result.samples, result.mean_dbi, result.min_dbi, result.max_dbi) == (5, 12.0, 10.0, 14.0)
    assert result.std_db == pytest.approx(np.sqrt(2.5))
    assert result.quantiles_dbi == pytest.approx({0.05: 10.2, 0.25: 11.0, 0.5: 12.0, 0.75: 13.0, 0.95: 13.8})


def test_single_gain_has_no_spread():
    result = gain_statistics(np.array([13.26]))
    assert (result.mean_dbi, result.std_db) == (13.26, 0.0)


def test_statistics_of_empty_input_are_rejected():
    with pytest.raises(ValueError):
        gain_statistics(np.empty(0))
    with pytest.raises(ValueError):
        pointing_statistics(np.empty(0))
    with pytest.raises(ValueError):
        RunningEnvelope().result()


def test_densities_integrate_to_one_and_follow_the_distribution():
    gains_dbi = np.random.default_rng(4).normal(12.0, 0.5, 4000)
    density = gain_density(gains_dbi)
    assert np.sum(density.histogram_per_db * np.diff(density.bin_edges_dbi)) == pytest.approx(1.0)
    assert np.trapezoid(density.kernel_per_db, density.gain_dbi) == pytest.approx(1.0, abs=1e-3)
    normal = np.exp(-0.5 * ((density.gain_dbi - 12.0) / 0.5) ** 2) / (0.5 * np.sqrt(2.0 * np.pi))
    # Scott's kernel widens a normal by 1 + K**-0.4: 1.8 % here, and the sample adds its own noise.
    assert np.abs(density.kernel_per_db - normal).max() < 0.06 * normal.max()


@pytest.mark.parametrize("samples", [2, 3, 40, 3600])
def test_density_equals_that_of_scipy(samples):
    gains_dbi = np.random.default_rng(samples).normal(12.0, 0.5, samples)
    density, kernel = gain_density(gains_dbi), gaussian_kde(gains_dbi)
    reach_db = 4.0 * np.sqrt(kernel.covariance[0, 0])
    assert density.gain_dbi[0] == pytest.approx(gains_dbi.min() - reach_db, rel=1e-12)
    np.testing.assert_allclose(density.kernel_per_db, kernel(density.gain_dbi), rtol=1e-12)


def test_equal_gains_have_a_histogram_and_no_curve():
    density = gain_density(np.full(20, 13.26))
    assert np.sum(density.histogram_per_db * np.diff(density.bin_edges_dbi)) == pytest.approx(1.0)
    assert density.bin_edges_dbi[0] < 13.26 < density.bin_edges_dbi[1]
    assert len(density.gain_dbi) == len(density.kernel_per_db) == 0


def test_envelope_equals_that_of_all_patterns_in_memory():
    """Means and extremes exactly; quantiles to a bin, of so many gains that neighbours are nearer."""
    gains_dbi = np.random.default_rng(2).normal(0.0, 3.0, (2000, 7, 12))
    running = RunningEnvelope()
    for one in gains_dbi:
        running.add(_with_gains(one))
    found = running.result()
    assert found.samples == 2000
    np.testing.assert_allclose(found.mean_dbi, 10.0 * np.log10((10.0 ** (gains_dbi / 10.0)).mean(axis=0)))
    np.testing.assert_allclose(found.min_dbi, gains_dbi.min(axis=0))
    np.testing.assert_allclose(found.max_dbi, gains_dbi.max(axis=0))
    for quantile in QUANTILES:
        exact_dbi = np.quantile(gains_dbi, quantile, axis=0)
        assert np.abs(found.quantiles_dbi[quantile] - exact_dbi).max() < LEVEL_STEP_DB


@pytest.mark.parametrize("samples", [2, 3, 4, 7])
def test_envelope_of_few_samples_has_the_quantiles_of_gain_statistics(samples):
    """To a bin: the median of two gains is midway between them, not one of them."""
    gains_dbi = np.random.default_rng(samples).normal(0.0, 8.0, (samples, 7, 12))
    running = RunningEnvelope()
    for one in gains_dbi:
        running.add(_with_gains(one))
    found = running.result().quantiles_dbi
    for t, p in ((0, 0), (3, 5), (6, 11)):
        expected = gain_statistics(gains_dbi[:, t, p]).quantiles_dbi
        assert {q: found[q][t, p] for q in QUANTILES} == pytest.approx(expected, abs=LEVEL_STEP_DB)


def test_envelope_without_quantiles_needs_little_memory():
    gains_dbi = np.random.default_rng(2).normal(0.0, 3.0, (3, 91, 180))
    patterns = [_with_gains(one) for one in gains_dbi]
    lean, whole = RunningEnvelope(quantiles=False), RunningEnvelope()
    tracemalloc.start()
    for pattern in patterns:
        lean.add(pattern)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 12 * gains_dbi[0].nbytes  # a histogram of 400 levels is 200 of them
    for pattern in patterns:
        whole.add(pattern)
    found, full = lean.result(), whole.result()
    assert found.quantiles_dbi == {}
    for name in ("mean_dbi", "min_dbi", "max_dbi"):
        np.testing.assert_array_equal(getattr(found, name), getattr(full, name))


def test_envelope_of_one_pattern_equals_the_pattern_at_any_level():
    gains_dbi = np.linspace(-90.0, 60.0, 84).reshape(7, 12)
    gains_dbi[0] = FLOOR_DBI
    running = RunningEnvelope()
    running.add(_with_gains(gains_dbi))
    found = running.result()
    for same in (found.mean_dbi, found.min_dbi, found.max_dbi, *found.quantiles_dbi.values()):
        np.testing.assert_allclose(same, gains_dbi)


def test_envelope_of_two_grids_is_rejected():
    running = RunningEnvelope()
    running.add(_with_gains(np.zeros((7, 12))))
    with pytest.raises(ValueError, match=r"\(13, 24\) directions among \(7, 12\)"):
        running.add(_with_gains(np.zeros((13, 24))))


def test_gain_in_a_direction_is_exact_on_the_grid_and_close_between():
    """Within 0.2 % of the greatest gain, over poles and across phi = 0 too."""
    rng = np.random.default_rng(5)
    snapshots = [perturbed(rng, LAMBDA_M, tilt_rad=0.5) for _ in range(3)]
    patterns = exact_patterns(snapshots, LAMBDA_M)
    greatest = np.array([10.0 ** (pattern.max_gain_dbi / 10.0) for pattern in patterns])
    on_grid = gain_towards_dbi(patterns, 90.0, 90.0)
    np.testing.assert_allclose(on_grid, [pattern.gain_dbi[18, 18] for pattern in patterns])
    towards_deg = [(91.3, 88.1), (0.0, 77.0), (1.2, 359.0), (178.9, 12.5), (45.5, 0.4), (88.0, 361.0)]
    for theta_deg, phi_deg in towards_deg:
        found = 10.0 ** (gain_towards_dbi(patterns, theta_deg, phi_deg) / 10.0)
        exact = [10.0 ** (float(gain_dbi(one, LAMBDA_M, theta_deg, phi_deg)) / 10.0) for one in snapshots]
        assert np.abs(found - np.array(exact)).max() < 2e-3 * greatest.min()


def test_gain_over_ground_is_smooth_up_to_the_horizon_and_none_below():
    """Of the array and its image, whose power is spread over half the sphere: twice their directivity."""
    array = perturbed(np.random.default_rng(5), LAMBDA_M, tilt_rad=0.3)
    raised = Snapshot(array.centres_m + np.array([0.0, 0.0, 4.0]), array.rotations, array.voltages)
    mirror = np.array([1.0, 1.0, -1.0])
    both = Snapshot(
        np.concatenate([raised.centres_m, raised.centres_m * mirror]),
        along(np.concatenate([raised.axes, -raised.axes * mirror])),
        np.tile(raised.voltages, 2),
    )
    pattern = hertzian_pattern(raised, LAMBDA_M, grid_deg=3.0, image=True)
    greatest = 10.0 ** (pattern.max_gain_dbi / 10.0)
    for theta_deg, phi_deg in [(89.2, 91.3), (87.0, 90.0), (45.1, 12.2), (90.0, 33.3)]:
        found = 10.0 ** (gain_towards_dbi([pattern], theta_deg, phi_deg)[0] / 10.0)
        exact = 2.0 * 10.0 ** (float(gain_dbi(both, LAMBDA_M, theta_deg, phi_deg)) / 10.0)
        assert found == pytest.approx(exact, abs=2e-3 * greatest)
    assert gain_towards_dbi([pattern], 91.0, 90.0).tolist() == [FLOOR_DBI]


@pytest.mark.parametrize("image", [False, True])
def test_refined_gains_are_those_towards_their_directions(image):
    """Exact on the grid, and between as for single directions; none below the horizon over ground."""
    array = perturbed(np.random.default_rng(5), LAMBDA_M, tilt_rad=0.3)
    raised = Snapshot(array.centres_m + np.array([0.0, 0.0, 4.0]), array.rotations, array.voltages)
    pattern = hertzian_pattern(raised, LAMBDA_M, grid_deg=6.0, image=image)
    theta_deg, phi_deg, refined_dbi = refined_gain_dbi(pattern, 2.0)
    assert (theta_deg[1], theta_deg[-1], phi_deg[1], phi_deg[-1]) == pytest.approx((2.0, 180.0, 2.0, 360.0))
    np.testing.assert_allclose(refined_dbi[::3, :-1:3], pattern.gain_dbi, atol=1e-9)
    np.testing.assert_array_equal(refined_dbi[:, -1], refined_dbi[:, 0])
    for t, p in [(0, 7), (1, 178), (44, 46), (45, 45), (61, 100), (90, 11)]:
        towards_dbi = gain_towards_dbi([pattern], theta_deg[t], phi_deg[p])[0]
        assert refined_dbi[t, p] == pytest.approx(towards_dbi, abs=1e-6)
    assert (refined_dbi[theta_deg > 90.0] == FLOOR_DBI).all() == image


def test_gain_of_no_patterns_is_empty():
    assert len(gain_towards_dbi([], 90.0, 90.0)) == 0


@pytest.mark.parametrize(
    ("theta_deg", "phi_deg", "angle_deg"),
    [
        (90.0, 90.0, 0.0), (90.0, 90.0 + 1e-6, 1e-6), (90.0, 270.0, 180.0), (0.0, 123.0, 90.0),
        (120.0, 90.0, 30.0),
        (90.0, 330.0, 120.0), (60.0, 0.0, 90.0),
    ],
)  # fmt: skip
def test_pointing_error_is_the_angle_between_two_directions(theta_deg, phi_deg, angle_deg):
    found = pointing_errors_deg([_pointing_at(theta_deg, phi_deg)], 90.0, 90.0)
    assert found == pytest.approx([angle_deg], abs=1e-9)


def test_pointing_statistics():
    found = pointing_statistics(np.array([0.0, 3.0, 4.0]))
    assert (found.samples, found.max_deg) == (3, 4.0)
    assert found.mean_deg == pytest.approx(7.0 / 3.0)
    assert found.rms_deg == pytest.approx(5.0 / np.sqrt(3.0))
    assert found.quantiles_deg[0.5] == 3.0
