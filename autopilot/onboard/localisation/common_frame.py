"""One frame for a formation of overlapping neighbourhoods.

A UAV that localises its neighbourhood alone knows its shape to centimetres, but where that shape is and how
it is headed only by the GPS of the few in it: half a metre for a dozen, and differently at every UAV, which
would bend the formation by as much. But all say where they believe themselves to be, by the error that they
find in their GPS fixes. So each lays its own picture, rigidly and by least squares, onto what its neighbours
say, and takes its own place in it for where it is. Where the picture was has no part in the result: what is
left of it after some rounds is the shape of all, at a place and heading that all have in common. A rigid
motion of the whole is the only thing that a round does not shrink, whatever the layout (a test looks at the
eigenvalues); three rounds of a dozen neighbours each cross eight rows.

Left to itself that common place would stay where it began, so each moves its own by a small part of the mean
error, and of the mean turn, that the GPS of everybody who is heard shows against it: 64 receivers hold the
formation as a whole as well as one filter over all of them would.

What is wrong counts little: a neighbour that says what the others do not by its misfit (Huber's weight),
a receiver with a large error as one whose errors are that large.
"""

import numpy as np
from numba import njit

from autopilot.onboard.localisation.kernels import STATES, Array, Times
from autopilot.onboard.localisation.localisation import SILENCE_US, CooperativeLocalisation
from autopilot.onboard.localisation.members import Members
from autopilot.onboard.localisation.receivers import BIAS_SIGMAS
from autopilot.onboard.localisation.tracks import EXTRAPOLATED_S, KNOWN, Rings, odometry_at
from autopilot.onboard.radio.beacon import Fix, GpsError
from autopilot.onboard.radio.neighbour_table import NeighbourTable, Stations

PERIOD_US = 200_000
"""Of a round; with beacons as they are by default, everybody is heard in each."""
ANCHOR_S = 10.0
"""Time constant with which the GPS of all moves the common place: slow against rounds, fast against GPS."""
MISFIT_M = 0.3
"""A neighbour that says otherwise than the others by more counts for less, several times what is usual."""
FITS = 3
"""Of the weights."""
Level = tuple[float, float]


class CommonFrame:
    """One UAV's part in the common frame; positions are site NED.

    Args:
        members: (N,) the stations of its neighbourhood.
        hearing: what they and all others say of their fixes.

    Attributes:
        shift_ne_m: to be added to the positions that the own localisation has near the own one.

    """

    def __init__(self, members: Times, hearing: NeighbourTable) -> None:
        self.shift_ne_m: Level = (0.0, 0.0)
        self._members = members
        self._hearing = hearing
        self._due_us = 0

    def say(self, station: int, fix: Fix, localisation: CooperativeLocalisation, now_us: int) -> GpsError:
        """Give the error of the newest fix for the beacon, and go by it as all who hear that do."""
        error = self.error(fix, localisation)
        self._hearing.note_fix(station, fix, error, now_us)
        return error

    def error(self, fix: Fix, localisation: CooperativeLocalisation) -> GpsError:
        """Error of a fix of the own receiver in the common frame.

        Horizontally that of this very fix, so that whoever hears both knows where the UAV believes itself.
        """
        (error_n_m, error_e_m, down_m), std_m = localisation.gps_error(localisation.own)
        odometry_ned_m = localisation.odometry_at(localisation.own, fix.time_ms * 1_000)
        if odometry_ned_m is not None:
            odometry_n_m, odometry_e_m, _ = odometry_ned_m.tolist()
            (fix_n_m, fix_e_m, _), (shift_n_m, shift_e_m) = fix.pos_ned_m, self.shift_ne_m
            offset_n_m, offset_e_m = localisation.offset_ne_m()
            error_n_m = fix_n_m - (odometry_n_m + offset_n_m + shift_n_m)
            error_e_m = fix_e_m - (odometry_e_m + offset_e_m + shift_e_m)
        return GpsError((error_n_m, error_e_m, down_m), std_m)

    def update(self, now_us: int, localisation: CooperativeLocalisation) -> None:
        """Do a round if one is due: lay the own picture onto the others', and that onto everybody's GPS."""
        if now_us < self._due_us:
            return
        self._due_us = now_us + PERIOD_US
        self.shift_ne_m = play_round(
            localisation.own, now_us, self._members, self._hearing.stations, localisation.members,
            localisation.tracks.rings, localisation.state, *self.shift_ne_m,
        )  # fmt: skip


