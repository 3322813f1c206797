import dataclasses

import numpy as np
import pytest
from antenna_arrays import vertical_snapshot
from antenna_hertzian import gain_dbi
from msgspec import structs
from scipy.spatial.transform import Rotation

from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, grid
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.parameters.config import RacetrackMotion
from harness.records.flight import Flight
from harness.report.flown_array import (
    NoFeed,
    antenna_from_ned,
    antenna_snapshot,
    figure_patterns,
    gain_series,
    ideal_pattern,
    snapshot_at,
)

CONFIG = AntennaConfig(grid_deg=15.0)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
PLACES_NED_M = grid(8, 4, 8.5, 2.5) @ antenna_from_ned(0.0) + [0.0, 0.0, -10.0]


def _flight(pos_ned_m, alive, desired_pos_ned_m=PLACES_NED_M, heading_rad=None):
    instants, vehicles = alive.shape
    return Flight(
        time_us=np.arange(instants, dtype=np.int64) * 500_000 + 7_000_000,
        pos_ned_m=pos_ned_m,
        q_ned_frd=np.broadcast_to(UPRIGHT, (instants, vehicles, 4)),
        desired_pos_ned_m=np.broadcast_to(desired_pos_ned_m, pos_ned_m.shape),
        heading_rad=np.zeros(instants) if heading_rad is None else heading_rad,
        alive=alive,
    )


@pytest.mark.parametrize(
    ("heading_deg", "east", "north"),
    [(0.0, [1.0, 0.0], [0.0, 1.0]), (90.0, [0.0, 1.0], [-1.0, 0.0]), (180.0, [-1.0, 0.0], [0.0, -1.0])],
)
def test_antenna_frame_rotates_clockwise_with_the_heading(heading_deg, east, north):
    """East and north in x and y of a frame whose y points along the heading."""
    to_antenna = antenna_from_ned(np.radians(heading_deg))
    np.testing.assert_allclose(to_antenna @ [0.0, 1.0, 0.0], [*east, 0.0], atol=1e-15)
    np.testing.assert_allclose(to_antenna @ [1.0, 0.0, 0.0], [*north, 0.0], atol=1e-15)
    np.testing.assert_allclose(to_antenna @ [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], atol=1e-15)


def test_dipoles_tilt_with_their_vehicles():
    """Nose down by 0.2 rad while heading north tilts the dipole to the north; roll right tilts it east."""
    q_ned_frd = Rotation.from_euler(
        "ZYX", [[0.0, -0.2, 0.0], [0.0, 0.0, 0.2], [np.pi / 2, -0.2, 0.0]]
    ).as_quat(scalar_first=True)
    snapshot = antenna_snapshot(PLACES_NED_M[:3], q_ned_frd, PLACES_NED_M[:3], 0.0, CONFIG)
    s, c = np.sin(0.2), np.cos(0.2)
    np.testing.assert_allclose(snapshot.axes, [[0.0, s, c], [s, 0.0, c], [s, 0.0, c]], atol=1e-12)


def test_snapshot_of_the_ideal_flight_is_the_ideal_array_at_any_heading():
    rng = np.random.default_rng(1)
    for heading_deg in (0.0, 37.0, -120.0):
        heading_rad = np.radians(heading_deg)
        places_ned_m = grid(8, 4, 8.5, 2.5) @ antenna_from_ned(heading_rad) + rng.normal(0.0, 50.0, 3)
        attitudes = np.tile(Rotation.from_euler("Z", 0.3).as_quat(scalar_first=True), (8, 1))
        snapshot = antenna_snapshot(places_ned_m, attitudes, places_ned_m, heading_rad, CONFIG)
        ideal = vertical_snapshot(grid(8, 4, 8.5, 2.5), 10.0)
        np.testing.assert_allclose(snapshot.centres_m, ideal.centres_m, atol=1e-9)
        np.testing.assert_allclose(snapshot.axes, ideal.axes, atol=1e-12)
        np.testing.assert_allclose(snapshot.voltages, ideal.voltages, atol=1e-9)


def test_feeds_are_those_of_the_places_and_not_of_the_positions():
    moved_ned_m = PLACES_NED_M + np.random.default_rng(2).normal(0.0, 1.0, (8, 3))
    snapshot = antenna_snapshot(moved_ned_m, np.tile(UPRIGHT, (8, 1)), PLACES_NED_M, 0.0, CONFIG)
    ideal = vertical_snapshot(grid(8, 4, 8.5, 2.5), 10.0)
    np.testing.assert_allclose(snapshot.voltages, ideal.voltages, atol=1e-12)
    np.testing.assert_allclose(
        snapshot.centres_m - ideal.centres_m, (moved_ned_m - PLACES_NED_M)[:, [1, 0, 2]] * [1, 1, -1]
    )


