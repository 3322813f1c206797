"""Parts of the batch solver: near elements, fields of segments, maxima between grid directions."""

import shutil

import numpy as np
import pytest
from antenna_arrays import ideal, perturbed
from msgspec import structs
from scipy.integrate import quad

from antenna.model.clearance import near_m
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTooNear, ElementsTouch, Snapshot
from antenna.solvers.batch.maximum import local_gain, moved
from antenna.solvers.batch.moments import _potential
from antenna.solvers.batch.solver import Batch
from antenna.solvers.selection import make_backend

LAMBDA_M = 10.0
NEEDS_NEC2C = pytest.mark.skipif(shutil.which("nec2c") is None, reason="needs the program nec2c")
SHORT = AntennaConfig(wavelength_m=LAMBDA_M)
LONG = AntennaConfig(wavelength_m=LAMBDA_M, element_length_m=5.0, element_radius_m=0.001, segments=11)


def _with_a_pair(rng, apart_m, height_m=0.0):
    """A disturbed array whose second element is ``apart_m`` beside the fifth, fed in another phase."""
    array = perturbed(rng, LAMBDA_M, 0.3, tilt_rad=0.1)
    centres_m = array.centres_m + np.array([0.0, 0.0, height_m])
    angle = rng.uniform(0.0, 2.0 * np.pi)
    centres_m[1] = centres_m[4] + apart_m * np.array([np.cos(angle), np.sin(angle), 0.2])
    return Snapshot(centres_m, array.rotations, array.voltages)


@pytest.mark.nec2
@pytest.mark.parametrize("ground", ["none", "perfect"])
@pytest.mark.parametrize(("settings", "apart_m"), [(SHORT, 0.3), (LONG, 0.6)])
def test_near_elements_match_nec2(settings, apart_m, ground):
    """Few currents for each would be wrong by up to 0.06 dB (short) and 0.4 dB (long) there."""
    assert apart_m < near_m(LAMBDA_M)
    config = structs.replace(settings, ground=ground)
    rng = np.random.default_rng(4)
    arrays = [_with_a_pair(rng, apart_m, 10.0) for _ in range(3)]
    witness = make_backend(structs.replace(config, backend="nec2")).patterns(arrays)
    for mine, theirs in zip(make_backend(config).patterns(arrays), witness, strict=True):
        assert mine.max_gain_dbi == pytest.approx(theirs.max_gain_dbi, abs=0.01)
        seen = theirs.gain_dbi > -10.0
        assert np.abs(mine.gain_dbi - theirs.gain_dbi)[seen].max() < 0.1


@pytest.mark.nec2
@pytest.mark.parametrize("backend", ["batch", "nec2", pytest.param("nec2c", marks=NEEDS_NEC2C)])
def test_implausible_solution_reports_the_two_elements(backend):
    """At a few centimetres the radiated power may exceed the input power: no pattern, or a balanced one."""
    rng = np.random.default_rng(6)
    arrays = [_with_a_pair(rng, apart_m) for apart_m in (0.04, 0.05, 0.06, 0.08) for _ in range(3)]
    results = make_backend(structs.replace(SHORT, backend=backend)).patterns(arrays)
    refused = [result for result in results if isinstance(result, ElementsTouch)]
    assert refused
    for result in refused:
        assert isinstance(result, ElementsTooNear)
        assert (result.first, result.second) == (1, 4)
        assert "element 1 is too near element 4" in str(result)
    for result in results:
        assert isinstance(result, ElementsTouch) or 0.8 < result.average_gain < 1.25


def test_a_result_does_not_depend_on_its_neighbours():
    """One that touches, one without a solution and one that is fine, in any order."""
    rng = np.random.default_rng(8)
    arrays = [_with_a_pair(rng, 0.0), _with_a_pair(rng, 0.05), ideal(LAMBDA_M)]
    backend = make_backend(SHORT)
    alone = [backend.patterns([array])[0] for array in arrays]
    together = backend.patterns([*arrays, *reversed(arrays)])
    for result, expected in zip(together, [*alone, *reversed(alone)], strict=True):
        assert str(result) == str(expected) if isinstance(expected, ElementsTouch) else True
        assert type(result) is type(expected)
    assert together[2].max_gain_dbi == together[3].max_gain_dbi == alone[2].max_gain_dbi


