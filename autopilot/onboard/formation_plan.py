"""Plan of a formation: all places over time, as a rigid body that stands, flies a track or a racetrack.

The centre of the formation, the mean of its places, follows a path. The path is a function of the length
flown, and the length a function of time. The formation turns about its centre with the course of the path, if
the motion requires it. Every UAV and the analysis evaluate the same plan, so a common start time is all that
they have to agree on.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np
from msgspec import Struct

from autopilot.parameters.config import AnyMotion, RacetrackMotion
from foundation.types import Array, Vector

Number = TypeVar("Number", float, Array)

ACCELERATION_MAX_M_S2 = 3.0
"""Limit for every UAV: 17 degrees of tilt, which leaves the same again for the wind."""
SPEED_MAX_M_S = 12.0
"""Limit for every UAV: MPC_XY_VEL_MAX."""
EASE_RADII = math.pi / 2
"""Length over which a turn's curvature rises, and over which it falls, in radii of its tightest part. The
tangential acceleration of a UAV beside the centre is then at most the centripetal acceleration of its
rotation about the centre in the tightest part."""
SPEED_UP_MAX_S = 3600.0
TURN_INTERVALS = 256
"""Intervals in the table of a half turn; the error of cubic interpolation is about 1e-9 radii."""
_CHECKED_INSTANTS = 200
_STILL: Vector = (0.0, 0.0, 0.0)


class PlanState(Struct, frozen=True, eq=False):
    """The plan of N places at an instant. Arrays (N, 3) must not be written to."""

    pos_ned_m: Array
    """Positions, site NED."""
    vel_ned_m_s: Array
    acc_ned_m_s2: Array


class PlaceState(Struct, frozen=True):
    """The plan of one place at an instant; fields as in `PlanState`."""

    pos_ned_m: Vector
    vel_ned_m_s: Vector
    acc_ned_m_s2: Vector


class _Centre(NamedTuple):
    """Motion of the formation's centre, and turn of the formation since its start."""

    north_m: float
    east_m: float
    vel_north_m_s: float
    vel_east_m_s: float
    acc_north_m_s2: float
    acc_east_m_s2: float
    turn_rad: float
    turn_rad_s: float
    turn_rad_s2: float


class _PathPoint(NamedTuple):
    """A point of a path, in the frame of its first course."""

    along_m: float
    right_m: float
    course_rad: float
    """Clockwise from the first course."""
    curvature_1_m: float
    """Derivative of the course by the length of the path, clockwise."""
    curvature_rate_1_m2: float


