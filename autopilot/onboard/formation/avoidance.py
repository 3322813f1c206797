"""Collision avoidance, from the estimated positions of all UAVs and their uncertainty.

A control barrier after Wang, Ames and Egerstedt, "Safety barrier certificates for collisions-free multirobot
systems" (IEEE T-RO 2017), on the velocity setpoint of the autopilot's position loop. With distance d, reach r
and the unit vector n from the neighbour, the gap h = d - r may close at a rate of at most a h (a is
`CLOSING_1_S`). Each of the two UAVs may contribute half of it, measured relative to the formation's motion.
If the neighbour approaches faster than its half, because it has less information or is under other control,
the own UAV compensates the rest. The desired velocity is changed as little as these half-planes require (a
quadratic programme in the plane); it is not changed at all while all UAVs keep to their halves.

The velocity loop has a lag, so the gap is predicted by L = `LEAD_S` with the present closing speed. With lag
tau the gap then obeys tau h'' + (1 + a L) h' + a h = 0, which does not oscillate for L = tau. Avoidance is
horizontal only: a pair one above the other separates sideways.
"""

import math
from collections.abc import Sequence
from struct import Struct

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.uncertainty import Others
from foundation.types import Array

CLOSING_1_S = 1.0
"""Above MPC_XY_P (0.95), so that a UAV that returns to its place is not slowed."""
LEAD_S = 0.6
"""Lag of the velocity loop (1 / MPC_XY_VEL_P_ACC) and the attitude loop."""
SIGMAS = 2.0
"""Standard deviations of the relative position that are added to the radius."""
HEIGHT_STD_M = 0.3
"""Standard deviation of the difference of two barometric heights."""
SPACING_SHARE = 0.6
"""Largest reach of two UAVs as a share of the distance of their places: with errors of up to a fifth of it
they do not push each other."""
AWAY_SHARE = 0.5
"""The limit grows by this share of the own UAV's distance from its place."""
GIVE_MAX_M_S = 4.0
"""Largest velocity change due to one neighbour. It must exceed all joining speeds, otherwise UAVs in a queue
would push those ahead of them together."""
FRESH_US = 1_000_000
"""A neighbour with a beacon within this time is extrapolated by its velocity."""
KEEP_US = 20_000_000
"""Time for which a silent neighbour is assumed to follow the plan, at its last offset from it. A UAV that has
lost its channel detects it within the ranging policy's silence time (7 s for sixteen UAVs) and then coasts
for `formation_control.COAST_S`."""
GROWTH_M_S = 0.2
"""Growth of the standard deviation of a silent neighbour, by wind and odometry drift."""
ROOM_SHARE = 0.5
"""Share of a neighbour's receding speed that the own UAV may follow at once, so that a queue advances. With
the whole speed a follower would run into a neighbour that stops."""
PASSES = 200
"""Largest number of `_nearest`, which nearly parallel lines take up to 150 of; most cases take below 10."""
_REQUEST = Struct("5d")
"""Packs an array's elements into its memory, in a fifth of the time of assigning its slices."""
NEAR_M = 1e-3
KEPT = np.dtype(
    [
        ("station", "i8"),
        ("limit_m", "f8"),  # largest reach, in place
        ("seen_us", "i8"),  # when it was last fresh, and at that time:
        ("beside_m", "f8", 3),  # offset from its place
        ("std_m", "f8"),
    ]
)
"""Record of a member."""
Kept = NDArray[np.void]
"""(N,) array of `KEPT`."""


@njit(cache=True)
def _nearest(normals: Array, bounds: Array, desired_ne: Array, out_ne: Array) -> None:
    """Fill out_ne (2,) with the velocity nearest to ``desired_ne`` that satisfies normals . v >= bounds (n,).

    Hildreth's dual ascent. Multipliers are limited to `GIVE_MAX_M_S`, which lets contradicting rows be
    violated.
    """
    multipliers = np.zeros(bounds.size)
    out_ne[0], out_ne[1] = desired_ne[0], desired_ne[1]
    for _ in range(PASSES):
        largest = 0.0
        for k in range(bounds.size):
            missing = bounds[k] - normals[k, 0] * out_ne[0] - normals[k, 1] * out_ne[1]
            step = min(max(multipliers[k] + missing, 0.0), GIVE_MAX_M_S) - multipliers[k]
            multipliers[k] += step
            out_ne[0] += step * normals[k, 0]
            out_ne[1] += step * normals[k, 1]
            largest = max(largest, abs(step))
        if largest < 1e-4:
            return


