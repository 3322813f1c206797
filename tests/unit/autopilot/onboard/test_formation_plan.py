"""Plan of a moving formation: a smooth motion of a rigid body that ends or closes exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import simpson
from scipy.spatial.distance import pdist

from autopilot.onboard.formation_plan import FormationPlan, check
from autopilot.parameters.config import RacetrackMotion, TrackMotion

PLACES_NED_M = np.array([[n, e, -10.0 - e / 10] for n in (-1.25, 1.25) for e in (-12.75, -4.25, 4.25, 12.75)])
PLACES_NED_M += [30.0, -20.0, 0.0]
CENTRE_NED_M = PLACES_NED_M.mean(axis=0)


def _compass(course_deg):
    return np.array([np.cos(np.radians(course_deg)), np.sin(np.radians(course_deg)), 0.0])


def _lap_m(motion):
    """Return the length of two straights and two half turns.

    The curvature's integral over a half turn is pi. A length E = pi R / 2 at each of its ends has the mean
    curvature 1 / 2 R, so (E + P) / R = pi for a tightest part of length P = pi R / 2; the turn is 2 E + P
    long.
    """
    return 2.0 * (motion.length_m + 1.5 * np.pi * motion.radius_m)


def _at_full_speed_s(motion):
    return motion.speed_m_s / motion.acceleration_m_s2


floats = st.floats
courses = floats(-360.0, 360.0)


@st.composite
def racetracks(draw):
    speed_m_s = draw(floats(0.5, 8.0))
    return RacetrackMotion(
        speed_m_s=speed_m_s,
        acceleration_m_s2=draw(floats(0.2, 3.0)),
        length_m=draw(st.just(0.0) | floats(0.0, 80.0)),
        radius_m=max(5.0, speed_m_s**2 / 3.0) * draw(floats(1.0, 3.0)),
        course_deg=draw(courses),
        side=draw(st.sampled_from(["left", "right"])),
        heading=draw(st.sampled_from(["fixed", "track"])),
    )


tracks = st.builds(
    TrackMotion,
    speed_m_s=floats(0.5, 9.0),
    acceleration_m_s2=floats(0.2, 3.0),
    length_m=floats(0.5, 200.0),
    course_deg=courses,
)
motions = racetracks() | tracks
few = settings(max_examples=40, deadline=None, derandomize=True)


def _duration_s(motion):
    """Return the time of a lap and a half, or of the track and some seconds more."""
    if isinstance(motion, RacetrackMotion):
        return _at_full_speed_s(motion) + 1.5 * _lap_m(motion) / motion.speed_m_s
    return motion.length_m / motion.speed_m_s + 2.0 * _at_full_speed_s(motion) + 5.0


def _states(plan, times_s):
    """Return (pos, vel, acc) of shape (T, N, 3)."""
    states = [plan.at(t) for t in times_s]
    names = ("pos_ned_m", "vel_ned_m_s", "acc_ned_m_s2")
    return tuple(np.array([getattr(s, name) for s in states]) for name in names)


def test_a_formation_stands_before_its_motion_and_without_one():
    for plan, since_s in (
        (FormationPlan(PLACES_NED_M, 30.0, None), 1e3),
        (FormationPlan(PLACES_NED_M, 30.0, RacetrackMotion()), 0.0),
        (FormationPlan(PLACES_NED_M, 390.0, TrackMotion()), -5.0),
    ):
        for state in (plan.at(since_s), *(plan.own(i, since_s) for i in range(8))):
            assert not np.any(state.vel_ned_m_s)
            assert not np.any(state.acc_ned_m_s2)
        np.testing.assert_array_equal(plan.at(since_s).pos_ned_m, PLACES_NED_M)
        np.testing.assert_array_equal(plan.own(3, since_s).pos_ned_m, PLACES_NED_M[3])
        times_s = np.array([since_s, since_s])
        np.testing.assert_array_equal(plan.places(times_s), [PLACES_NED_M, PLACES_NED_M])
        assert plan.headings(times_s) == pytest.approx(np.radians([30.0, 30.0]))


def test_the_states_of_a_plan_are_read_only():
    """Compiled functions would be compiled once more, in flight, for arrays that are not."""
    plan = FormationPlan(PLACES_NED_M, 0.0, TrackMotion())
    for since_s in (0.0, 5.0, 1e3):
        state = plan.at(since_s)
        for array in (state.pos_ned_m, state.vel_ned_m_s, state.acc_ned_m_s2):
            assert not array.flags.writeable


@few
@given(motion=motions)
def test_velocity_and_acceleration_are_the_derivatives(motion):
    """Central differences over h = 1 ms to either side.

    At a step of the acceleration along the path, at most 3 m/s^2, the difference of the position has an error
    of up to 3 h / 4, and that of the velocity is invalid. Elsewhere both have errors of h^2 / 6 times the
    next derivative.
    """
    plan = FormationPlan(PLACES_NED_M, -70.0, motion)
    step_s = 1e-3
    times_s = np.linspace(2 * step_s, _duration_s(motion), 400)
    _, vel, acc = _states(plan, times_s)
    pos_after, vel_after, _ = _states(plan, times_s + step_s)
    pos_before, vel_before, _ = _states(plan, times_s - step_s)
    np.testing.assert_allclose((pos_after - pos_before) / (2 * step_s), vel, atol=1e-3)
    along_m_s2 = np.diff(np.linalg.norm(_centre_vel(vel_before, vel, vel_after), axis=-1), axis=0) / step_s
    smooth = np.abs(along_m_s2[1] - along_m_s2[0]) < 1e-3
    assert smooth.sum() > 390
    np.testing.assert_allclose(((vel_after - vel_before) / (2 * step_s))[smooth], acc[smooth], atol=1e-3)


def _centre_vel(*vel_ned_m_s):
    """Return the velocities of the centre: the mean of a rigid body."""
    return np.stack([vel.mean(axis=1) for vel in vel_ned_m_s])


@few
@given(motion=motions, since_s=floats(0.0, 300.0))
def test_all_methods_give_the_same_states(motion, since_s):
    plan = FormationPlan(PLACES_NED_M, 200.0, motion)
    whole = plan.at(since_s)
    for i in range(8):
        own = plan.own(i, since_s)
        np.testing.assert_allclose(own.pos_ned_m, whole.pos_ned_m[i], atol=1e-12)
        np.testing.assert_allclose(own.vel_ned_m_s, whole.vel_ned_m_s[i], atol=1e-12)
        np.testing.assert_allclose(own.acc_ned_m_s2, whole.acc_ned_m_s2[i], atol=1e-12)
    times_s = np.array([-1.0, since_s, 0.0])
    np.testing.assert_allclose(
        plan.places(times_s), [PLACES_NED_M, whole.pos_ned_m, PLACES_NED_M], atol=1e-12
    )
    turned_rad = plan.headings(times_s)[[0, 2]] - np.radians(-160.0)
    np.testing.assert_allclose(np.sin(turned_rad / 2.0), 0.0, atol=1e-12)
    assert np.abs(plan.headings(times_s)).max() <= np.pi


@few
@given(motion=motions)
def test_the_formation_is_rigid_and_turns_by_its_heading(motion):
    plan = FormationPlan(PLACES_NED_M, 10.0, motion)
    times_s = np.linspace(0.0, _duration_s(motion), 60)
    places_ned_m, heading_rad = plan.places(times_s), plan.headings(times_s)
    for places, heading in zip(places_ned_m, heading_rad, strict=True):
        np.testing.assert_allclose(pdist(places), pdist(PLACES_NED_M), atol=1e-9)
        np.testing.assert_array_equal(places[:, 2], PLACES_NED_M[:, 2])
        c, s = np.cos(heading - np.radians(10.0)), np.sin(heading - np.radians(10.0))
        turned_m = (PLACES_NED_M - CENTRE_NED_M)[:, :2] @ [[c, s], [-s, c]]
        np.testing.assert_allclose((places - places.mean(axis=0))[:, :2], turned_m, atol=1e-9)
    if isinstance(motion, TrackMotion) or motion.heading == "fixed":
        np.testing.assert_allclose(heading_rad, np.radians(10.0))


@few
@given(motion=racetracks())
def test_a_lap_closes_and_its_halves_are_the_same_turned_by_pi(motion):
    plan = FormationPlan(PLACES_NED_M, 0.0, motion)
    lap_s = _lap_m(motion) / motion.speed_m_s
    times_s = _at_full_speed_s(motion) + lap_s * np.linspace(0.0, 1.0, 50)
    for first, later in zip(
        _states(plan, times_s)[:3], _states(plan, times_s + 2.0 * lap_s)[:3], strict=True
    ):
        np.testing.assert_allclose(later, first, atol=1e-7)
    centre_ned_m = plan.places(times_s).mean(axis=1)
    opposite_ned_m = plan.places(times_s + 0.5 * lap_s).mean(axis=1)
    between_ned_m = 0.5 * (centre_ned_m + opposite_ned_m)
    np.testing.assert_allclose(between_ned_m, np.broadcast_to(between_ned_m[0], (50, 3)), atol=1e-7)


def test_the_path_is_the_integral_of_its_velocity():
    """The error of the table of a turn of 25 m is about 1e-9 radii, that of Simpson's rule here 1e-9 m."""
    motion = RacetrackMotion()
    plan = FormationPlan(PLACES_NED_M, 0.0, motion)
    # from the start of a turn, so that the ends of its three pieces are points of the grid
    piece_s = 0.5 * np.pi * motion.radius_m / motion.speed_m_s
    begin_s = _at_full_speed_s(motion) + (motion.length_m - 9.0) / motion.speed_m_s
    for pieces in (1, 2, 3):
        times_s = begin_s + piece_s * np.linspace(0.0, pieces, 200 * pieces + 1)
        pos, vel, *_ = _states(plan, times_s)
        np.testing.assert_allclose(pos[-1] - pos[0], simpson(vel, x=times_s, axis=0), atol=1e-7)


