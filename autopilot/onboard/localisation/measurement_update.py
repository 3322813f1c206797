"""Compiled kernels that process beacons, odometry, fixes and distances for the localisation's filter.

The frequent cases, which change few numbers, are handled here. The rare ones are handled by `localisation`: a
kernel that meets one returns a code of the action required, and is called again after that action.
"""

import numpy as np
from numba import njit

from autopilot.onboard.localisation.distances import Pairs, Pending, add_distance
from autopilot.onboard.localisation.kernels import STATES, Array, fuse_range, predict
from autopilot.onboard.localisation.members import Filter, Members
from autopilot.onboard.localisation.model import SILENCE_US
from autopilot.onboard.localisation.receivers import MISFIT_WEIGHT, add_fix, fuse_mean, take_stated
from autopilot.onboard.localisation.tracks import Rings, odometry_at, odometry_between, push
from autopilot.onboard.localisation.trust import ELSEWHERE_LIMIT, note
from autopilot.onboard.radio.beacon import HAS_FIX, PageRows
from autopilot.onboard.radio.neighbour_table import (
    REFUSED,
    RESTARTED,
    Listener,
    Rows,
    Stations,
    receive_beacon,
    row_of,
)

PENDING_LIMIT_US = 1_000_000
"""A distance is dropped if the odometry of its ends does not arrive within this time."""
LOST_US = 30_000_000
"""A UAV that returns after this time is initialised again, as its odometry has drifted by half a metre."""
PULLED_VAR_M2 = 1.0
"""Variance added to the position of a UAV whose measurements have just been found to be wrong."""

DONE = 0
SENDER_RESTARTED, LOST, ODOMETRY_JUMPED, FIRST_MEAN, GPS_STEPPED, FULL = 1, 2, 3, 4, 5, 6
"""Actions required by a UAV's input: its application has restarted (to be handled before the beacon's
content); it was silent for long; its odometry has jumped; its first mean of fixes is complete; its GPS has
made a step; there is no room for its distances."""
NOT_LOCATED, ELSEWHERE = 7, 8
"""Actions required by a pending distance: an end is not located; the estimate of an end must be wrong."""


@njit(cache=True)
def advance(
    filter_row: Filter, members: Members, state: Array, cov: Array, time_us: int, stride_us: int
) -> float:
    """Propagate the filter to ``time_us``; returns by how many seconds the filter was ahead of it, else 0.

    Slow errors are propagated in strides of at least ``stride_us``; 0: up to now.
    """
    own = filter_row[0]
    ahead_us = own["time_us"] - time_us
    if ahead_us >= 0 and stride_us > 0:
        return float(ahead_us * 1e-6)
    step_us = max(-ahead_us, 0) if own["time_us"] else 0
    own["decay_owed_us"] += step_us
    decay_us = own["decay_owed_us"] if own["decay_owed_us"] >= stride_us else 0
    own["decay_owed_us"] -= decay_us
    predict(
        state, cov, members, own["drift_m2_s"] * step_us * 1e-6, decay_us * 1e-6,
        own["height_var_m2"], own["height_time_constant_s"], own["gps_bias_time_constant_s"],
    )  # fmt: skip
    own["time_us"] = max(own["time_us"], time_us)
    return float(max(ahead_us, 0) * 1e-6)


@njit(cache=True)
def take_odometry(
    filter_row: Filter, members: Members, rings: Rings, row: int, time_us: int, north_m: float,
    east_m: float, down_m: float, vel_n_m_s: float, vel_e_m_s: float, vel_d_m_s: float,
) -> int:  # fmt: skip
    """Process odometry of a UAV; returns DONE, LOST (nothing changed) or ODOMETRY_JUMPED (used)."""
    own, member = filter_row[0], members[row]
    silent_us = time_us - member["newest_us"]
    if silent_us > SILENCE_US:
        own["returned"] = 1
        if silent_us > LOST_US and member["located"]:
            return LOST
    sample = np.empty(6)
    sample[0], sample[1], sample[2] = north_m, east_m, down_m
    sample[3], sample[4], sample[5] = vel_n_m_s, vel_e_m_s, vel_d_m_s
    jumped = push(members, rings, row, time_us, sample, own["step_ne_m"])
    return ODOMETRY_JUMPED if jumped and member["active"] else DONE


