from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from autopilot.onboard.formation_plan import FormationPlan
from autopilot.parameters.config import RacetrackMotion
from foundation.airframe.files import IRIS
from harness.records.flight import Flight
from harness.report.formation_error import formation_error

PLACES_NED_M = np.array([[n, e, -10.0] for n in (-1.25, 1.25) for e in (-12.75, -4.25, 4.25, 12.75)])


def _turned(places_ned_m, yaw_rad):
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return places_ned_m @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _flight(flown_ned_m, alive=None, desired_ned_m=PLACES_NED_M):
    """Return a flight; ``flown_ned_m`` is relative to landed vehicles, the truth is of centres of mass."""
    pos_ned_m = flown_ned_m - np.array([0.0, 0.0, IRIS.standing_height_m])
    instants, vehicles = pos_ned_m.shape[:2]
    return Flight(
        time_us=np.arange(instants, dtype=np.int64) * 20_000,
        pos_ned_m=pos_ned_m,
        q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (instants, vehicles, 1)),
        desired_pos_ned_m=np.broadcast_to(desired_ned_m, pos_ned_m.shape),
        heading_rad=np.zeros(instants),
        alive=np.ones((instants, vehicles), bool) if alive is None else alive,
    )


@pytest.mark.parametrize("yaw_deg", [0.0, 10.0, -100.0, 179.0])
def test_rigid_motion_is_absolute_error_and_no_shape_error(yaw_deg):
    shift_ned_m = np.array([3.0, -4.0, 12.0])
    error = formation_error(_flight((_turned(PLACES_NED_M, np.radians(yaw_deg)) + shift_ned_m)[np.newaxis]))
    assert error.shape.rms_m == pytest.approx(0.0, abs=1e-12)
    assert np.degrees(error.yaw_rad) == pytest.approx([yaw_deg])
    # The axis of rotation is the places' centre, so rotation and shift add in squares.
    turn_m2 = np.mean(np.sum((_turned(PLACES_NED_M, np.radians(yaw_deg)) - PLACES_NED_M) ** 2, axis=1))
    assert error.absolute.rms_m == pytest.approx(np.sqrt(13.0**2 + turn_m2))
    assert error.absolute.horizontal_rms_m == pytest.approx(np.sqrt(5.0**2 + turn_m2))


def test_a_height_relative_to_the_landed_vehicle_has_no_error():
    """Ten metres above the landed position: the centre is 10.055 m above the ground."""
    pos_ned_m = PLACES_NED_M - np.array([0.0, 0.0, 0.055])
    error = formation_error(replace(_flight(pos_ned_m[np.newaxis]), pos_ned_m=pos_ned_m[np.newaxis]))
    assert error.absolute.rms_m == pytest.approx(0.0, abs=1e-12)
    assert error.shape.rms_m == pytest.approx(0.0, abs=1e-12)


def test_clockwise_from_above_is_positive_yaw():
    east_of_north = _turned(np.array([[1.0, 0.0, 0.0]]), np.pi / 2)
    np.testing.assert_allclose(east_of_north, [[0.0, 1.0, 0.0]], atol=1e-15)


def test_errors_of_a_moving_formation_are_relative_to_its_moving_places():
    """A formation 2 s late on its racetrack has its shape, is 6 m behind, and is rotated."""
    plan = FormationPlan(PLACES_NED_M, 0.0, RacetrackMotion(radius_m=30.0))
    since_s = np.linspace(10.0, 130.0, 200)
    late_ned_m = plan.places(since_s - 2.0)
    flight = _flight(late_ned_m, desired_ned_m=plan.places(since_s))
    error = formation_error(flight)
    assert error.shape.rms_m == pytest.approx(0.0, abs=1e-9)
    behind_rad = plan.headings(since_s - 2.0) - plan.headings(since_s)
    np.testing.assert_allclose(np.sin(error.yaw_rad - behind_rad), 0.0, atol=1e-12)
    # the centre's path of 6 m is at least its chord over 6 / 30 rad
    distance_m = np.linalg.norm(late_ned_m.mean(axis=1) - flight.desired_pos_ned_m.mean(axis=1), axis=1)
    assert distance_m.max() == pytest.approx(6.0, abs=1e-6)
    assert distance_m.min() >= 2.0 * 30.0 * np.sin(0.1) - 1e-6


def test_tilted_formation_keeps_its_tilt_as_shape_error():
    """Alignment rotates about the vertical only: a tilt of the array is a shape error."""
    pos_ned_m = PLACES_NED_M.copy()
    pos_ned_m[:, 2] += 0.1 * pos_ned_m[:, 1]
    error = formation_error(_flight(pos_ned_m[np.newaxis]))
    assert error.shape.horizontal_rms_m == pytest.approx(0.0, abs=1e-12)
    assert error.shape.rms_m == pytest.approx(0.1 * np.sqrt(np.mean(PLACES_NED_M[:, 1] ** 2)))


