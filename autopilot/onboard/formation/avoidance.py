"""Keeping clear of each other, by what is estimated of everybody's position and how well.

A control barrier in the manner of Wang, Ames and Egerstedt, "Safety barrier certificates for collisions-free
multirobot systems" (IEEE T-RO 2017), on the velocity that the autopilot's position loop will be asked for:
with distance d, reach r and the unit vector n from the neighbour, the gap h = d - r may close at a h at most
(a is `CLOSING_1_S`), of which each of the two takes half, both measured against the formation's own motion.
Where the neighbour comes nearer than its half allows, because it knows less or obeys somebody else, the own
side takes the rest. The velocity wanted is changed by as little as these half-planes need (a quadratic
programme in the plane), so nothing at all changes while everybody keeps its part.

The loop follows a velocity with a lag, so the gap is taken L = `LEAD_S` ahead by the present closing speed.
With lag tau the gap then obeys tau h'' + (1 + a L) h' + a h = 0, which for L = tau never swings.

Nothing here acts vertically: a pair one above the other parts sideways, unless it is high enough apart.
"""

import math
from collections.abc import Sequence
from struct import Struct

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.uncertainty import Others

Array = NDArray[np.float64]

CLOSING_1_S = 1.0
"""Above MPC_XY_P (0.95), so that who returns to its place from a fifth of the spacing is not held back."""
LEAD_S = 0.6
"""Lag of the velocity loop (1 / MPC_XY_VEL_P_ACC), and the attitude's."""
SIGMAS = 2.0
"""Standard deviations of the relative position that are added to the radius."""
HEIGHT_STD_M = 0.3
"""Of a difference of two barometric heights."""
SPACING_SHARE = 0.6
"""Largest part of two places' distance that their UAVs' reach may be: at their places, and with errors of a
fifth of the spacing, UAVs do not push each other."""
AWAY_SHARE = 0.5
"""That limit grows by this part of the way that the own UAV still has to its place."""
GIVE_MAX_M_S = 4.0
"""Largest change of velocity on behalf of one neighbour: above all speeds of joining, or the UAVs behind
would press those before them together."""
FRESH_US = 1_000_000
"""A neighbour heard within this is where its velocity has brought it since."""
KEEP_US = 20_000_000
"""One that is heard no more is taken to follow the plan, where it was beside it, for so long. Who has
lost its channel notices within the ranging policy's silence (7 s at sixteen UAVs) and coasts for
`formation.COAST_S`."""
GROWTH_M_S = 0.2
"""Growth of the standard deviation of such a one: by wind, and by odometry's drift."""
ROOM_SHARE = 0.5
"""Part of a neighbour's speed away from the own UAV that is followed at once: a queue moves on, and a circle
turns, as one. At the whole, who follows would run into one that stops."""
PASSES = 30
_ASKED = Struct("5d")
"""Of an array: written into its memory, for a fifth of the time that assigning its parts takes."""
NEAR_M = 1e-3
KEPT = np.dtype(
    [
        ("station", "i8"),
        ("limit_m", "f8"),  # largest reach, in place
        ("seen_us", "i8"),  # when it was last fresh, and then:
        ("beside_m", "f8", 3),  # way from its place
        ("std_m", "f8"),
    ]
)
"""What is kept of a member."""
Kept = NDArray[np.void]
"""(N,) of `KEPT`"""