@njit(cache=True)
def take_fix(
    filter_row: Filter, members: Members, rings: Rings, state: Array, cov: Array, row: int,
    time_us: int, north_m: float, east_m: float, down_m: float, std_h_m: float, std_v_m: float,
) -> int:  # fmt: skip
    """Process a GPS position, once there is odometry of its time, and the stated accuracy; 0: none stated.

    Returns DONE, FIRST_MEAN or GPS_STEPPED.
    """
    own, member = filter_row[0], members[row]
    if time_us <= member["fix_us"]:
        return DONE
    pos_ned_m, odometry_ned_m = np.empty(3), np.empty(3)
    pos_ned_m[0], pos_ned_m[1], pos_ned_m[2] = north_m, east_m, down_m
    if not odometry_at(rings, row, time_us, odometry_ned_m):
        return DONE
    member["fix_us"] = time_us
    if std_h_m > 0.0 or std_v_m > 0.0:
        take_stated(members, row, std_h_m, std_v_m, cov, filter_row)
    active = member["active"] != 0
    if not add_fix(members, row, time_us, pos_ned_m, odometry_ned_m, not active):
        return DONE
    if not active:
        return FIRST_MEAN
    advance(filter_row, members, state, cov, time_us, own["decay_stride_us"])
    own["gps_var_m2"] = fuse_mean(members, row, state, cov, own["time_us"], filter_row)
    return GPS_STEPPED if own["gps_var_m2"] > 0.0 else DONE


@njit(cache=True)
def take_beacon(
    page: np.void, row: int, now_us: int, rows: Rows, filter_row: Filter,
    members: Members, rings: Rings, state: Array, cov: Array, pairs: Pairs, pending: Pending,
) -> int:  # fmt: skip
    """Process the content of a UAV's valid beacon; entries that are already known are skipped.

    Returns DONE, or the action required before the beacon is processed again.
    """
    header, ranges = page["header"], page["ranges"]
    action = take_odometry(
        filter_row, members, rings, row, int(np.int64(header["time_us"])),
        np.float64(header["odometry_n_m"]), np.float64(header["odometry_e_m"]),
        np.float64(header["odometry_d_m"]), np.float64(header["vel_n_m_s"]),
        np.float64(header["vel_e_m_s"]), np.float64(header["vel_d_m_s"]),
    )  # fmt: skip
    if action != DONE:
        return action
    fix_us = int(np.int64(header["fix_ms"])) * 1_000
    if header["flags"] & HAS_FIX and fix_us <= now_us:
        action = take_fix(
            filter_row, members, rings, state, cov, row, fix_us,
            np.float64(header["fix_n_m"]), np.float64(header["fix_e_m"]), np.float64(header["fix_d_m"]),
            np.int64(header["fix_std_h_mm"]) * 1e-3, np.int64(header["fix_std_v_mm"]) * 1e-3,
        )  # fmt: skip
        if action != DONE:
            return action
    count = np.int64(header["count"])
    if filter_row[0]["pending"] + count > pending.size:
        return FULL
    floor_m2 = filter_row[0]["range_floor_var_m2"]
    for k in range(count):
        entry = ranges[k]
        peer = np.int64(entry["peer"])
        responder = rows[peer] if peer < rows.size else -1
        if responder >= 0:
            std_m = np.int64(entry["std_mm"]) * 1e-3
            add_distance(
                pairs, pending, filter_row, row, responder, int(np.int64(entry["time_ms"])) * 1_000,
                np.float64(entry["distance_m"]), std_m * std_m + floor_m2, now_us,
            )  # fmt: skip
    return DONE


@njit(cache=True)
def read_beacons(
    count: int, now_us: int, pages: PageRows, listener: Listener, stations: Stations, rows: Rows,
    filter_row: Filter, members: Members, rings: Rings, state: Array, cov: Array,
    pairs: Pairs, pending: Pending,
) -> int:  # fmt: skip
    """Process the beacons on ``count`` pages; the content of beacons from localised UAVs updates the filter.

    Returns DONE, or the action required before processing continues.
    """
    me = listener[0]
    while me["at"] < count:
        page = pages[me["at"]]
        row = row_of(page, rows)
        if not me["is_open"]:
            outcome = receive_beacon(page, now_us, listener, stations, rows)
            me["is_open"] = outcome != REFUSED and row >= 0
            if me["is_open"] and outcome == RESTARTED:
                return SENDER_RESTARTED
        if me["is_open"]:
            action = take_beacon(
                page, row, now_us, rows, filter_row, members, rings, state, cov, pairs, pending,
            )  # fmt: skip
            if action != DONE:
                return action
            me["is_open"] = 0
        me["at"] += 1
    me["at"] = 0
    return DONE


