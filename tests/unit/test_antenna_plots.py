import numpy as np
import pytest
from antenna_hertzian import gain_dbi
from matplotlib.contour import QuadContourSet

from antenna.geometry import Snapshot, grid, vertical_snapshot
from antenna.patterns import directions_deg, make_pattern
from antenna.plots import gain_density_figure, main_lobe, patterns_figure


def _pattern(turn_deg=0.0, step_deg=2.0):
    """Make the pattern of the article's array, turned about the vertical towards larger phi."""
    ideal = vertical_snapshot(grid(8, 4, 8.5, 2.5), 10.0)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turned = Snapshot(
        ideal.centres_m @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), ideal.axes, ideal.voltages
    )
    theta_deg, phi_deg = directions_deg(step_deg)
    gains = gain_dbi(turned, 10.0, theta_deg[:, np.newaxis], phi_deg)
    return make_pattern(gains, lambda t, p: float(gain_dbi(turned, 10.0, t, p)), turned, 10.0)


@pytest.mark.parametrize("turn_deg", [0.0, -90.0, 100.0])
def test_main_lobe_has_the_half_power_widths(turn_deg):
    """About 15 degrees in azimuth and 87 in elevation, wherever it points, across phi = 0 as well."""
    pattern = _pattern(turn_deg)
    lobe = main_lobe(pattern)
    assert pattern.max_phi_deg == pytest.approx((90.0 + turn_deg) % 360.0, abs=0.01)
    equator, meridian = len(lobe) // 2, round(((90.0 + turn_deg) % 360.0) / 2.0)
    assert 2.0 * lobe[equator].sum() == pytest.approx(15.0, abs=2.0)
    assert 2.0 * lobe[:, meridian].sum() == pytest.approx(87.0, abs=3.0)
    assert lobe.any(axis=0).sum() * 2.0 < 20.0  # side lobes are 8 dB lower


def test_other_lobes_as_high_are_not_the_main_lobe():
    """Two dipoles a wavelength apart, in phase: four lobes of one height, in two pairs of mirror images."""
    snapshot = vertical_snapshot(np.array([[-5.0, 0.0, 0.0], [5.0, 0.0, 0.0]]), 10.0)
    theta_deg, phi_deg = directions_deg(3.0)
    gains = gain_dbi(snapshot, 10.0, theta_deg[:, np.newaxis], phi_deg)
    pattern = make_pattern(gains, lambda t, p: float(gain_dbi(snapshot, 10.0, t, p)), snapshot, 10.0)
    high = gains >= pattern.max_gain_dbi - 3.0
    lobe = main_lobe(pattern)
    assert lobe.any()
    assert not (lobe & ~high).any()
    assert 2 * lobe.sum() < high.sum()


def test_patterns_share_one_scale_and_each_has_its_lobe_outlined():
    figure = patterns_figure({"Ideal": _pattern(), "Flown": _pattern(20.0)})
    ideal, flown, colour_bar = figure.axes
    assert ideal.get_title() == "Ideal: 13.28 dBi at θ 90°, φ 90°"
    assert flown.get_title() == "Flown: 13.28 dBi at θ 90°, φ 110°"
    assert colour_bar.get_ylabel() == "Gain (dBi)"
    for axes in (ideal, flown):
        assert axes.collections[0].get_clim() == (-30.0, 18.0)
        assert sum(isinstance(artist, QuadContourSet) for artist in axes.collections) == 1
    (outline,) = (artist for artist in flown.collections if isinstance(artist, QuadContourSet))
    in_panel = [path for path in outline.get_paths()[0].to_polygons() if 0.0 <= path[:, 0].mean() < 360.0]
    assert len(in_panel) == 1
    assert in_panel[0][:, 0].mean() == pytest.approx(110.0, abs=2.0)


def test_gain_density_shows_every_series_even_a_constant_one():
    rng = np.random.default_rng(6)
    figure = gain_density_figure({"2 N": rng.normal(12.0, 0.3, 50), "calm": np.full(50, 13.2)}, 13.26)
    (axes,) = figure.axes
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels[0].startswith("2 N: 1")
    assert labels[1:] == ["calm: 13.20 ± 0.00 dBi", "ideal: 13.26 dBi"]
