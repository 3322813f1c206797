import numpy as np
import pytest
from antenna_arrays import vertical_snapshot
from antenna_hertzian import exact_patterns
from matplotlib.image import imread

from antenna.model.geometry import grid
from autopilot.onboard.formation.formation_plan import FormationPlan
from autopilot.parameters.config import RacetrackMotion
from harness.records.flight import Flight
from harness.report import figures
from harness.report.formation_error import formation_error


def _flight(vehicles=8, instants=40):
    rng = np.random.default_rng(1)
    places_ned_m = grid(vehicles, 4, 8.5, 2.5) * [1.0, 1.0, 0.0] + [0.0, 0.0, -10.0]
    alive = np.ones((instants, vehicles), bool)
    alive[20:, 1:2] = False
    alive[:, 2:3] = False
    return Flight(
        time_us=np.arange(instants, dtype=np.int64) * 100_000,
        pos_ned_m=places_ned_m + rng.normal(0.0, 0.5, (instants, vehicles, 3)),
        q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (instants, vehicles, 1)),
        desired_pos_ned_m=np.broadcast_to(places_ned_m, (instants, vehicles, 3)),
        heading_rad=np.zeros(instants),
        alive=alive,
    )


def _assert_drawn(path):
    """Check that the file is an image of some size that is not blank."""
    pixels = imread(path)[..., :3]
    assert min(pixels.shape[:2]) >= 400
    dark = (pixels.min(axis=-1) < 0.9).mean()
    assert dark > 0.01


@pytest.mark.parametrize("vehicles", [8, 32])
def test_flight_is_drawn_with_lost_vehicles_and_with_many(tmp_path, vehicles):
    flight = _flight(vehicles)
    figures.save_tracks(tmp_path / "tracks.png", flight)
    figures.save_formation_error(tmp_path / "error.png", flight.time_us, formation_error(flight))
    _assert_drawn(tmp_path / "tracks.png")
    _assert_drawn(tmp_path / "error.png")


def test_flight_of_a_moving_formation_is_drawn(tmp_path):
    plan = FormationPlan(grid(8, 4, 8.5, 2.5) - [0.0, 0.0, 20.0], 0.0, RacetrackMotion())
    since_s = np.linspace(-10.0, 130.0, 400)
    desired_ned_m = plan.places(since_s)
    alive = np.ones((400, 8), bool)
    alive[200:, 1] = False
    flight = Flight(
        time_us=(np.arange(400) * 350_000).astype(np.int64),
        pos_ned_m=desired_ned_m + np.random.default_rng(1).normal(0.0, 0.2, desired_ned_m.shape),
        q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (400, 8, 1)),
        desired_pos_ned_m=desired_ned_m,
        heading_rad=plan.headings(since_s),
        alive=alive,
    )
    figures.save_tracks(tmp_path / "tracks.png", flight)
    _assert_drawn(tmp_path / "tracks.png")


def test_error_of_a_lone_vehicle_is_drawn_without_a_shape(tmp_path):
    flight = _flight(1)
    error = formation_error(flight)
    assert error.shape.rms_m is None
    figures.save_formation_error(tmp_path / "error.png", flight.time_us, error)
    _assert_drawn(tmp_path / "error.png")


def test_antenna_is_drawn(tmp_path):
    ideal = vertical_snapshot(grid(8, 4, 8.5, 2.5), 10.0)
    (pattern,) = exact_patterns([ideal], 10.0, 10.0)
    figures.save_patterns(tmp_path / "patterns.png", pattern, pattern)
    figures.save_gain_density(tmp_path / "gain.png", {"flown": np.linspace(11.0, 13.0, 60)}, 13.26)
    _assert_drawn(tmp_path / "patterns.png")
    _assert_drawn(tmp_path / "gain.png")


def test_radio_is_drawn(tmp_path):
    rng = np.random.default_rng(2)
    figures.save_channel_occupancy(
        tmp_path / "channel.png", np.arange(100, dtype=np.int64) * 1_000_000, rng.random(100)
    )
    figures.save_ftm_errors(tmp_path / "ftm.png", rng.normal(0.0, 0.1, 500))
    _assert_drawn(tmp_path / "channel.png")
    _assert_drawn(tmp_path / "ftm.png")