@pytest.mark.parametrize("ground", ["none", "perfect"])
@pytest.mark.parametrize("settings", [SHORT, LONG])
def test_the_maximum_is_that_of_the_finest_grid(settings, ground):
    """Half a degree of 13 dBi lobes loses at most 0.005 dB, and single precision 1e-4."""
    rng = np.random.default_rng(3)
    arrays = []
    for _ in range(6):
        array = perturbed(rng, LAMBDA_M, 0.4, tilt_rad=0.1)
        arrays.append(Snapshot(array.centres_m + np.array([0.0, 0.0, 12.0]), array.rotations, array.voltages))
    fine = make_backend(structs.replace(settings, ground=ground, grid_deg=0.5)).patterns(arrays)
    for step_deg in (5.0, 10.0):
        coarse = make_backend(structs.replace(settings, ground=ground, grid_deg=step_deg)).patterns(arrays)
        for found, whole in zip(coarse, fine, strict=True):
            highest_dbi = whole.gain_dbi.max()
            assert highest_dbi - 2e-4 < found.max_gain_dbi < highest_dbi + 0.006
            assert found.max_gain_dbi == pytest.approx(whole.max_gain_dbi, abs=1e-6)


def test_slopes_and_curvatures_match_finite_differences():
    """Central differences over 1e-3 rad are off by the sixth of the third derivative, 1e-6 (k p)^3 or so."""
    rng = np.random.default_rng(5)
    radiating = Batch(SHORT).currents([perturbed(rng, LAMBDA_M)])
    points = radiating.points_m[0], radiating.axes[0], radiating.moments[0], 2.0 * np.pi / LAMBDA_M
    room, h = np.empty((6, 3), complex), 1e-3

    def gain(theta, phi, a, b):
        return local_gain(*points, *moved(theta, phi, a, b), room)[0]

    for theta, phi in rng.uniform((0.3, 0.0), (2.8, 6.2), (20, 2)):
        here, slope_a, slope_b, bend_aa, bend_ab, bend_bb = local_gain(*points, theta, phi, room)
        at = {(i, j): gain(theta, phi, i * h, j * h) for i in (-1, 0, 1) for j in (-1, 0, 1)}
        size = 1e-2 * max(here, 1.0)
        assert at[0, 0] == pytest.approx(here, rel=1e-12)
        assert slope_a == pytest.approx((at[1, 0] - at[-1, 0]) / (2 * h), abs=size)
        assert slope_b == pytest.approx((at[0, 1] - at[0, -1]) / (2 * h), abs=size)
        assert bend_aa == pytest.approx((at[1, 0] - 2 * here + at[-1, 0]) / h**2, abs=size)
        assert bend_bb == pytest.approx((at[0, 1] - 2 * here + at[0, -1]) / h**2, abs=size)
        mixed = (at[1, 1] - at[1, -1] - at[-1, 1] + at[-1, -1]) / (4 * h**2)
        assert bend_ab == pytest.approx(mixed, abs=size)