@few
@given(motion=racetracks())
def test_the_centre_keeps_its_speed_and_never_turns_tighter_than_the_radius(motion):
    plan = FormationPlan(PLACES_NED_M, 0.0, motion)
    times_s = _at_full_speed_s(motion) + _lap_m(motion) / motion.speed_m_s * np.linspace(0.0, 1.0, 400)
    _, vel, acc, *_ = _states(plan, times_s)
    vel, acc = vel.mean(axis=1), acc.mean(axis=1)
    np.testing.assert_allclose(np.linalg.norm(vel, axis=1), motion.speed_m_s, rtol=1e-9)
    clockwise_m_s2 = (vel[:, 0] * acc[:, 1] - vel[:, 1] * acc[:, 0]) / motion.speed_m_s
    side = 1.0 if motion.side == "right" else -1.0
    centripetal_m_s2 = motion.speed_m_s**2 / motion.radius_m
    assert (side * clockwise_m_s2).max() == pytest.approx(centripetal_m_s2, rel=1e-9)
    assert (side * clockwise_m_s2).min() >= -1e-9 * centripetal_m_s2
    # the tightest part is P of 2 E + P: a third of the turn
    straight_m, turned_m = 2.0 * motion.length_m, _lap_m(motion) - 2.0 * motion.length_m
    tightest = np.isclose(side * clockwise_m_s2, centripetal_m_s2, rtol=1e-6)
    assert tightest.mean() == pytest.approx(turned_m / 3.0 / (straight_m + turned_m), abs=0.02)


