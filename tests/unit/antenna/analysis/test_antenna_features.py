import numpy as np
import pytest
from antenna_arrays import vertical_snapshot
from antenna_hertzian import exact_patterns
from scipy.optimize import minimize_scalar

from antenna.analysis.features import LEAST_STEPS, features, has_one_maximum, main_lobe
from antenna.analysis.patterns import HALF_POWER_DB, Pattern, directions_deg, to_dbi
from antenna.model.geometry import Snapshot, grid, upright

LAMBDA_M = 10.0


def _row(count, spacing_lambda):
    """Upright elements in a row along x, in phase."""
    return upright(grid(count, count, spacing_lambda * LAMBDA_M, 0.0), np.ones(count, complex))


def _pattern(snapshot, step_deg=5.0):
    return exact_patterns([snapshot], LAMBDA_M, step_deg)[0]


def _made(gain, **maximum):
    """Return a pattern of these gains (T, P), all in the theta polarisation."""
    theta_deg, phi_deg = directions_deg(180.0 / (len(gain) - 1))
    return Pattern(
        theta_deg=theta_deg, phi_deg=phi_deg, theta_gain_dbi=to_dbi(gain), phi_gain_dbi=to_dbi(0.0 * gain),
        max_gain_dbi=float(10.0 * np.log10(gain.max())), **maximum, average_gain=1.0, backend="made",
    )  # fmt: skip


def _article(turn_deg=0.0, step_deg=2.0):
    """Return the pattern of the article's array, rotated about the vertical towards larger phi."""
    ideal = vertical_snapshot(grid(8, 4, 8.5, 2.5), LAMBDA_M)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return _pattern(Snapshot(ideal.centres_m @ turn.T, turn @ ideal.rotations, ideal.voltages), step_deg)


def test_one_dipole():
    """1.5 sin(theta)^2: half of it at 45 and 135 degrees, the same all round, and no other lobe."""
    found = features(_pattern(_row(1, 0.0)))
    assert found.elevation_width_deg == pytest.approx(90.0, abs=0.01)
    assert found.azimuth_width_deg is None
    assert found.side_lobe_dbi is None
    assert found.back_dbi == pytest.approx(10.0 * np.log10(1.5), abs=1e-6)
    assert found.null_dbi == pytest.approx(10.0 * np.log10(1.5), abs=1e-6)


def test_two_dipoles_half_a_wavelength_apart():
    """cos(pi/2 cos(phi))^2 at the horizon: half of it at 60 and 120 degrees, nothing at 0."""
    pattern = _pattern(_row(2, 0.5))
    found = features(pattern)
    assert found.azimuth_width_deg == pytest.approx(60.0, abs=0.02)
    assert found.elevation_width_deg == pytest.approx(90.0, abs=0.01)
    assert found.null_dbi < pattern.max_gain_dbi - 80.0
    assert found.back_dbi == pytest.approx(pattern.max_gain_dbi, abs=1e-6)  # as high: its mirror image


@pytest.mark.parametrize("count", [6, 8])
def test_side_lobes_of_an_end_fire_row(count):
    """A quarter wavelength apart: |sin(n psi / 2) / (n sin(psi / 2))|^2 with psi = pi/2 (1 - sin(phi)).

    The highest side lobe is the first, between the zeros at 2 pi / n and 4 pi / n. A step of a degree misses
    less than 0.01 dB of it.
    """

    def factor(psi):
        return -((np.sin(count * psi / 2.0) / (count * np.sin(psi / 2.0))) ** 2)

    zeros = (2.0 * np.pi / count, 4.0 * np.pi / count)
    lobe_db = 10.0 * np.log10(-minimize_scalar(factor, bounds=zeros, method="bounded").fun)
    pattern = _pattern(vertical_snapshot(grid(count, 1, 0.0, 0.25 * LAMBDA_M), LAMBDA_M), step_deg=1.0)
    assert features(pattern).side_lobe_dbi == pytest.approx(pattern.max_gain_dbi + lobe_db, abs=0.01)


@pytest.mark.parametrize("turn_deg", [0.0, -90.0, 100.0])
def test_main_lobe_has_the_half_power_widths(turn_deg):
    """About 15 degrees in azimuth and 87 in elevation, wherever it points, across phi = 0 as well."""
    pattern = _article(turn_deg)
    lobe, found = main_lobe(pattern), features(pattern)
    assert pattern.max_phi_deg == pytest.approx((90.0 + turn_deg) % 360.0, abs=0.01)
    equator, meridian = len(lobe) // 2, round(((90.0 + turn_deg) % 360.0) / 2.0)
    assert 2.0 * lobe[equator].sum() == pytest.approx(found.azimuth_width_deg, abs=2.0)
    assert 2.0 * lobe[:, meridian].sum() == pytest.approx(found.elevation_width_deg, abs=2.0)
    assert (found.azimuth_width_deg, found.elevation_width_deg) == pytest.approx((15.4, 87.2), abs=0.1)
    assert lobe.any(axis=0).sum() * 2.0 < 20.0  # side lobes are 8 dB lower


def test_features_are_nearly_independent_of_the_grid():
    coarse, fine = features(_article(step_deg=5.0)), features(_article(step_deg=1.0))
    assert coarse.azimuth_width_deg == pytest.approx(fine.azimuth_width_deg, abs=0.05)
    assert coarse.elevation_width_deg == pytest.approx(fine.elevation_width_deg, abs=0.05)
    assert fine.side_lobe_dbi == pytest.approx(4.9, abs=0.05)