@pytest.mark.parametrize("half_m", [0.003, 0.25])
@pytest.mark.parametrize("halves_away", [0.0, 0.7, 3.0, 7.9, 8.1, 50.0, 1000.0])
def test_potential_of_a_segment_is_the_integral_of_its_green_function(halves_away, half_m):
    """By adaptive quadrature, on the wire's surface, beside it and along it, on long segments to 3e-6."""
    k_rad_m = 2.0 * np.pi / LAMBDA_M
    for along_m, rho_m in (
        (halves_away * half_m, 2e-4), (0.3 * half_m, 2e-4 + halves_away * half_m),
    ):  # fmt: skip

        def green(z_m, along_m=along_m, rho_m=rho_m):
            distance_m = np.hypot(rho_m, along_m - z_m)
            return np.exp(-1j * k_rad_m * distance_m) / distance_m

        expected, _ = quad(
            green, -half_m, half_m, complex_func=True, points=[np.clip(along_m, -half_m, half_m)], limit=200
        )
        assert _potential(along_m, rho_m, half_m, k_rad_m) == pytest.approx(
            expected, rel=1e-8 if half_m < 0.1 else 5e-6
        )


@pytest.mark.nec2
@pytest.mark.parametrize("backend", ["batch", "nec2"])
def test_a_wide_array_on_a_wide_grid_has_its_highest_lobe_and_its_power(backend):
    """Lobes of an array of 100 m at 10 m are narrower than 6 degrees, and the 5 degree grid misses some.

    Gains stay those of the grid that was asked for.
    """
    rng = np.random.default_rng(9)
    arrays = [perturbed(rng, LAMBDA_M, 20.0, tilt_rad=0.1) for _ in range(6 if backend == "batch" else 1)]
    wide = make_backend(structs.replace(SHORT, backend=backend)).patterns(arrays)
    fine = make_backend(structs.replace(SHORT, backend="batch", grid_deg=1.0)).patterns(arrays)
    for found, whole in zip(wide, fine, strict=True):
        assert found.theta_gain_dbi.shape == (37, 72)
        assert found.max_gain_dbi == pytest.approx(whole.max_gain_dbi, abs=0.002)
        assert found.average_gain == pytest.approx(whole.average_gain, abs=0.002)
        np.testing.assert_allclose(
            found.gain_dbi[1:-1], whole.gain_dbi[5:-5:5, ::5], atol=0.1 if backend == "nec2" else 0.002
        )


def test_gain_in_free_space_does_not_depend_on_the_position():
    """Single precision would lose 0.1 dB of a lobe a hundred kilometres from the origin."""
    near = perturbed(np.random.default_rng(10), LAMBDA_M)
    far = Snapshot(near.centres_m + np.array([1e5, -1e5, 1e4]), near.rotations, near.voltages)
    here, there = make_backend(SHORT).patterns([near, far])
    assert there.max_gain_dbi == pytest.approx(here.max_gain_dbi, abs=1e-5)
    seen = here.gain_dbi > -20.0
    np.testing.assert_allclose(there.gain_dbi[seen], here.gain_dbi[seen], atol=1e-3)


@pytest.mark.nec2
def test_nec2_rejects_arrays_low_over_real_ground():
    """PyNEC feeds an array below a fifth of the wavelength with negative power."""
    low, high = (
        Snapshot(
            ideal(LAMBDA_M).centres_m + np.array([0.0, 0.0, height_m]),
            ideal(LAMBDA_M).rotations,
            ideal(LAMBDA_M).voltages,
        )
        for height_m in (0.3, 5.0)
    )
    config = structs.replace(SHORT, backend="nec2", ground="real")
    refused, pattern = make_backend(config).patterns([low, high])
    assert isinstance(refused, ElementsTooNear)
    assert "too near the ground for a solution" in str(refused)
    assert pattern.max_gain_dbi > 0.0


@NEEDS_NEC2C
@pytest.mark.nec2
@pytest.mark.parametrize("apart_m", [0.4, 0.6])
def test_nec2c_matches_nec2_for_near_elements(apart_m):
    arrays = [_with_a_pair(np.random.default_rng(seed), apart_m) for seed in range(3)]
    witnesses = [
        make_backend(structs.replace(SHORT, backend=name)).patterns(arrays) for name in ("nec2", "nec2c")
    ]
    for one, other in zip(*witnesses, strict=True):
        assert one.max_gain_dbi == pytest.approx(other.max_gain_dbi, abs=0.05)