@few
@given(motion=racetracks())
def test_the_heading_of_a_formation_with_heading_track_follows_the_course(motion):
    if motion.heading == "fixed":
        return
    plan = FormationPlan(PLACES_NED_M, motion.course_deg + 25.0, motion)
    for since_s in np.linspace(0.1, _duration_s(motion), 50):
        state = plan.at(since_s)
        north, east, _ = state.vel_ned_m_s.mean(axis=0)
        ahead_rad = plan.headings(np.array([since_s])) - np.arctan2(east, north) - np.radians(25.0)
        np.testing.assert_allclose(np.sin(ahead_rad), 0.0, atol=1e-9)


def test_no_velocity_or_acceleration_jumps_beside_the_centre():
    """Where a circle joins a straight, a UAV 12.75 m off would gain 12.75 m * 3 m/s / 25 m = 1.5 m/s.

    A continuous quantity changes half as much in half the time. Only the acceleration along the path has a
    step, when the speed is reached.
    """
    motion = RacetrackMotion()
    plan = FormationPlan(PLACES_NED_M, 0.0, motion)
    begin_s, end_s = _at_full_speed_s(motion), _duration_s(motion)
    largest = []
    for instants in (4_001, 8_001):
        _, vel, acc = _states(plan, np.linspace(begin_s, end_s, instants))
        largest.append([np.abs(np.diff(each, axis=0)).max() for each in (vel, acc)])
    np.testing.assert_allclose(largest[1], np.array(largest[0]) / 2.0, rtol=0.01)
    _, vel, *_ = _states(plan, np.linspace(0.0, begin_s + 1.0, 4_001))
    assert np.linalg.norm(np.diff(vel, axis=0), axis=2).max() <= 1.01 * 0.5 * (begin_s + 1.0) / 4_000


