"""Antennas and gains of single stations: reciprocal, equal to the common ones where they are equal."""

from itertools import pairwise

import numpy as np
import pytest
from netsim_swarm import make_links

from netsim.model.config import InterfererConfig, RadioConfig, RadioModel, StationConfig
from netsim.phy.propagation import COMPUTED_TOGETHER, Trajectories

PLACES = np.array([(0.0, 0.0, -10.0), (40.0, 10.0, -20.0), (-30.0, 25.0, -2.0), (5.0, -60.0, -15.0)])
ATTITUDES = np.array([(1.0, 0.0, 0.0, 0.0), (0.8, 0.6, 0.0, 0.0), (0.8, 0.0, 0.6, 0.0), (0.6, 0.0, 0.0, 0.8)])
N = len(PLACES)


def powers_db(stations=(), **settings):
    """Return the received powers (N, N) in dBm."""
    config = RadioConfig(stations=stations, rician_k_db=None, **settings)
    trajectories = Trajectories(N)
    trajectories.set(0, PLACES, np.zeros((N, 3)), ATTITUDES)
    links = make_links(config, trajectories, N, 1)
    rows = np.array([links.row(i, 0).powers_mw for i in range(N)])
    np.fill_diagonal(rows, 1.0)
    return 10.0 * np.log10(rows)


def own(number, **settings):
    return (StationConfig(station=number, **settings),)


@pytest.mark.parametrize("settings", [{}, {"path_loss": "two_ray"}, {"antenna": "dipole"}], ids=str)
def test_a_gain_counts_once_at_each_end_of_its_links(settings):
    gained_db = powers_db(own(2, antenna_gain_dbi=7.0), antenna_gain_dbi=2.0, **settings)
    expected_db = np.zeros((N, N))
    expected_db[2, :] = expected_db[:, 2] = 5.0
    expected_db[2, 2] = 0.0
    assert gained_db - powers_db(antenna_gain_dbi=2.0, **settings) == pytest.approx(expected_db, abs=1e-9)


@pytest.mark.parametrize("path_loss", ["log_distance", "two_ray"])
@pytest.mark.parametrize("common", ["isotropic", "dipole"])
@pytest.mark.parametrize("single", ["isotropic", "dipole"])
def test_links_are_reciprocal_and_of_other_stations_unchanged(path_loss, common, single):
    changed_db = powers_db(own(1, antenna=single), antenna=common, path_loss=path_loss)
    common_db = powers_db(antenna=common, path_loss=path_loss)
    assert changed_db == pytest.approx(changed_db.T, abs=1e-9)
    others = np.ix_([0, 2, 3], [0, 2, 3])
    assert changed_db[others] == pytest.approx(common_db[others], abs=1e-9)
    if single == common:
        assert changed_db == pytest.approx(common_db, abs=1e-9)
    else:
        assert np.abs(changed_db - common_db)[1, [0, 2, 3]].min() > 0.1


def test_a_dipole_receives_half_of_a_wave_of_unknown_polarisation():
    """The gain of an upright half-wave dipole at an elevation e is (cos(pi/2 sin e) / cos e)^2."""
    loss_db = powers_db() - powers_db(own(0, antenna="dipole"))
    away_m = PLACES[1:] - PLACES[0]
    sine = away_m[:, 2] / np.linalg.norm(away_m, axis=1)
    gain = (np.cos(0.5 * np.pi * sine) / np.sqrt(1.0 - sine**2)) ** 2
    assert loss_db[0, 1:] == pytest.approx(-10.0 * np.log10(0.5 * gain), abs=0.05)


def test_a_pattern_of_one_station_is_that_of_all_on_its_links_once():
    pattern = RadioModel(model="user_radio_models:Cardioid")
    both_db = powers_db(antenna=pattern) - powers_db()
    of_one_db = [powers_db(own(i, antenna=pattern)) - powers_db() for i in range(N)]
    for a, b in pairwise(range(N)):
        assert of_one_db[a][a, b] + of_one_db[b][a, b] == pytest.approx(both_db[a, b], abs=1e-9)


def test_interferers_meet_the_antenna_of_each_station():
    def rows(stations=(), **settings):
        source = InterfererConfig(pos_ned_m=(100.0, 50.0, -10.0), duty_cycle=0.5)
        config = RadioConfig(stations=stations, interferers=(source,), rician_k_db=None, **settings)
        trajectories = Trajectories(N)
        trajectories.set(0, PLACES, np.zeros((N, 3)), ATTITUDES)
        return 10.0 * np.log10(make_links(config, trajectories, N, 1).interferer_row(0, 0).powers_mw)

    plain, dipoles = rows(), rows(antenna="dipole")
    mixed = rows(own(3, antenna="dipole", antenna_gain_dbi=4.0))
    assert mixed[:3] == pytest.approx(plain[:3], abs=1e-9)
    assert mixed[3] == pytest.approx(dipoles[3] + 4.0, abs=1e-9)


def test_many_stations_have_the_budgets_of_few():
    """With more than `COMPUTED_TOGETHER` stations rows are computed one by one."""
    settings = {"stations": own(1, antenna="dipole", antenna_gain_dbi=3.0), "rician_k_db": None}
    count = COMPUTED_TOGETHER + 1
    trajectories = Trajectories(count)
    places = np.vstack([PLACES, PLACES[:1] + 500.0 * np.arange(1, count - N + 1)[:, None]])
    attitudes = np.vstack([ATTITUDES, np.tile(ATTITUDES[:1], (count - N, 1))])
    trajectories.set(0, places, np.zeros((count, 3)), attitudes)
    links = make_links(RadioConfig(**settings), trajectories, count, 1)
    rows = np.array([links.row(i, 0).powers_mw[:N] for i in range(N)])
    np.fill_diagonal(rows, 1.0)
    assert 10.0 * np.log10(rows) == pytest.approx(powers_db(settings["stations"]), abs=1e-9)