class FormationPlan:
    """The plan of one formation; times are relative to the start of its motion.

    Before it, or without a motion, the formation stands at its places (N, 3), site NED, with its heading
    clockwise from north.
    """

    def __init__(self, places_ned_m: Array, heading_deg: float, motion: AnyMotion | None) -> None:
        places_ned_m = np.array(places_ned_m, float).reshape(-1, 3)
        centre_ned_m = places_ned_m.mean(axis=0)
        self._motion = motion
        self.moves = motion is not None
        self._heading_rad = math.radians(heading_deg)
        self._north_m, self._east_m = float(centre_ned_m[0]), float(centre_ned_m[1])
        self._offset_north_m, self._offset_east_m = (places_ned_m - centre_ned_m)[:, :2].T.copy()
        self._down_m = places_ned_m[:, 2].copy()
        self._offsets = list(
            zip(*(a.tolist() for a in (self._offset_north_m, self._offset_east_m, self._down_m)), strict=True)
        )
        still = np.zeros_like(places_ned_m)
        for array in (places_ned_m, still):
            array.setflags(write=False)
        self._standing = PlanState(places_ned_m, still, still)
        self._own_standing = [
            PlaceState((north_m, east_m, down_m), _STILL, _STILL)
            for north_m, east_m, down_m in places_ned_m.tolist()
        ]
        if motion is None:
            return
        self._path = _Racetrack(motion) if isinstance(motion, RacetrackMotion) else _Straight()
        length_m = math.inf if isinstance(motion, RacetrackMotion) else motion.length_m
        self._progress = _Progress(motion.speed_m_s, motion.acceleration_m_s2, length_m)
        course_rad = math.radians(motion.course_deg)
        self._course_cos, self._course_sin = math.cos(course_rad), math.sin(course_rad)
        self._course_rad = course_rad
        self._turns = isinstance(motion, RacetrackMotion) and motion.heading == "track"

    def at(self, since_start_s: float) -> PlanState:
        """Return the state of all N places."""
        if self._motion is None or since_start_s <= 0.0:
            return self._standing
        centre = self._centre(since_start_s)
        pos_ned_m = np.empty_like(self._standing.pos_ned_m)
        vel_ned_m_s, acc_ned_m_s2 = np.zeros_like(pos_ned_m), np.zeros_like(pos_ned_m)
        (
            pos_ned_m[:, 0], pos_ned_m[:, 1],
            vel_ned_m_s[:, 0], vel_ned_m_s[:, 1],
            acc_ned_m_s2[:, 0], acc_ned_m_s2[:, 1],
        ) = _carried(centre, self._offset_north_m, self._offset_east_m)  # fmt: skip
        pos_ned_m[:, 2] = self._down_m
        for array in (pos_ned_m, vel_ned_m_s, acc_ned_m_s2):
            array.setflags(write=False)  # as when it stands: compiled functions have one type of argument
        return PlanState(pos_ned_m, vel_ned_m_s, acc_ned_m_s2)

    def own(self, station: int, since_start_s: float) -> PlaceState:
        """Return the state of one place, equal to that of `at` in a fraction of its time."""
        if self._motion is None or since_start_s <= 0.0:
            return self._own_standing[station]
        centre = self._centre(since_start_s)
        offset_north_m, offset_east_m, down_m = self._offsets[station]
        north_m, east_m, vel_n, vel_e, acc_n, acc_e = _carried(centre, offset_north_m, offset_east_m)
        return PlaceState((north_m, east_m, down_m), (vel_n, vel_e, 0.0), (acc_n, acc_e, 0.0))

    def places(self, since_start_s: Array) -> Array:
        """Return (T, N, 3) places at T times, site NED; read-only if the formation stands."""
        shape = (len(since_start_s), *self._standing.pos_ned_m.shape)
        if self._motion is None or not np.any(since_start_s > 0.0):
            return np.broadcast_to(self._standing.pos_ned_m, shape)
        centres = self._centres(since_start_s)
        c, s = np.cos(centres[:, 6:7]), np.sin(centres[:, 6:7])
        places_ned_m = np.empty(shape)
        places_ned_m[..., 0] = centres[:, 0:1] + c * self._offset_north_m - s * self._offset_east_m
        places_ned_m[..., 1] = centres[:, 1:2] + s * self._offset_north_m + c * self._offset_east_m
        places_ned_m[..., 2] = self._down_m
        return places_ned_m

    def headings(self, since_start_s: Array) -> Array:
        """Return (T,) headings at T times, clockwise from north, -pi to pi."""
        if not (self._motion is not None and self._turns and np.any(since_start_s > 0.0)):
            return np.full(len(since_start_s), math.remainder(self._heading_rad, math.tau))
        turned_rad = self._heading_rad + self._centres(since_start_s)[:, 6]
        return np.arctan2(np.sin(turned_rad), np.cos(turned_rad))

    def _centres(self, since_start_s: Array) -> Array:
        """Return (T, 9) rows of `_Centre`: a loop over the formulas that the UAVs use, about 5 us each."""
        return np.array([self._centre(max(0.0, t)) for t in since_start_s.tolist()])

    def _centre(self, since_start_s: float) -> _Centre:
        return self._moving(*self._progress.at(since_start_s))

    def _moving(self, length_m: float, speed_m_s: float, acceleration_m_s2: float) -> _Centre:
        """Return the motion at a point of the path, by the chain rule with d/dt = speed d/dlength."""
        along_m, right_m, course_rad, curvature_1_m, curvature_rate_1_m2 = self._path.at(length_m)
        c, s = self._course_cos, self._course_sin
        north, east = math.cos(self._course_rad + course_rad), math.sin(self._course_rad + course_rad)
        turn_rad_s = curvature_1_m * speed_m_s
        centripetal_m_s2 = turn_rad_s * speed_m_s
        turn_rad_s2 = curvature_rate_1_m2 * speed_m_s**2 + curvature_1_m * acceleration_m_s2
        return _Centre(
            self._north_m + c * along_m - s * right_m, self._east_m + s * along_m + c * right_m,
            speed_m_s * north, speed_m_s * east,
            acceleration_m_s2 * north - centripetal_m_s2 * east,
            acceleration_m_s2 * east + centripetal_m_s2 * north,
            *((course_rad, turn_rad_s, turn_rad_s2) if self._turns else (0.0, 0.0, 0.0)),
        )  # fmt: skip

    def check(self) -> None:
        """Raise ValueError, one line, if the motion exceeds the limits of a UAV in a turn."""
        motion = self._motion
        if not isinstance(motion, RacetrackMotion):
            return
        # From rest to full speed, and through a turn at full speed; the other parts are equivalent.
        instants = [self._centre(t) for t in np.linspace(0.0, self._progress.rise_s, _CHECKED_INSTANTS)]
        instants += [
            self._moving(length_m, motion.speed_m_s, 0.0)
            for length_m in np.linspace(motion.length_m, _half_lap_m(motion), _CHECKED_INSTANTS)
        ]
        parts = np.array([_carried(i, self._offset_north_m, self._offset_east_m) for i in instants])
        for what, components, limit in (
            ("m/s", parts[:, 2:4], SPEED_MAX_M_S),
            ("m/s^2", parts[:, 4:6], ACCELERATION_MAX_M_S2),
        ):
            size = np.linalg.norm(components, axis=1).max(axis=0)
            worst = int(size.argmax())
            if not size[worst] <= limit:
                offset_m = math.hypot(*self._offsets[worst][:2])
                raise ValueError(
                    f"radius_m: UAV {worst}, {offset_m:.1f} m off the centre, would reach "
                    f"{size[worst]:.1f} {what} in a turn of {motion.radius_m:g} m at {motion.speed_m_s:g} "
                    f"m/s; {limit:g} {what} is the limit"
                )