def test_feeds_may_be_for_estimated_or_true_positions():
    rng = np.random.default_rng(4)
    moved_ned_m, believed_ned_m = PLACES_NED_M + rng.normal(0.0, 1.0, (2, 8, 3))
    k_rad_m = 2.0 * np.pi / 10.0
    for feeds_for, fed_ned_m in (("estimates", believed_ned_m), ("truth", moved_ned_m)):
        config = structs.replace(CONFIG, feeds_for=feeds_for)
        snapshot = antenna_snapshot(
            moved_ned_m,
            np.tile(UPRIGHT, (8, 1)),
            PLACES_NED_M,
            0.0,
            config,
            believed_pos_ned_m=believed_ned_m,
        )
        north_m = fed_ned_m[:, 0] - PLACES_NED_M[:, 0].mean()
        np.testing.assert_allclose(snapshot.voltages, np.exp(-1j * k_rad_m * north_m), atol=1e-12)
    with pytest.raises(ValueError, match="were not recorded"):
        antenna_snapshot(
            moved_ned_m,
            np.tile(UPRIGHT, (8, 1)),
            PLACES_NED_M,
            0.0,
            structs.replace(CONFIG, feeds_for="estimates"),
        )


def test_a_vehicle_without_a_position_estimate_has_no_feed():
    """Estimates of a lost vehicle are ignored; the others' feeds are for their estimates."""
    believed_ned_m = np.tile(PLACES_NED_M, (4, 1, 1))
    believed_ned_m[0] = np.nan
    believed_ned_m[1, 3, 2] = np.nan
    believed_ned_m[2, 5] = np.nan
    alive = np.ones((4, 8), bool)
    alive[2, 5] = False
    flight = _flight(np.tile(PLACES_NED_M, (4, 1, 1)), alive)
    flight = dataclasses.replace(flight, believed_pos_ned_m=believed_ned_m)
    series = gain_series(flight, structs.replace(CONFIG, feeds_for="estimates"))
    assert [(m.time_us, m.reason) for m in series.missing] == [
        (7_000_000, "UAVs 0, 1, 2, 3, 4, 5, 6, 7 have no position estimate"),
        (7_500_000, "UAV 3 has no position estimate"),
    ]
    assert series.time_us.tolist() == [8_000_000, 8_500_000]
    assert len(series.median_snapshot.centres_m) == 7  # of two the one with less gain
    whole = gain_series(flight, CONFIG)
    assert whole.missing == ()
    np.testing.assert_allclose(series.max_gain_dbi, whole.max_gain_dbi[2:], atol=1e-9)
    with pytest.raises(NoFeed, match="UAV 3 has no position estimate"):
        snapshot_at(flight, 1, structs.replace(CONFIG, feeds_for="estimates"))


def test_a_policy_without_a_solution_is_an_instant_without_a_pattern():
    """Hansen and Woodyard's phases need two rows or more; of 4 x 2 the second row is lost."""
    alive = np.ones((2, 8), bool)
    alive[1, 4:] = False
    config = structs.replace(CONFIG, excitation="hansen_woodyard")
    series = gain_series(_flight(np.tile(PLACES_NED_M, (2, 1, 1)), alive), config)
    assert series.time_us.tolist() == [7_000_000]
    assert [m.time_us for m in series.missing] == [7_500_000]
    assert "need two rows" in series.missing[0].reason


def test_with_a_ground_heights_are_relative_to_it():
    config = structs.replace(CONFIG, ground="perfect")
    snapshot = antenna_snapshot(PLACES_NED_M, np.tile(UPRIGHT, (8, 1)), PLACES_NED_M, 0.0, config)
    np.testing.assert_allclose(snapshot.centres_m[:, 2], 10.0)
    assert ideal_pattern(PLACES_NED_M, 0.0, config).max_gain_dbi > 18.0  # 13.3 dBi and the image's 6 dB