def test_right_is_clockwise_seen_from_above():
    lap_s = _lap_m(RacetrackMotion()) / 3.0
    for side, sign in (("right", 1.0), ("left", -1.0)):
        plan = FormationPlan(PLACES_NED_M, 0.0, RacetrackMotion(course_deg=90.0, side=side))
        opposite_ned_m = plan.places(np.array([6.0 + lap_s / 2.0]))[0].mean(axis=0) - CENTRE_NED_M
        assert sign * opposite_ned_m[0] < -40.0  # flying east, right is south
        assert opposite_ned_m[1] == pytest.approx(60.0 - 9.0, abs=0.01)  # a half lap and v^2 / 2 a


@few
@given(motion=tracks)
def test_a_track_ends_at_its_length_after_the_time_of_its_trapezoid(motion):
    """Length / speed + speed / acceleration; the peak of a short track is sqrt(length * acceleration)."""
    plan = FormationPlan(PLACES_NED_M, 45.0, motion)
    peak_m_s = min(motion.speed_m_s, np.sqrt(motion.acceleration_m_s2 * motion.length_m))
    duration_s = motion.length_m / peak_m_s + peak_m_s / motion.acceleration_m_s2
    middle, end = plan.at(duration_s / 2.0), plan.at(duration_s)
    along = _compass(motion.course_deg)
    np.testing.assert_allclose(middle.vel_ned_m_s, np.tile(peak_m_s * along, (8, 1)), atol=1e-6)
    np.testing.assert_allclose(middle.pos_ned_m, PLACES_NED_M + motion.length_m / 2.0 * along, atol=1e-6)
    for state in (end, plan.at(duration_s + 100.0)):
        np.testing.assert_allclose(state.pos_ned_m, PLACES_NED_M + motion.length_m * along, atol=1e-6)
        np.testing.assert_allclose(state.vel_ned_m_s, 0.0, atol=1e-6)
    before = plan.at(duration_s - min(0.1, duration_s / 4.0))
    assert np.linalg.norm(before.vel_ned_m_s[0]) > 0.0
    np.testing.assert_allclose(before.acc_ned_m_s2[0], -motion.acceleration_m_s2 * along, atol=1e-9)


ABREAST_NED_M = np.array([[0.0, -13.0, -10.0], [0.0, 13.0, -10.0]])


@pytest.mark.parametrize(
    ("motion", "half_span_m", "says"),
    [
        # outside of a right turn: (v / R)^2 (R + d) = 3.0 m/s^2 at v = sqrt(3 * 625 / 38) = 7.02 m/s
        (RacetrackMotion(speed_m_s=7.0), 13.0, None),
        (RacetrackMotion(speed_m_s=7.1), 13.0, "UAV 0, 13.0 m off the centre, would reach 3.1 m/s^2"),
        (RacetrackMotion(speed_m_s=7.1, side="left"), 13.0, "radius_m: UAV 1, 13.0 m off"),
        # with a fixed heading each UAV flies the centre's turn: sqrt(3 * 25) = 8.66 m/s
        (RacetrackMotion(speed_m_s=8.6, heading="fixed"), 13.0, None),
        (
            RacetrackMotion(speed_m_s=8.7, heading="fixed"),
            13.0,
            "radius_m: 8.7 m/s in a turn of 25 m needs more",
        ),
        # v (1 + d / R): 19.5 and 20.1 m/s
        (RacetrackMotion(speed_m_s=9.0, radius_m=100.0), 30.0, None),
        (RacetrackMotion(speed_m_s=9.0, radius_m=100.0), 34.0, "would reach 12.1 m/s in a turn of 100 m"),
        # the inner one flies backwards, which is allowed
        (RacetrackMotion(speed_m_s=2.0, radius_m=10.0), 13.0, None),
        (RacetrackMotion(speed_m_s=1.0, radius_m=1e-300), 13.0, "radius_m: 1 m/s in a turn of 1e-300 m"),
        (RacetrackMotion(acceleration_m_s2=1e-300), 13.0, "acceleration_m_s2: 3 m/s are not reached"),
        (TrackMotion(speed_m_s=12.0, acceleration_m_s2=3.0), 13.0, None),
    ],
)
def test_a_motion_that_cannot_be_flown_is_rejected(motion, half_span_m, says):
    places_ned_m = ABREAST_NED_M * [1.0, half_span_m / 13.0, 1.0]
    if says is None:
        check(places_ned_m, motion)
        return
    with pytest.raises(ValueError) as caught:
        check(places_ned_m, motion)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