def test_other_lobes_of_equal_height_are_not_the_main_lobe():
    """Two dipoles a wavelength apart, in phase: four lobes of one height, in two pairs of mirror images."""
    pattern = _pattern(_row(2, 1.0), step_deg=3.0)
    high = pattern.gain_dbi >= pattern.max_gain_dbi - HALF_POWER_DB
    lobe = main_lobe(pattern)
    assert lobe.any()
    assert not (lobe & ~high).any()
    assert 2 * lobe.sum() < high.sum()


def test_a_lobe_over_ground_ends_at_the_horizon():
    """Half power is at 45 degrees of elevation: half of free space's width.

    It is that of a lone vertical dipole on perfect ground, sin^2 theta above the horizon and nothing below.
    """
    theta_deg, phi_deg = directions_deg(5.0)
    theta = np.radians(theta_deg)[:, np.newaxis] * np.ones(len(phi_deg))
    gain = np.where(theta <= np.pi / 2 + 1e-9, 3.0 * np.sin(theta) ** 2, 0.0)
    found = features(_made(gain, max_theta_deg=90.0, max_phi_deg=0.0))
    assert found.side_lobe_dbi is None  # no gain at all is no lobe
    assert found.elevation_width_deg == pytest.approx(45.0, abs=0.1)
    assert found.back_dbi == pytest.approx(10.0 * np.log10(3.0), abs=1e-6)


@pytest.mark.parametrize("axis", [(1.0, 0.0), (0.6, 0.8), (0.8, -0.6)])
def test_pole_on_the_flank_of_a_lobe_is_not_a_side_lobe(axis):
    """((1 + cos(a)) / 2)^4 falls from one direction to the opposite one, a away from it.

    At a pole it is less than on the half of the ring that is nearer to that direction, and more than on the
    other half.
    """
    theta_deg, phi_deg = directions_deg(5.0)
    theta, phi = np.radians(theta_deg)[:, np.newaxis], np.radians(phi_deg)
    toward = axis[0] * np.sin(theta) * np.cos(phi) + axis[1] * np.cos(theta)
    top_deg = np.degrees(np.arctan2(*axis))
    found = features(_made(((1.0 + toward) / 2.0) ** 4, max_theta_deg=top_deg, max_phi_deg=0.0))
    assert found.side_lobe_dbi is None


@pytest.mark.parametrize(("count", "step_deg"), [(8, 15.0), (8, 30.0), (16, 7.5)])
def test_unresolved_lobe_has_no_features(count, step_deg):
    """A row half a wavelength apart is 102 / count degrees wide, here half a step beside the grid's phi.

    The grid then resolves only its flanks, which are not side lobes.
    """
    row, turn_deg = _row(count, 0.5), step_deg / 2.0
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    pattern = _pattern(Snapshot(row.centres_m @ turn.T, turn @ row.rotations, row.voltages), step_deg)
    assert not main_lobe(pattern).any()
    found = features(pattern)
    assert (found.azimuth_width_deg, found.elevation_width_deg, found.side_lobe_dbi) == (None, None, None)


@pytest.mark.parametrize("count", [4, 8, 16, 32])
@pytest.mark.parametrize("step_deg", [2.0, 5.0, 10.0, 15.0])
def test_width_is_accurate_or_none(count, step_deg):
    """sin(n psi / 2) / (n sin(psi / 2)) with psi = pi cos(phi) has half power at 1.3916 * 2 / n for many n.

    Found here without that, by minimisation of the difference. The maximum is on the grid, where the pattern
    has its full gain however wide the steps are: splines through that and its neighbours are as wide as
    those.
    """

    def excess(off_rad):
        half_psi = 0.5 * np.pi * np.sin(off_rad)
        return abs((np.sin(count * half_psi) / (count * np.sin(half_psi))) ** 2 - 0.5)

    ends = (0.5 * 2.7832 / (np.pi * count), 1.5 * 2.7832 / (np.pi * count))
    width_deg = 2.0 * np.degrees(minimize_scalar(excess, bounds=ends, method="bounded").x)
    found = features(_pattern(_row(count, 0.5), step_deg)).azimuth_width_deg
    if width_deg > (LEAST_STEPS + 0.1) * step_deg:
        assert found == pytest.approx(width_deg, rel=0.01)
    elif width_deg < (LEAST_STEPS - 0.5) * step_deg:
        assert found is None
    else:
        assert found is None or found == pytest.approx(width_deg, rel=0.03)


@pytest.mark.parametrize("step_deg", [0.5, 5.0, 12.0])
def test_rings_and_mirror_images_are_ambiguous_maxima(step_deg):
    """One dipole's is a ring, a row's are two, on both sides, an end-fire array's is one, on the grid or not.

    That of two elements is flat: a cardioid, whose gain falls with the fourth power of the angle.
    """
    assert not has_one_maximum(_pattern(_row(1, 0.0), step_deg))
    assert not has_one_maximum(_pattern(_row(2, 0.5), step_deg))
    for turn_deg in (0.0, 0.3 * step_deg, 0.5 * step_deg):
        assert has_one_maximum(_article(turn_deg, step_deg))
    assert has_one_maximum(_pattern(vertical_snapshot(grid(2, 1, 0.0, 2.5), LAMBDA_M), step_deg))
