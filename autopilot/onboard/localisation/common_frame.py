"""One frame for a formation of overlapping neighbourhoods.

A UAV that localises only its neighbourhood estimates the shape to centimetres. The position and heading of
that local solution, however, depend on the GPS of its few members: the error is half a metre for a dozen, it
differs from UAV to UAV, and it would bend the formation by as much. Each UAV broadcasts its estimated
position as the error of its GPS fix. Each UAV therefore aligns its local solution, rigidly and by least
squares, to the positions that its neighbours report, and uses its own aligned position. The original position
of the local solution does not enter the result: after some rounds the solutions agree on one shape at a
common position and heading. A rigid motion of the whole is the only mode that a round does not reduce, for
any layout (a test checks the eigenvalues); with a dozen neighbours each, three rounds span eight rows.

Consensus alone would keep the initial common position. Each UAV therefore also moves its position by a small
part of the mean error, and of the mean turn, of the GPS of all UAVs from which it receives beacons. Faults
have little weight: a neighbour that disagrees with the others is weighted by its misfit (Huber), a receiver
with a large error by the variance of errors of that size.
"""

import numpy as np
from numba import njit

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.localisation.kernels import STATES, Array, Times
from autopilot.onboard.localisation.localisation import CooperativeLocalisation
from autopilot.onboard.localisation.members import Members
from autopilot.onboard.localisation.model import SILENCE_US
from autopilot.onboard.localisation.receivers import BIAS_SIGMAS
from autopilot.onboard.localisation.tracks import EXTRAPOLATED_S, Rings, odometry_at
from autopilot.onboard.radio.beacon import GpsError
from autopilot.onboard.radio.neighbour_table import NeighbourTable, Stations

PERIOD_US = 200_000
"""Period of a round; at the default beacon period it covers a beacon of every neighbour."""
ANCHOR_S = 10.0
"""Time constant of the common position's correction by GPS: slow against rounds, fast against GPS errors."""
MISFIT_M = 0.3
"""Misfit above which a neighbour's weight falls: several times the usual one."""
FITS = 3
"""Number of fits, each with the weights of the previous one."""
Level = tuple[float, float]


class CommonFrame:
    """One UAV's part in the common frame of the ``members`` (N,) of its neighbourhood; site NED."""

    def __init__(self, members: Times, table: NeighbourTable) -> None:
        self.shift_ne_m: Level = (0.0, 0.0)
        """Shift from the local solution to the common frame, valid near the own position."""
        self._members = members
        self._table = table
        self._due_us = 0

    def report_error(
        self, station: int, fix: Fix, localisation: CooperativeLocalisation, now_us: int
    ) -> GpsError:
        """Return the error of the own newest fix for the beacon, and store it as the receiving UAVs do.

        The horizontal error is that of this fix itself, not the bias: fix and error yield the UAV's estimated
        position in the common frame.
        """
        (error_n_m, error_e_m, down_m), std_m = localisation.gps_error(localisation.own)
        odometry_ned_m = localisation.odometry_at(localisation.own, fix.time_ms * 1_000)
        if odometry_ned_m is not None:
            odometry_n_m, odometry_e_m, _ = odometry_ned_m.tolist()
            (fix_n_m, fix_e_m, _), (shift_n_m, shift_e_m) = fix.pos_ned_m, self.shift_ne_m
            offset_n_m, offset_e_m = localisation.offset_ne_m()
            error_n_m = fix_n_m - (odometry_n_m + offset_n_m + shift_n_m)
            error_e_m = fix_e_m - (odometry_e_m + offset_e_m + shift_e_m)
        error = GpsError((error_n_m, error_e_m, down_m), std_m)
        self._table.note_fix(station, fix, error, now_us)
        return error

    def update(self, now_us: int, localisation: CooperativeLocalisation) -> None:
        """Run a round if one is due: align the local solution to the neighbours and to the GPS of all."""
        if now_us < self._due_us:
            return
        self._due_us = now_us + PERIOD_US
        self.shift_ne_m = run_round(
            localisation.own, now_us, self._members, self._table.stations, localisation.members,
            localisation.tracks.rings, localisation.state, *self.shift_ne_m,
        )  # fmt: skip


@njit(cache=True)
def run_round(
    own: int, now_us: int, numbers: Times, stations: Stations, members: Members, rings: Rings, state: Array,
    shift_n_m: float, shift_e_m: float,
) -> Level:  # fmt: skip
    """Return the shift after a round; unchanged if no neighbour has reported its position.

    ``own`` is the row of the own UAV in the filter, ``numbers`` (N,) are the stations of the rows, and
    ``stations`` (F,) the newest reports of all.
    """
    count = members.size
    pos_ne_m, apart_ne_m, then_ned_m = np.empty((count, 2)), np.empty((count, 2)), np.empty(3)
    n = 0
    for passing in range(2):
        for row in range(count):
            if (row == own) is not (passing == 1):  # the own UAV comes last
                continue
            if row == own:
                apart_ne_m[n, 0], apart_ne_m[n, 1] = shift_n_m, shift_e_m
            else:
                report = stations[numbers[row]]
                if not _has_position(report, now_us) or members[row]["located"] == 0:
                    continue
                if not odometry_at(rings, row, report["fix_us"], then_ned_m):
                    continue
                for a in range(2):
                    reported_m = report["fix_ne_m"][a] - report["error_ne_m"][a]
                    apart_ne_m[n, a] = reported_m - then_ned_m[a] - state[STATES * row + a]
            newest = members[row]["newest"]
            age_s = min((now_us - members[row]["newest_us"]) * 1e-6, EXTRAPOLATED_S)
            for a in range(2):
                pos_ne_m[n, a] = newest[a] + newest[3 + a] * age_s + state[STATES * row + a]
            n += 1
    if n < 2:
        return shift_n_m, shift_e_m
    shift_n_m, shift_e_m = laid_onto(pos_ne_m[:n], apart_ne_m[:n])
    own_n_m, own_e_m = pos_ne_m[n - 1, 0] + shift_n_m, pos_ne_m[n - 1, 1] + shift_e_m
    towards_n_m, towards_e_m = towards_mean_gps(now_us, stations, own_n_m, own_e_m)
    part = PERIOD_US * 1e-6 / ANCHOR_S
    return shift_n_m + part * towards_n_m, shift_e_m + part * towards_e_m