@pytest.mark.nec2
def test_gain_follows_the_flight_with_gaps_without_an_antenna():
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")
    pos_ned_m = np.tile(PLACES_NED_M, (6, 1, 1))
    pos_ned_m[1] += np.random.default_rng(3).normal(0.0, 1.5, (8, 3))
    alive = np.ones((6, 8), bool)
    alive[2, :] = False
    pos_ned_m[3, 7] = pos_ned_m[3, 5]
    alive[3, 1] = False
    alive[4, 5] = False
    pos_ned_m[4, 5] = np.nan
    series = gain_series(_flight(pos_ned_m, alive), CONFIG)

    np.testing.assert_array_equal(series.time_us, [7_000_000, 7_500_000, 9_000_000, 9_500_000])
    assert [(m.time_us, m.reason) for m in series.missing] == [
        (8_000_000, "no vehicle is alive"),
        (8_500_000, "antennas of UAVs 5 and 7 touch"),
    ]
    ideal_dbi = ideal_pattern(PLACES_NED_M, 0.0, CONFIG).max_gain_dbi
    assert series.max_gain_dbi[[0, 3]] == pytest.approx(ideal_dbi, abs=1e-6)
    assert series.max_gain_dbi[1] < ideal_dbi - 1.0
    seven = np.delete(np.arange(8), 5)
    exact = gain_dbi(vertical_snapshot(grid(8, 4, 8.5, 2.5)[seven], 10.0), 10.0, 90.0, 90.0)
    bias_db = 10.0 * np.log10(series.patterns[2].average_gain)
    assert series.max_gain_dbi[2] - bias_db == pytest.approx(exact, abs=0.05)
    np.testing.assert_array_equal(series.max_gain_dbi, [pattern.max_gain_dbi for pattern in series.patterns])
    assert series.median_index == 2  # of 13.26, 8 to 12, 12.6 and 13.26: the lower of the middle two
    assert len(series.median_snapshot.centres_m) == 7


@pytest.mark.nec2
def test_the_beam_rotates_with_the_formation():
    """Around a racetrack the gain equals that at rest: the array is constant in the antenna's frame."""
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")
    plan = FormationPlan(PLACES_NED_M, 0.0, RacetrackMotion())
    since_s = np.array([0.0, 20.0, 35.0, 50.0])
    desired_ned_m, heading_rad = plan.places(since_s), plan.headings(since_s)
    assert np.ptp(heading_rad) > 1.0
    flight = _flight(desired_ned_m, np.ones((4, 8), bool), desired_ned_m, heading_rad)
    ideal_dbi = ideal_pattern(PLACES_NED_M, 0.0, CONFIG).max_gain_dbi
    series = gain_series(flight, CONFIG)
    np.testing.assert_allclose(series.max_gain_dbi, ideal_dbi, atol=1e-3)
    for t in range(4):
        centres_m = snapshot_at(flight, t, CONFIG).centres_m
        np.testing.assert_allclose(centres_m, grid(8, 4, 8.5, 2.5), atol=1e-9)
    # fed for a wrong heading the antenna differs
    wrong = _flight(desired_ned_m, np.ones((4, 8), bool), desired_ned_m, np.zeros(4))
    assert gain_series(wrong, CONFIG).max_gain_dbi[3] < ideal_dbi - 1.0


@pytest.mark.nec2
def test_figure_shows_the_median_instant_beside_the_ideal_on_a_finer_grid():
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")
    pos_ned_m = PLACES_NED_M + np.random.default_rng(4).normal(0.0, 0.5, (3, 8, 3))
    series = gain_series(_flight(pos_ned_m, np.ones((3, 8), bool)), CONFIG)
    ideal, flown = figure_patterns(series, PLACES_NED_M, 0.0, CONFIG)
    assert flown.max_gain_dbi == pytest.approx(np.median(series.max_gain_dbi), abs=0.001)
    assert ideal.max_gain_dbi == pytest.approx(13.262, abs=0.001)
    assert flown.theta_deg[1] == ideal.theta_deg[1] == 1.5


@pytest.mark.nec2
def test_an_impossible_formation_has_no_ideal_pattern():
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")
    with pytest.raises(ElementsTouch):
        ideal_pattern(np.zeros((2, 3)), 0.0, CONFIG)


def test_series_without_patterns_has_no_median():
    series = gain_series(_flight(np.zeros((2, 8, 3)), np.zeros((2, 8), bool)), CONFIG)
    assert len(series.missing) == 2
    assert series.max_gain_dbi.shape == (0,)
    assert series.median_index is None
    with pytest.raises(ValueError, match="no median"):
        figure_patterns(series, PLACES_NED_M, 0.0, CONFIG)


def test_a_series_without_grids_has_the_same_maxima_whatever_is_computed_together(monkeypatch):
    pos_ned_m = np.tile(PLACES_NED_M, (300, 1, 1)) + np.random.default_rng(5).normal(0.0, 0.3, (300, 8, 3))
    flight, config = _flight(pos_ned_m, np.ones((300, 8), bool)), AntennaConfig(grid_deg=15.0)
    whole = gain_series(flight, config)
    monkeypatch.setattr("harness.report.flown_array._AT_ONCE", 64)
    light = gain_series(flight, config, with_grids=False)
    assert len(whole.patterns) == len(light.patterns) == 300
    for pattern, alone in zip(whole.patterns, light.patterns, strict=True):
        for name in ("max_gain_dbi", "max_theta_deg", "max_phi_deg", "average_gain", "backend"):
            assert getattr(pattern, name) == getattr(alone, name)
        assert alone.theta_gain_dbi.nbytes == alone.theta_deg.nbytes == 0 < pattern.theta_gain_dbi.nbytes