def check(places_ned_m: Array, motion: AnyMotion) -> None:
    """Raise ValueError, one line, if the formation with places (N, 3) cannot fly the motion."""
    if motion.speed_m_s > SPEED_UP_MAX_S * motion.acceleration_m_s2:
        raise ValueError(
            f"acceleration_m_s2: {motion.speed_m_s:g} m/s are not reached within {SPEED_UP_MAX_S:g} s"
        )
    if isinstance(motion, RacetrackMotion) and motion.speed_m_s**2 > ACCELERATION_MAX_M_S2 * motion.radius_m:
        raise ValueError(
            f"radius_m: {motion.speed_m_s:g} m/s in a turn of {motion.radius_m:g} m needs more than "
            f"{ACCELERATION_MAX_M_S2:g} m/s^2"
        )
    FormationPlan(places_ned_m, 0.0, motion).check()


def _carried(
    centre: _Centre, offset_north_m: Number, offset_east_m: Number
) -> tuple[Number, Number, Number, Number, Number, Number]:
    """Return positions, velocities and accelerations, each north and east, of points of the formation."""
    c, s = math.cos(centre.turn_rad), math.sin(centre.turn_rad)
    rate, rate_2, squared = centre.turn_rad_s, centre.turn_rad_s2, centre.turn_rad_s**2
    north_m = c * offset_north_m - s * offset_east_m
    east_m = s * offset_north_m + c * offset_east_m
    return (
        centre.north_m + north_m,
        centre.east_m + east_m,
        centre.vel_north_m_s - rate * east_m,
        centre.vel_east_m_s + rate * north_m,
        centre.acc_north_m_s2 - rate_2 * east_m - squared * north_m,
        centre.acc_east_m_s2 + rate_2 * north_m - squared * east_m,
    )


