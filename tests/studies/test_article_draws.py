"""Tests of arrays without a flight: ideal, disturbed and tilted."""

import math

import numpy as np
import pytest

from studies.article.monte_carlo import array_of, draw, frequency_mhz, ideal_gains, tilted
from studies.article.plan import SCENARIO, ArticlePlan

SMALL = ArticlePlan(seeds=2, duration_s=6.0, wavelengths_m=(5.0, 10.0), winds_n=(0.0, 5.0), draws=20)


def scenario_of(tmp_path, *changes):
    """Write the article's scenario with lines changed."""
    text = SCENARIO.read_text(encoding="utf-8")
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    path = tmp_path / "changed.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_places_and_settings_are_those_of_the_scenario(tmp_path):
    """One row of eight at half a wavelength, on a grid of 10 degrees: array and draws have these settings."""
    path = scenario_of(
        tmp_path, ("columns = 4", "columns = 8"), ("rows = 2", "rows = 1"),
        ("broadside_spacing_lambda = 0.85", "broadside_spacing_lambda = 0.5"),
        ("wavelength_m = 10.0", "wavelength_m = 10.0\ngrid_deg = 10.0\nelement_length_m = 0.1"),
    )  # fmt: skip
    snapshot, config = array_of(7.5, path)
    assert (config.wavelength_m, config.grid_deg, config.element_length_m) == (7.5, 10.0, 0.1)
    assert sorted(snapshot.centres_m[:, 0]) == pytest.approx(3.75 * (np.arange(8) - 3.5))
    assert snapshot.centres_m[:, 1:] == pytest.approx(0.0)
    usual, changed = (ideal_gains((10.0,), each)["batch"][10.0] for each in (SCENARIO, path))
    assert abs(usual.max_gain_dbi - changed.max_gain_dbi) > 1.0
    assert changed.theta_deg[1] == 10.0
    drawn = draw(20, sigmas_m=(1e-4,), wavelengths_m=(10.0,), scenario=path)
    assert drawn[1e-4, 10.0].statistics.mean_dbi == pytest.approx(changed.max_gain_dbi, abs=0.01)
    assert drawn[1e-4, 10.0].mean_gain == pytest.approx(10.0 ** (changed.max_gain_dbi / 10.0), rel=0.01)


def test_tilted_array_has_its_tops_upwind():
    """Against a wind towards phi = 0 a dipole's axis, and its null, tilt to phi = 180 degrees."""
    leaning = tilted(10.0, math.radians(30.0), 0.0, 5.0)
    row = int(np.flatnonzero(leaning.theta_deg == 30.0)[0])
    assert leaning.gain_dbi[row, leaning.phi_deg == 180.0] < -50.0
    assert leaning.gain_dbi[row, leaning.phi_deg == 0.0] > -50.0


def test_solver_input_has_the_frequency_of_the_wavelength():
    assert frequency_mhz(20.0) == pytest.approx(299.792458 / 20.0)
