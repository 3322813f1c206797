import numpy as np
import pytest
from antenna_arrays import ideal, perturbed
from antenna_hertzian import exact_patterns
from matplotlib.contour import QuadContourSet

from antenna.analysis.gain_figures import (
    CUT_FLOOR_DBI,
    OUTLINE,
    cuts_figure,
    envelope_figure,
    gain_density_figure,
    horizon_cut,
    meridian_cut,
    patterns_figure,
)
from antenna.analysis.statistics import QUANTILES, RunningEnvelope
from antenna.model.geometry import Snapshot

LAMBDA_M = 10.0


def _pattern(turn_deg=0.0, step_deg=3.0):
    """Make the pattern of the article's array, turned about the vertical towards larger phi."""
    array = ideal(LAMBDA_M)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = Snapshot(array.centres_m @ turn.T, turn @ array.rotations, array.voltages)
    return exact_patterns([turned], LAMBDA_M, step_deg)[0]


def test_patterns_share_a_colour_scale_and_outline_their_lobes():
    figure = patterns_figure({"Ideal": _pattern(), "Flown": _pattern(20.0)})
    first, flown, colour_bar = figure.axes
    assert first.get_title() == "Ideal: 13.28 dBi at θ 90°, φ 90°"
    assert flown.get_title() == "Flown: 13.28 dBi at θ 90°, φ 110°"
    assert colour_bar.get_ylabel() == "Gain (dBi)"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [OUTLINE]
    for axes in (first, flown):
        assert axes.images[0].get_clim() == (-30.0, 18.0)
        assert axes.images[0].get_cmap().name == "viridis"
        assert sum(isinstance(artist, QuadContourSet) for artist in axes.collections) == 1
    (outline,) = (artist for artist in flown.collections if isinstance(artist, QuadContourSet))
    in_panel = [path for path in outline.get_paths()[0].to_polygons() if 0.0 <= path[:, 0].mean() < 360.0]
    assert len(in_panel) == 1
    assert in_panel[0][:, 0].mean() == pytest.approx(110.0, abs=2.0)


def test_a_null_is_drawn_without_gaps():
    """Along the first null beside the main lobe every drawn direction is low, not only those of the grid."""
    panel, _ = patterns_figure({"Ideal": _pattern(step_deg=1.5)}).axes
    image = panel.images[0].get_array()
    step_deg = 360.0 / (image.shape[1] - 1)
    beside = image[:, round(95.0 / step_deg) : round(125.0 / step_deg)]
    lowest_dbi = beside[round(60.0 / step_deg) : round(120.0 / step_deg)].min(axis=1)
    assert lowest_dbi.max() < -20.0


def test_gain_density_shows_every_series_also_a_constant_one():
    rng = np.random.default_rng(6)
    figure = gain_density_figure({"2 N": rng.normal(12.0, 0.3, 50), "calm": np.full(50, 13.2)}, 13.26)
    (axes,) = figure.axes
    labels = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    assert labels[0].startswith("2 N: 1")
    assert labels[1:] == ["calm: 13.20 ± 0.00 dBi", "ideal: 13.26 dBi"]


def test_gain_density_has_the_deviation_of_gain_statistics():
    """Of 11, 12 and 13 dBi it is 1 dB, K - 1 in the denominator, and not sqrt(2 / 3)."""
    (axes,) = gain_density_figure({"three": np.array([11.0, 12.0, 13.0])}, None).axes
    labels = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    assert labels == ["three: 12.00 ± 1.00 dBi"]  # and no ideal, where there is none


def test_unresolved_lobe_has_no_outline():
    """15 degrees wide, 9 degrees from the nearest direction."""
    figure = patterns_figure({"Coarse": _pattern(9.0, step_deg=18.0)})
    panel, _ = figure.axes
    assert not figure.legends
    assert not any(isinstance(artist, QuadContourSet) for artist in panel.collections)


def test_cuts_are_closed_rows_and_columns_of_the_grid():
    """The values are theta + phi / 1000, so that each says where it comes from."""
    theta_deg, phi_deg = np.linspace(0.0, 180.0, 7), np.arange(0.0, 360.0, 30.0)
    values = theta_deg[:, np.newaxis] + phi_deg / 1000.0
    angles_deg, horizon = horizon_cut(phi_deg, values)
    np.testing.assert_allclose(horizon, 90.0 + (angles_deg % 360.0) / 1000.0)
    angles_deg, meridian = meridian_cut(theta_deg, values)
    assert (angles_deg[0], angles_deg[-1]) == (0.0, 360.0)
    down = angles_deg <= 180.0
    np.testing.assert_allclose(meridian[down], angles_deg[down] + 0.09)
    np.testing.assert_allclose(meridian[~down], 360.0 - angles_deg[~down] + 0.27)


def test_polar_cuts_reach_the_maximum_and_stop_at_the_floor():
    pattern = _pattern()
    azimuth, elevation = cuts_figure({"Ideal": pattern}).axes
    for axes, peak_rad in ((azimuth, np.pi / 2.0), (elevation, np.pi / 2.0)):
        (line,) = axes.get_lines()
        angles_rad, gain_dbi = line.get_data()
        assert gain_dbi.max() == pytest.approx(pattern.max_gain_dbi, abs=1e-6)
        assert angles_rad[np.argmax(gain_dbi)] == pytest.approx(peak_rad)
        assert gain_dbi.min() == CUT_FLOOR_DBI == axes.get_ylim()[0]
        assert axes.get_ylim()[1] == 15.0


def test_envelope_contains_its_patterns():
    rng = np.random.default_rng(3)
    patterns = exact_patterns([perturbed(rng, LAMBDA_M) for _ in range(12)], LAMBDA_M)
    running = RunningEnvelope()
    for pattern in patterns:
        running.add(pattern)
    figure = envelope_figure(running.result(), _pattern())
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert QUANTILES[0] == 0.05
    assert labels == ["least to greatest", "middle 90%", "middle 50%", "mean of 12", "ideal"]
    for axes in figure.axes:
        mean, _ = axes.get_lines()
        band = axes.collections[0].get_paths()[0].vertices
        assert band[:, 1].max() >= mean.get_ydata().max()
        assert axes.get_ylim() == (-30.0, 18.0)