class _Progress:
    """Length of the path over time: constant acceleration from rest, constant speed, braking to rest."""

    def __init__(self, speed_m_s: float, acceleration_m_s2: float, length_m: float) -> None:
        self._acceleration_m_s2 = acceleration_m_s2
        self._length_m = length_m
        self._speed_m_s = min(speed_m_s, math.sqrt(acceleration_m_s2 * length_m))
        self.rise_s = self._speed_m_s / acceleration_m_s2
        self._rise_m = 0.5 * self._speed_m_s * self.rise_s
        self._brake_s = self.rise_s + max(0.0, (length_m - 2.0 * self._rise_m) / self._speed_m_s)

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return (length, speed, acceleration) in m, m/s, m/s^2 at a time >= 0."""
        rate_m_s2 = self._acceleration_m_s2
        if time_s < self.rise_s:
            return 0.5 * rate_m_s2 * time_s**2, rate_m_s2 * time_s, rate_m_s2
        if time_s <= self._brake_s:
            return self._rise_m + self._speed_m_s * (time_s - self.rise_s), self._speed_m_s, 0.0
        left_s = self._brake_s + self.rise_s - time_s
        if left_s > 0.0:
            return self._length_m - 0.5 * rate_m_s2 * left_s**2, rate_m_s2 * left_s, -rate_m_s2
        return self._length_m, 0.0, 0.0


class _Straight:
    """The path of a track."""

    def at(self, length_m: float) -> _PathPoint:
        return _PathPoint(length_m, 0.0, 0.0, 0.0, 0.0)


def _half_lap_m(motion: RacetrackMotion) -> float:
    """Return the length of a straight and a half turn; its course turns by (ease + plateau) / radius = pi."""
    return motion.length_m + (math.pi + EASE_RADII) * motion.radius_m


class _Racetrack:
    """The path of a racetrack.

    In a turn the curvature rises as a raised cosine, stays at 1 / radius, and falls symmetrically, so that
    velocity and acceleration of UAVs beside the centre have no steps. The course is the curvature's integral.
    The position has no closed form: it is tabulated for a half turn, and interpolated by cubics with the
    exact course at the points of the table. The second half of a lap is the first one turned by pi.
    """

    def __init__(self, motion: RacetrackMotion) -> None:
        self._side = 1.0 if motion.side == "right" else -1.0
        self._straight_m = motion.length_m
        self._curvature_1_m = 1.0 / motion.radius_m
        self._ease_m = EASE_RADII * motion.radius_m
        self._turn_m = (math.pi + EASE_RADII) * motion.radius_m
        self._half_m = _half_lap_m(motion)
        self._interval_m = self._turn_m / TURN_INTERVALS
        self._nodes = self._tabulated()
        self._half_along_m, self._half_right_m = self._nodes[-1][0] + self._straight_m, self._nodes[-1][1]

    def _tabulated(self) -> list[tuple[float, float, float, float]]:
        """Return (along, right, their derivatives by length) at the interval ends, from the turn's start."""
        points, weights = np.polynomial.legendre.leggauss(4)
        starts_m = self._interval_m * np.arange(TURN_INTERVALS)
        inside_m = starts_m[:, None] + 0.5 * self._interval_m * (points + 1.0)
        course_rad = np.array([[self._turn(at_m)[0] for at_m in row] for row in inside_m.tolist()])
        steps_m = 0.5 * self._interval_m * np.stack([np.cos(course_rad), np.sin(course_rad)], -1)
        pos_m = np.zeros((TURN_INTERVALS + 1, 2))
        np.cumsum(np.einsum("ikj,k->ij", steps_m, weights), axis=0, out=pos_m[1:])
        ends_rad = [self._turn(self._interval_m * i)[0] for i in range(TURN_INTERVALS + 1)]
        return [
            (along_m, right_m, math.cos(end_rad), math.sin(end_rad))
            for (along_m, right_m), end_rad in zip(pos_m.tolist(), ends_rad, strict=True)
        ]

    def at(self, length_m: float) -> _PathPoint:
        """Return the point at a length >= 0 of the path."""
        halves, begun_m = divmod(length_m, self._half_m)
        if begun_m <= self._straight_m:
            along_m, right_m, turned = begun_m, 0.0, (0.0, 0.0, 0.0)
        else:
            turned = self._turn(begun_m - self._straight_m)
            along_m, right_m = self._position(begun_m - self._straight_m)
            along_m += self._straight_m
        if halves % 2.0:
            along_m, right_m = self._half_along_m - along_m, self._half_right_m - right_m
        side = self._side
        course_rad, curvature_1_m, curvature_rate_1_m2 = turned
        turned_rad = side * (math.pi * halves + course_rad)
        return _PathPoint(
            along_m, side * right_m, turned_rad, side * curvature_1_m, side * curvature_rate_1_m2
        )

    def _turn(self, at_m: float) -> tuple[float, float, float]:
        """Return (course, curvature, its derivative) in rad, 1/m, 1/m^2 at a length of the half turn."""
        before_m = min(at_m, self._turn_m - at_m)
        if before_m >= self._ease_m:
            return self._curvature_1_m * (at_m - 0.5 * self._ease_m), self._curvature_1_m, 0.0
        phase_rad = math.pi * before_m / self._ease_m
        sine = math.sin(phase_rad)
        course_rad = 0.5 * self._curvature_1_m * (before_m - self._ease_m / math.pi * sine)
        curvature_1_m = 0.5 * self._curvature_1_m * (1.0 - math.cos(phase_rad))
        rate_1_m2 = 0.5 * math.pi * self._curvature_1_m / self._ease_m * sine
        if before_m < at_m:
            return math.pi - course_rad, curvature_1_m, -rate_1_m2
        return course_rad, curvature_1_m, rate_1_m2

    def _position(self, at_m: float) -> tuple[float, float]:
        """Return (along, right) in m at a length of the half turn, by cubic Hermite interpolation."""
        index = min(int(at_m / self._interval_m), TURN_INTERVALS - 1)
        u = at_m / self._interval_m - index
        v = 1.0 - u
        from_along_m, from_right_m, from_cos, from_sin = self._nodes[index]
        to_along_m, to_right_m, to_cos, to_sin = self._nodes[index + 1]
        start, end = v * v * (1.0 + 2.0 * u), u * u * (1.0 + 2.0 * v)
        leave_m, arrive_m = u * v * v * self._interval_m, u * u * v * self._interval_m
        return (
            start * from_along_m + end * to_along_m + leave_m * from_cos - arrive_m * to_cos,
            start * from_right_m + end * to_right_m + leave_m * from_sin - arrive_m * to_sin,
        )