def test_alignment_is_optimal_in_the_least_squares_sense():
    rng = np.random.default_rng(1)
    alive = rng.random((5, 8)) < 0.7
    alive[:, :2] = True
    pos_ned_m = _turned(PLACES_NED_M, 0.4) + rng.normal([1.0, 2.0, 3.0], 1.0, (5, 8, 3))
    error = formation_error(_flight(pos_ned_m, alive))
    for t in range(5):

        def cost_m2(x, t=t):
            aligned_ned_m = _turned(PLACES_NED_M, x[0]) + x[1:]
            return np.sum((pos_ned_m[t] - aligned_ned_m)[alive[t]] ** 2)

        best = minimize(cost_m2, [0.3, 0.0, 0.0, 0.0], tol=1e-12)
        assert np.sum(error.shape.error_m[t, alive[t]] ** 2) == pytest.approx(best.fun, rel=1e-6)
        assert error.yaw_rad[t] == pytest.approx(best.x[0], abs=1e-4)


def test_independent_errors_lose_four_degrees_of_freedom():
    """Alignment fits three translations and a rotation: 24 - 4 of 24 variances of eight vehicles remain."""
    rng = np.random.default_rng(2)
    error = formation_error(_flight(PLACES_NED_M + rng.normal(0.0, 0.2, (4000, 8, 3))))
    assert error.absolute.rms_m == pytest.approx(0.2 * np.sqrt(3.0), rel=0.01)
    assert error.shape.rms_m == pytest.approx(0.2 * np.sqrt(3.0 * 20.0 / 24.0), rel=0.01)
    assert error.shape.horizontal_rms_m == pytest.approx(0.2 * np.sqrt(2.0 * 13.0 / 16.0), rel=0.01)


def test_lost_vehicles_are_ignored():
    rng = np.random.default_rng(3)
    pos_ned_m = PLACES_NED_M + rng.normal(0.0, 0.5, (20, 8, 3))
    alive = np.ones((20, 8), bool)
    alive[8:, 2] = False
    fallen_ned_m = pos_ned_m.copy()
    fallen_ned_m[8:, 2] = [500.0, np.nan, 0.0]
    error = formation_error(_flight(fallen_ned_m, alive))
    others = [i for i in range(8) if i != 2]
    without = formation_error(_flight(pos_ned_m[:, others], desired_ned_m=PLACES_NED_M[others]))
    np.testing.assert_allclose(error.shape.error_m[8:, others], without.shape.error_m[8:])
    np.testing.assert_allclose(error.absolute.error_m[:, others], without.absolute.error_m)
    own_m = np.linalg.norm(pos_ned_m[:8, 2] - PLACES_NED_M[2], axis=-1)
    assert error.absolute.vehicle_rms_m[2] == pytest.approx(np.sqrt(np.mean(own_m**2)))
    assert np.isfinite(error.absolute.rms_m)
    assert np.isfinite(error.shape.rms_m)


def test_shape_needs_two_vehicles_and_absolute_one():
    alive = np.zeros((3, 8), bool)
    alive[0, 4] = alive[1, [4, 5]] = True
    error = formation_error(
        _flight(np.broadcast_to(PLACES_NED_M + np.array([0.0, 0.0, 2.0]), (3, 8, 3)), alive)
    )
    np.testing.assert_array_equal(error.shape.valid.any(axis=1), [False, True, False])
    assert error.absolute.rms_m == pytest.approx(2.0)
    assert error.absolute.vehicle_rms_m == (*[None] * 4, pytest.approx(2.0), pytest.approx(2.0), None, None)


def test_flight_without_living_vehicles_has_no_error():
    error = formation_error(_flight(np.zeros((3, 8, 3)), np.zeros((3, 8), bool)))
    assert error.absolute.rms_m is None
    assert error.shape.horizontal_rms_m is None


def test_each_instant_has_the_error_that_it_has_alone(monkeypatch):
    """Instants are computed in blocks; a block, also of views, has the bits of the whole."""
    random = np.random.default_rng(1)
    alive = random.random((23, 8)) < 0.9
    columns = random.normal(size=(3, 23 * 8))  # a column for each component, as in a flight's file
    whole = _flight(random.normal(size=(23, 8, 3)), alive, columns.T.reshape(23, 8, 3))
    expected = formation_error(whole)
    monkeypatch.setattr("harness.report.formation_error._AT_ONCE", 5)
    found = formation_error(whole)
    assert np.array_equal(found.yaw_rad, expected.yaw_rad)
    for name in ("absolute", "shape"):
        for field in ("error_m", "horizontal_m", "valid"):
            assert np.array_equal(
                getattr(getattr(found, name), field), getattr(getattr(expected, name), field)
            )