@njit(cache=True, inline="always")
def _has_position(station: np.void, now_us: int) -> bool:
    """Return whether a station has reported its estimated position within `SILENCE_US`."""
    reported_us: int = station["located_us"]
    return reported_us >= 0 and now_us - reported_us <= SILENCE_US


@njit(cache=True, inline="always")
def towards_mean_gps(now_us: int, stations: Stations, own_n_m: float, own_e_m: float) -> Level:
    """Return the displacement of the own position by the rigid motion that fits all reported GPS errors."""
    pos_ne_m, error_ne_m = np.empty((stations.size, 2)), np.empty((stations.size, 2))
    weights = np.empty(stations.size)
    count = 0
    for station in range(stations.size):
        report = stations[station]
        if not _has_position(report, now_us):
            continue
        largest_m2 = 0.0
        for a in range(2):
            error_m = report["error_ne_m"][a]
            error_ne_m[count, a] = error_m
            pos_ne_m[count, a] = report["fix_ne_m"][a] - error_m
            largest_m2 = max(largest_m2, error_m * error_m)
        weights[count] = 1.0 / max(report["variance_m2"], largest_m2 / BIAS_SIGMAS**2)
        count += 1
    if count < 2:  # a single one has no heading
        return 0.0, 0.0
    return moved(*rigid_motion(pos_ne_m[:count], error_ne_m[:count], weights[:count]), own_n_m, own_e_m)


@njit(cache=True, inline="always")
def laid_onto(pos_ne_m: Array, apart_ne_m: Array) -> Level:
    """Return the displacement of the last position under the rigid motion that fits displacements (n, 2).

    Turns are small, so the motion is linear in them. The last position has weight 1; the weights of the
    others fall with their misfit.
    """
    count = pos_ne_m.shape[0]
    weights = np.empty(count)
    turn_rad, centre_n_m, centre_e_m = 0.0, 0.0, 0.0
    shift_n_m, shift_e_m = _median(apart_ne_m[:, 0]), _median(apart_ne_m[:, 1])
    for _ in range(FITS):
        for k in range(count):
            north_m, east_m = moved(
                shift_n_m, shift_e_m, turn_rad, centre_n_m, centre_e_m, pos_ne_m[k, 0], pos_ne_m[k, 1]
            )
            misfit_m = np.hypot(apart_ne_m[k, 0] - north_m, apart_ne_m[k, 1] - east_m)
            weights[k] = MISFIT_M / max(misfit_m, MISFIT_M)
        weights[count - 1] = 1.0
        shift_n_m, shift_e_m, turn_rad, centre_n_m, centre_e_m = rigid_motion(pos_ne_m, apart_ne_m, weights)
    return moved(
        shift_n_m, shift_e_m, turn_rad, centre_n_m, centre_e_m, pos_ne_m[count - 1, 0], pos_ne_m[count - 1, 1]
    )


@njit(cache=True)
def rigid_motion(
    pos_ne_m: Array, apart_ne_m: Array, weights: Array
) -> tuple[float, float, float, float, float]:
    """Return the rigid motion, arguments of `moved`, that fits displacements of positions (n, 2) best."""
    count = pos_ne_m.shape[0]
    total, centre_n_m, centre_e_m, shift_n_m, shift_e_m = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        total += weights[k]
    for k in range(count):
        share = weights[k] / total
        centre_n_m += share * pos_ne_m[k, 0]
        centre_e_m += share * pos_ne_m[k, 1]
        shift_n_m += share * apart_ne_m[k, 0]
        shift_e_m += share * apart_ne_m[k, 1]
    spread_m2, crossed_m2 = 0.0, 0.0
    for k in range(count):
        share = weights[k] / total
        arm_n_m, arm_e_m = pos_ne_m[k, 0] - centre_n_m, pos_ne_m[k, 1] - centre_e_m
        spread_m2 += share * (arm_n_m * arm_n_m + arm_e_m * arm_e_m)
        crossed_m2 += share * (arm_n_m * apart_ne_m[k, 1] - arm_e_m * apart_ne_m[k, 0])
    turn_rad = crossed_m2 / spread_m2 if spread_m2 > 0.0 else 0.0
    return shift_n_m, shift_e_m, turn_rad, centre_n_m, centre_e_m


@njit(cache=True)
def moved(
    shift_n_m: float, shift_e_m: float, turn_rad: float, centre_n_m: float, centre_e_m: float,
    north_m: float, east_m: float,
) -> Level:  # fmt: skip
    """Return the displacement of a point under a rigid motion."""
    return shift_n_m - turn_rad * (east_m - centre_e_m), shift_e_m + turn_rad * (north_m - centre_n_m)


@njit(cache=True)
def _median(values: Array) -> float:
    ordered = np.empty(values.size)
    for k in range(values.size):  # insertion sort: np.sort takes 2 s to compile
        place = k
        while place > 0 and ordered[place - 1] > values[k]:
            ordered[place] = ordered[place - 1]
            place -= 1
        ordered[place] = values[k]
    middle = ordered.size // 2
    if ordered.size % 2:
        return float(ordered[middle])
    return 0.5 * float(ordered[middle - 1] + ordered[middle])