@njit(cache=True)
def _nearest(normals: Array, bounds: Array, count: int, wanted_ne: Array, out_ne: Array) -> None:
    """Find the velocity nearest to ``wanted_ne`` with normals . v >= bounds; fills out_ne (2,).

    Hildreth's dual ascent over the first ``count`` rows. No row's multiplier exceeds `GIVE_MAX_M_S`: where
    the rows contradict each other, they are broken by as little as that allows.
    """
    multipliers = np.zeros(count)
    out_ne[:] = wanted_ne
    for _ in range(PASSES):
        largest = 0.0
        for k in range(count):
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
    in_place_m: float, radius_m: float, place_ned_m: Array, frame_ned_m_s: Array, wanted_ne_m_s: Array,
    goal_ned_m: Array, change_ne_m_s: Array,
) -> None:  # fmt: skip
    """Find what to add to the horizontal velocity wanted; fills change_ne_m_s (2,).

    Args:
        own: row of the own UAV in the arrays that follow.
        pos_ned_m: (N, 3) estimated, at present.
        vel_ned_m_s: (N, 3)
        counts: (N,) whom to keep clear of.
        std_m: (N,) one sigma of the position relative to the own, horizontally, along the line.
        limits_m: (N,) largest reach, in place.
        in_place_m: horizontal distance of the own position from the own place that counts as in place.
        radius_m: reach without uncertainty.
        place_ned_m: (3,) the own place.
        frame_ned_m_s: (3,) and its velocity.
        wanted_ne_m_s: (2,) velocity that the position loop would ask for.
        goal_ned_m: (3,) where it leads to in the end.
        change_ne_m_s: (2,) the result.

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
            # One above the other: which way does not matter, as long as the two choose opposite ones.
            north, east, level_m = (1.0, 0.0, 1.0) if own < j else (-1.0, 0.0, 1.0)
        north, east = north / level_m, east / level_m
        whole = north * frame_ned_m_s[0] + east * frame_ned_m_s[1]
        its = north * vel_ned_m_s[j, 0] + east * vel_ned_m_s[j, 1]
        half = whole + min(its - whole, 0.0) * ROOM_SHARE - 0.5 * CLOSING_1_S * gap_m
        rest = its - CLOSING_1_S * max(gap_m, 0.5 * gap_m)
        normals[count, 0], normals[count, 1] = north, east
        bounds[count] = max(half, rest)
        if not bounds[count] < math.inf:  # somewhere that is no number
            continue
        missing = bounds[count] - north * wanted_ne_m_s[0] - east * wanted_ne_m_s[1]
        if missing > worst_by:
            worst, worst_by, worst_reach_m = j, missing, reach_m
        count += 1
    if worst < 0:
        return
    found_ne = np.empty(2)
    _nearest(normals, bounds, count, wanted_ne_m_s, found_ne)
    ahead_n, ahead_e = wanted_ne_m_s[0] - frame_ned_m_s[0], wanted_ne_m_s[1] - frame_ned_m_s[1]
    speed_m_s = np.hypot(ahead_n, ahead_e)
    if speed_m_s > 1e-6:
        # What is blocked ahead goes to the right: with everybody doing so, nobody stands face to face for
        # long. Not where the neighbour stands on the goal itself, or around it one would go for ever.
        ahead_n, ahead_e = ahead_n / speed_m_s, ahead_e / speed_m_s
        blocked = (wanted_ne_m_s[0] - found_ne[0]) * ahead_n + (wanted_ne_m_s[1] - found_ne[1]) * ahead_e
        beside_m = np.hypot(goal_ned_m[0] - pos_ned_m[worst, 0], goal_ned_m[1] - pos_ned_m[worst, 1])
        aside = min(max(beside_m / worst_reach_m - 1.0, 0.0), 1.0) * min(max(blocked, 0.0), speed_m_s)
        if aside > 0.0:
            turned_ne = np.empty(2)
            turned_ne[0] = wanted_ne_m_s[0] - aside * (ahead_n + ahead_e)
            turned_ne[1] = wanted_ne_m_s[1] - aside * (ahead_e - ahead_n)
            _nearest(normals, bounds, count, turned_ne, found_ne)
    change_ne_m_s[0] = found_ne[0] - wanted_ne_m_s[0]
    change_ne_m_s[1] = found_ne[1] - wanted_ne_m_s[1]


@njit(cache=True)
def remember(
    now_us: int, j: int, fresh: bool,  # noqa: FBT001  # numba knows no keyword-only arguments
    pos_ned_m: Array, vel_ned_m_s: Array, std_m: Array, plan_pos_ned_m: Array, plan_vel_ned_m_s: Array,
    kept: Kept,
) -> bool:  # fmt: skip
    """Keep what is known of member j if it is fresh; else put it where it would be by what was kept.

    Arrays have a row for every member: of one that is not fresh, pos_ned_m, vel_ned_m_s and std_m are filled.
    Returns whether it is fresh or was within `KEEP_US`.
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
    in_place_m: float, radius_m: float, asked: Array,
) -> tuple[float, float]:  # fmt: skip
    """What `keep_clear` adds to the velocity wanted, north and east, after `remember`.

    plan_pos_ned_m and plan_vel_ned_m_s have a row for every UAV of the formation, ``others`` (N,), of `SEEN`,
    and ``kept`` (N,), of `KEPT`, one for every member. What is handed in stays as it is but for ``kept``.
    ``asked`` (5,): goal_ned_m (3,) and wanted_ne_m_s (2,).
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
        # The own place is known, wherever it thinks itself to be.
        counts[j] = remember(now_us, j, other["fresh"] or j == own, pos, vel, std, plan_pos, plan_vel, kept)
    change_ne_m_s = np.empty(2)
    keep_clear(
        own, pos, vel, counts, std, limits_m, in_place_m, radius_m, plan_pos[own], plan_vel[own],
        asked[3:5], asked[:3], change_ne_m_s,
    )  # fmt: skip
    return change_ne_m_s[0], change_ne_m_s[1]


class Avoidance:
    """One UAV's keeping clear of the others.

    Args:
        own: row of this UAV among the members.
        places_ned_m: (F, 3) the formation's places.
        radius_m: distance to keep, before uncertainty and within what the places allow.
        members: (N,) whom it keeps clear of, and itself; None: everybody.

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
        self._asked = np.zeros(_ASKED.size // 8)
        self._asked_bytes = self._asked.data.cast("B")

    def velocity_change_ne_m_s(
        self,
        now_us: int,
        *,
        others: Others,
        plan_pos_ned_m: Array,
        plan_vel_ned_m_s: Array,
        goal_ned_m: Sequence[float],
        wanted_ne_m_s: Sequence[float],
    ) -> tuple[float, float]:
        """Velocity, NED north and east, to add to the setpoint's: exactly zero while nobody is near.

        Args:
            now_us: of all that follows.
            others: (N,) of `SEEN`, a row for every member, the own one too; positions are extrapolated to
                now. Fresh is who was heard within `FRESH_US` and is known to be there. Others are kept clear
                of for `KEEP_US` after that, as if they followed the plan.
            plan_pos_ned_m: (F, 3) the places of the whole formation now.
            plan_vel_ned_m_s: (F, 3) and how they move.
            goal_ned_m: (3,) where the own UAV is to be in the end: its place.
            wanted_ne_m_s: (2,) horizontal velocity that the autopilot's position loop will ask for: its gain
                times the way to the reference, and the reference's velocity.

        """
        _ASKED.pack_into(self._asked_bytes, 0, *goal_ned_m, *wanted_ne_m_s)
        change_ne_m_s: tuple[float, float] = velocity_change(
            self._own, now_us, others, plan_pos_ned_m, plan_vel_ned_m_s, self._kept,
            self._in_place_m, self._radius_m, self._asked,
        )  # fmt: skip
        return change_ne_m_s