@njit(cache=True)
def play_round(
    own: int, now_us: int, numbers: Times, stations: Stations, members: Members, rings: Rings, state: Array,
    shift_n_m: float, shift_e_m: float,
) -> Level:  # fmt: skip
    """Shift after a round from that before it; unchanged as long as no neighbour says where it is.

    Args:
        own: row of the own UAV among those that it localises.
        now_us: when it is done.
        numbers: (N,) the stations that these are.
        stations: (F,) of `STATION`, what all have said.
        members: (N,) of `MEMBER`, and ``rings`` (N,) of `RING`.
        rings: see there.
        state: (5N,) of the filter.
        shift_n_m: north, and ``shift_e_m`` east.
        shift_e_m: see there.

    """
    count = members.size
    pos_ne_m, apart_ne_m, then_ned_m = np.empty((count, 2)), np.empty((count, 2)), np.empty(3)
    said = 0
    for passing in range(2):
        for row in range(count):
            if (row == own) is not (passing == 1):  # the own one comes last
                continue
            if row == own:
                apart_ne_m[said, 0], apart_ne_m[said, 1] = shift_n_m, shift_e_m
            else:
                heard = stations[numbers[row]]
                if not _says_where(heard, now_us) or members[row]["located"] == 0:
                    continue
                if odometry_at(rings, row, heard["fix_us"], then_ned_m) != KNOWN:
                    continue
                for a in range(2):
                    believed_m = heard["fix_ne_m"][a] - heard["error_ne_m"][a]
                    apart_ne_m[said, a] = believed_m - then_ned_m[a] - state[STATES * row + a]
            newest = members[row]["newest"]
            age_s = min((now_us - members[row]["newest_us"]) * 1e-6, EXTRAPOLATED_S)
            for a in range(2):
                pos_ne_m[said, a] = newest[a] + newest[3 + a] * age_s + state[STATES * row + a]
            said += 1
    if said < 2:
        return shift_n_m, shift_e_m
    shift_n_m, shift_e_m = laid_onto(pos_ne_m[:said], apart_ne_m[:said])
    own_n_m, own_e_m = pos_ne_m[said - 1, 0] + shift_n_m, pos_ne_m[said - 1, 1] + shift_e_m
    towards_n_m, towards_e_m = to_everybodys_gps(now_us, stations, own_n_m, own_e_m)
    part = PERIOD_US * 1e-6 / ANCHOR_S
    return shift_n_m + part * towards_n_m, shift_e_m + part * towards_e_m


@njit(cache=True)
def _says_where(station: np.void, now_us: int) -> bool:
    """Whether a station has said of late where it believes itself to be."""
    said_us: int = station["located_us"]
    return said_us >= 0 and now_us - said_us <= SILENCE_US


@njit(cache=True)
def to_everybodys_gps(now_us: int, stations: Stations, own_n_m: float, own_e_m: float) -> Level:
    """Way from the own place to where the GPS of everybody heard has it, by the common place and heading."""
    pos_ne_m, error_ne_m = np.empty((stations.size, 2)), np.empty((stations.size, 2))
    weights = np.empty(stations.size)
    count = 0
    for station in range(stations.size):
        heard = stations[station]
        if not _says_where(heard, now_us):
            continue
        largest_m2 = 0.0
        for a in range(2):
            error_m = heard["error_ne_m"][a]
            error_ne_m[count, a] = error_m
            pos_ne_m[count, a] = heard["fix_ne_m"][a] - error_m
            largest_m2 = max(largest_m2, error_m * error_m)
        weights[count] = 1.0 / max(heard["variance_m2"], largest_m2 / BIAS_SIGMAS**2)
        count += 1
    if count < 2:  # one alone has no heading
        return 0.0, 0.0
    return moved(*rigid_motion(pos_ne_m[:count], error_ne_m[:count], weights[:count]), own_n_m, own_e_m)


@njit(cache=True)
def laid_onto(pos_ne_m: Array, apart_ne_m: Array) -> Level:
    """Way of the last of some positions (n, 2) when all are laid onto where others have them.

    apart_ne_m (n, 2) leads there. Turns are small, so that the way is linear in them. The weight of each but
    the last, which is 1, falls with its misfit.
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
    """The rigid motion that best takes all (n, 2) by apart_ne_m.

    Gives its shift, its turn and the centre of that: the arguments of `moved`.
    """
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
    """Way of a point in a rigid motion."""
    return shift_n_m - turn_rad * (east_m - centre_e_m), shift_e_m + turn_rad * (north_m - centre_n_m)


@njit(cache=True)
def _median(values: Array) -> float:
    ordered = np.sort(values)
    middle = ordered.size // 2
    if ordered.size % 2:
        return float(ordered[middle])
    return 0.5 * float(ordered[middle - 1] + ordered[middle])