@njit(cache=True)
def keep_clear(
    own: int, pos_ned_m: Array, vel_ned_m_s: Array, counts: NDArray[np.bool_], std_m: Array, limits_m: Array,
    in_place_m: float, radius_m: float, place_ned_m: Array, frame_ned_m_s: Array, desired_ne_m_s: Array,
    goal_ned_m: Array, change_ne_m_s: Array,
) -> None:  # fmt: skip
    """Fill change_ne_m_s (2,) with the change of the desired velocity (2,) on the way to the goal (3,).

    Row ``own`` of the estimated positions and velocities (N, 3) is the own UAV, which is in place within the
    horizontal distance in_place_m of its place (3,); frame_ned_m_s (3,) is the velocity of the place.
    ``counts`` (N,) states which UAVs to avoid, std_m (N,) one sigma of their horizontal position relative to
    the own UAV along the line, limits_m (N,) the largest reach in place; radius_m is the reach without
    uncertainty.
    """
    n = pos_ned_m.shape[0]
    normals, bounds = np.empty((n, 2)), np.empty(n)
    count, worst, worst_by, worst_reach_m = 0, -1, 0.0, 0.0
    change_ne_m_s[:] = 0.0
    away_m = np.hypot(pos_ned_m[own, 0] - place_ned_m[0], pos_ned_m[own, 1] - place_ned_m[1])
    wider_m = AWAY_SHARE * max(away_m - in_place_m, 0.0)
    for j in range(n):
        if j == own or not counts[j]:
            continue
        north, east = pos_ned_m[own, 0] - pos_ned_m[j, 0], pos_ned_m[own, 1] - pos_ned_m[j, 1]
        down = pos_ned_m[own, 2] - pos_ned_m[j, 2]
        level_m = np.hypot(north, east)
        apart_m = max(np.hypot(level_m, down), NEAR_M)
        closing_m_s = 0.0
        for a, way_m in enumerate((north, east, down)):
            closing_m_s -= (vel_ned_m_s[own, a] - vel_ned_m_s[j, a]) * way_m / apart_m
        std = np.hypot(std_m[j] * level_m, HEIGHT_STD_M * down) / apart_m
        reach_m = min(radius_m + SIGMAS * std, limits_m[j] + wider_m)
        gap_m = apart_m - LEAD_S * max(closing_m_s, 0.0) - reach_m
        if level_m < NEAR_M:
            # One above the other: any direction is suitable if the two choose opposite ones.
            north, east, level_m = (1.0, 0.0, 1.0) if own < j else (-1.0, 0.0, 1.0)
        north, east = north / level_m, east / level_m
        whole = north * frame_ned_m_s[0] + east * frame_ned_m_s[1]
        its = north * vel_ned_m_s[j, 0] + east * vel_ned_m_s[j, 1]
        half = whole + min(its - whole, 0.0) * ROOM_SHARE - 0.5 * CLOSING_1_S * gap_m
        rest = its - CLOSING_1_S * max(gap_m, 0.5 * gap_m)
        normals[count, 0], normals[count, 1] = north, east
        bounds[count] = max(half, rest)
        if not bounds[count] < math.inf:  # an input is NaN
            continue
        missing = bounds[count] - north * desired_ne_m_s[0] - east * desired_ne_m_s[1]
        if missing > worst_by:
            worst, worst_by, worst_reach_m = j, missing, reach_m
        count += 1
    if worst < 0:
        return
    found_ne = np.empty(2)
    _nearest(normals[:count], bounds[:count], desired_ne_m_s, found_ne)
    ahead_n, ahead_e = desired_ne_m_s[0] - frame_ned_m_s[0], desired_ne_m_s[1] - frame_ned_m_s[1]
    speed_m_s = np.hypot(ahead_n, ahead_e)
    if speed_m_s > 1e-6:
        # A UAV blocked ahead moves to the right; as all do so, no pair blocks each other for long. Not if the
        # neighbour is at the goal itself, which the UAV would then circle for ever.
        ahead_n, ahead_e = ahead_n / speed_m_s, ahead_e / speed_m_s
        blocked = (desired_ne_m_s[0] - found_ne[0]) * ahead_n + (desired_ne_m_s[1] - found_ne[1]) * ahead_e
        beside_m = np.hypot(goal_ned_m[0] - pos_ned_m[worst, 0], goal_ned_m[1] - pos_ned_m[worst, 1])
        aside = min(max(beside_m / worst_reach_m - 1.0, 0.0), 1.0) * min(max(blocked, 0.0), speed_m_s)
        if aside > 0.0:
            turned_ne = np.empty(2)
            turned_ne[0] = desired_ne_m_s[0] - aside * (ahead_n + ahead_e)
            turned_ne[1] = desired_ne_m_s[1] - aside * (ahead_e - ahead_n)
            _nearest(normals[:count], bounds[:count], turned_ne, found_ne)
    change_ne_m_s[0] = found_ne[0] - desired_ne_m_s[0]
    change_ne_m_s[1] = found_ne[1] - desired_ne_m_s[1]