@njit(cache=True)
def use_pending(
    now_us: int, filter_row: Filter, members: Members, rings: Rings, state: Array,
    cov: Array, pairs: Pairs, pending: Pending, reference_ne_m: Array, bend_m: Array,
    bend_var_m2: Array,
) -> int:  # fmt: skip
    """Use the pending distances that odometry covers by now, in the order of their arrival.

    Returns DONE, or the action that the distance processed last requires before processing continues:
    NOT_LOCATED or ELSEWHERE. reference_ne_m, bend_m and bend_var_m2 are those of `reference_geometry`.
    """
    own = filter_row[0]
    between_ned_m = own["between_ned_m"][:]  # of the type of the arrays that Python passes
    while own["done"] < own["pending"]:
        at = own["done"]
        item = pending[at]
        i, j, time_us = item["initiator"], item["responder"], item["time_us"]
        own["done"] = at + 1
        covered = time_us <= members[i]["newest_us"] and time_us <= members[j]["newest_us"]
        if covered and not odometry_between(rings, i, j, time_us, between_ned_m):
            own["ranges_too_late"] += 1
        elif not (covered and members[i]["active"] and members[j]["active"]):
            if now_us - time_us > PENDING_LIMIT_US:
                own["ranges_too_late"] += 1
            else:
                pending[own["kept"]] = item
                own["kept"] += 1
        elif not (members[i]["located"] and members[j]["located"]):
            return NOT_LOCATED
        else:
            _use(item, filter_row, members, state, cov, pairs, reference_ne_m, bend_m, bend_var_m2)
            for end in (i, j):
                if members[end]["as_end"] > ELSEWHERE_LIMIT:
                    return ELSEWHERE
    own["pending"] = own["kept"]
    own["done"] = own["kept"] = 0
    return DONE


@njit(cache=True)
def _use(
    item: np.void, filter_row: Filter, members: Members, state: Array, cov: Array,
    pairs: Pairs, reference_ne_m: Array, bend_m: Array, bend_var_m2: Array,
) -> None:  # fmt: skip
    """Fuse a distance between two located UAVs, or only count it if its initiator is distrusted."""
    own = filter_row[0]
    i, j = item["initiator"], item["responder"]
    pair, between_ned_m = pairs[i, j], own["between_ned_m"][:]
    lag_s = advance(filter_row, members, state, cov, item["time_us"], own["decay_stride_us"])
    # Late distances of one UAV share the error that its odometry has gathered since, and hold no more
    # information than one of them.
    late_m2 = own["drift_m2_s"] * lag_s * (1.0 + own["distances_hz"] * lag_s)
    trusted = members[i]["distrusted"] == 0
    weight = fuse_range(
        state, cov, state, reference_ne_m, i, j, between_ned_m, item["distance_m"] - bend_m[i, j],
        item["variance_m2"] + 2.0 * late_m2 + bend_var_m2[i, j], -1.0, 1.0 if trusted else 0.0,
    )  # fmt: skip
    count_distance(filter_row, members, i, j, item["time_us"], weight, trusted)
    pair["fused_us"], pair["distance_m"] = item["time_us"], item["distance_m"]
    pair["variance_m2"] = item["variance_m2"]
    for a in range(3):
        pair["between_ned_m"][a] = between_ned_m[a]
    if trusted and members[i]["distrusted"]:
        # Its own wrong distances have displaced it.
        for at in range(STATES * i, STATES * i + 2):
            cov[at, at] += PULLED_VAR_M2


@njit(cache=True)
def count_distance(
    filter_row: Filter, members: Members, initiator: int, responder: int, time_us: int, weight: float,
    fused: bool,  # noqa: FBT001  # numba has no keyword-only arguments
) -> None:  # fmt: skip
    """Update counts and fault detection by a distance that was compared with the estimate."""
    own = filter_row[0]
    badly = not weight >= MISFIT_WEIGHT
    own["ranges_used"] += 1
    if badly:
        own["ranges_downweighted"] += 1
    note(members, initiator, responder, badly)
    if fused and not badly and (own["own"] == initiator or own["own"] == responder):
        own["own_range_us"] = max(time_us, own["own_range_us"], 0)