@njit(cache=True)
def remember(
    now_us: int, j: int, fresh: bool,  # noqa: FBT001  # numba has no keyword-only arguments
    pos_ned_m: Array, vel_ned_m_s: Array, std_m: Array, plan_pos_ned_m: Array, plan_vel_ned_m_s: Array,
    kept: Kept,
) -> bool:  # fmt: skip
    """Store the estimate of member j if it is fresh; otherwise fill its rows by the stored one and the plan.

    Returns whether it is fresh or was fresh within `KEEP_US`.
    """
    memory = kept[j]
    beside_m = memory["beside_m"]
    if fresh:
        memory["seen_us"], memory["std_m"] = now_us, std_m[j]
        for a in range(3):
            beside_m[a] = pos_ned_m[j, a] - plan_pos_ned_m[j, a]
        return True
    silent_us = now_us - memory["seen_us"]
    if silent_us >= KEEP_US:
        return False
    for a in range(3):
        pos_ned_m[j, a] = plan_pos_ned_m[j, a] + beside_m[a]
        vel_ned_m_s[j, a] = plan_vel_ned_m_s[j, a]
    std_m[j] = memory["std_m"] + GROWTH_M_S * 1e-6 * silent_us
    return True


@njit(cache=True)
def velocity_change(
    own: int, now_us: int, others: Others, plan_pos_ned_m: Array, plan_vel_ned_m_s: Array, kept: Kept,
    in_place_m: float, radius_m: float, request: Array,
) -> tuple[float, float]:  # fmt: skip
    """Return the change by `keep_clear` of the desired velocity, north and east, after `remember`.

    plan_pos_ned_m and plan_vel_ned_m_s have a row for every UAV of the formation, ``others`` (N,) of `SEEN`
    and ``kept`` (N,) of `KEPT` one for every member. Only ``kept`` is changed. ``request`` (5,) contains
    goal_ned_m (3,) and desired_ne_m_s (2,).
    """
    n = kept.size
    pos, vel, std = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    plan_pos, plan_vel, limits_m = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    counts = np.empty(n, np.bool_)
    for j in range(n):
        other, station = others[j], kept[j]["station"]
        for a in range(3):
            pos[j, a], vel[j, a] = other["pos_ned_m"][a], other["vel_ned_m_s"][a]
            plan_pos[j, a], plan_vel[j, a] = plan_pos_ned_m[station, a], plan_vel_ned_m_s[station, a]
        std[j], limits_m[j] = other["std_m"], kept[j]["limit_m"]
        # The own UAV always counts as fresh.
        counts[j] = remember(now_us, j, other["fresh"] or j == own, pos, vel, std, plan_pos, plan_vel, kept)
    change_ne_m_s = np.empty(2)
    keep_clear(
        own, pos, vel, counts, std, limits_m, in_place_m, radius_m, plan_pos[own], plan_vel[own],
        request[3:5], request[:3], change_ne_m_s,
    )  # fmt: skip
    return change_ne_m_s[0], change_ne_m_s[1]


class Avoidance:
    """Collision avoidance of one UAV.

    Args:
        own: row of this UAV among the members.
        places_ned_m: (F, 3) the formation's places.
        radius_m: distance to keep, before adding uncertainty; the spacing of the places limits the sum.
        members: (N,) the UAVs to avoid, and the own one; None: all.

    """

    def __init__(
        self, *, own: int, places_ned_m: Array, radius_m: float, members: NDArray[np.int64] | None = None
    ) -> None:
        if members is None:
            members = np.arange(len(places_ned_m))
        places_ned_m = places_ned_m[members]
        count = len(places_ned_m)
        self._own = own
        self._radius_m = radius_m
        limits_m = SPACING_SHARE * np.sqrt(((places_ned_m - places_ned_m[own]) ** 2).sum(axis=1))
        others_m = np.delete(limits_m, own)
        nearest_m = float(others_m.min()) / SPACING_SHARE if count > 1 else 0.0
        self._in_place_m = 0.5 * (1.0 - SPACING_SHARE) * nearest_m
        self._kept: Kept = np.zeros(count, KEPT)
        self._kept["station"], self._kept["seen_us"], self._kept["limit_m"] = members, -KEEP_US, limits_m
        self._request = np.zeros(_REQUEST.size // 8)
        self._request_bytes = self._request.data.cast("B")

    def velocity_change_ne_m_s(
        self, now_us: int, *, others: Others, plan_pos_ned_m: Array, plan_vel_ned_m_s: Array,
        goal_ned_m: Sequence[float], desired_ne_m_s: Sequence[float],
    ) -> tuple[float, float]:  # fmt: skip
        """Return the velocity to add to the setpoint's, NED north and east; exactly 0 if no UAV is near.

        Args:
            now_us: time of all other arguments.
            others: (N,) of `SEEN`, a row for every member including the own one. A UAV that is not fresh is
                avoided for `KEEP_US` longer, as if it followed the plan.
            plan_pos_ned_m: (F, 3) places of the whole formation, with velocities ``plan_vel_ned_m_s``.
            goal_ned_m: (3,) final target of the own UAV: its place.
            desired_ne_m_s: (2,) horizontal velocity setpoint of the autopilot's position loop: its gain times
                the distance to the reference, plus the reference's velocity.

        """
        _REQUEST.pack_into(self._request_bytes, 0, *goal_ned_m, *desired_ne_m_s)
        change_ne_m_s: tuple[float, float] = velocity_change(
            self._own, now_us, others, plan_pos_ned_m, plan_vel_ned_m_s, self._kept,
            self._in_place_m, self._radius_m, self._request,
        )  # fmt: skip
        return change_ne_m_s
