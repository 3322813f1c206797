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
from numpy.typing import NDArray

from autopilot.onboard.beacon import Fix, GpsError
from autopilot.onboard.localisation import SILENCE_US, CooperativeLocalisation
from autopilot.onboard.neighbourhood import Neighbourhood
from autopilot.onboard.receivers import BIAS_SIGMAS

Array = NDArray[np.float64]

PERIOD_US = 200_000
"""Of a round: beacons come about as often."""
ANCHOR_S = 10.0
"""Time constant with which the GPS of all moves the common place: slow against rounds, fast against GPS."""
MISFIT_M = 0.3
"""A neighbour that says otherwise than the others by more counts for less, several times what is usual."""
FITS = 3
"""Of the weights."""

_Told = tuple[int, int, float, float, float, float, float]
"""When it was heard, time of the fix in us; fix and its error, north and east; the variance stated."""


class CommonFrame:
    """One UAV's part in the common frame; positions are site NED.

    Args:
        near: its neighbourhood.
        gps_std_m: what errors of GPS are taken to be at least, per horizontal axis.

    Attributes:
        shift_ne_m: to be added to the positions that the own localisation has near the own one.

    """

    def __init__(self, near: Neighbourhood, *, gps_std_m: float) -> None:
        self.shift_ne_m = (0.0, 0.0)
        self._near = near
        self._gps_std_m = gps_std_m
        self._told: list[_Told | None] = [None] * near.stations
        self._due_us = 0

    def hear(self, station: int, fix: Fix, error: GpsError, now_us: int) -> None:
        """Take what a UAV, the own one too, says of its newest fix."""
        std_m = max(fix.std_h_m or 0.0, self._gps_std_m)
        north_m, east_m, _ = fix.pos_ned_m
        error_n_m, error_e_m, _ = error.ned_m
        self._told[station] = (
            now_us, fix.time_ms * 1_000, north_m, east_m, error_n_m, error_e_m, std_m * std_m,
        )  # fmt: skip

    def error(self, fix: Fix, localisation: CooperativeLocalisation) -> GpsError:
        """Error of a fix of the own receiver in the common frame; for the beacon.

        Horizontally that of this very fix, so that whoever hears both knows where the UAV believes itself.
        """
        (error_n_m, error_e_m, down_m), std_m = localisation.gps_error(localisation.own)
        odometry_ned_m = localisation.odometry_at(localisation.own, fix.time_ms * 1_000)
        if odometry_ned_m is not None:
            (odometry_n_m, odometry_e_m, _), (fix_n_m, fix_e_m, _) = odometry_ned_m, fix.pos_ned_m
            (offset_n_m, offset_e_m), (shift_n_m, shift_e_m) = localisation.offset_ne_m(), self.shift_ne_m
            error_n_m = fix_n_m - (odometry_n_m + offset_n_m + shift_n_m)
            error_e_m = fix_e_m - (odometry_e_m + offset_e_m + shift_e_m)
        return GpsError((error_n_m, error_e_m, down_m), std_m)

    def update(self, now_us: int, localisation: CooperativeLocalisation) -> None:
        """Do a round if one is due: lay the own picture onto the others', and that onto everybody's GPS."""
        if now_us < self._due_us:
            return
        self._due_us = now_us + PERIOD_US
        own = localisation.own
        there_ne_m = localisation.positions_ned_m(now_us)[:, :2]
        members, apart_ne_m = self._disagreement(now_us, localisation)
        if not members:
            return
        rows = [*members, own]
        shift_ne_m = laid_onto(there_ne_m[rows], np.vstack((apart_ne_m, self.shift_ne_m)))
        shift_ne_m += self._anchoring(now_us, there_ne_m[own] + shift_ne_m)
        shift_n_m, shift_e_m = shift_ne_m.tolist()
        self.shift_ne_m = (shift_n_m, shift_e_m)

    def _disagreement(self, now_us: int, localisation: CooperativeLocalisation) -> tuple[list[int], Array]:
        """Rows of neighbours who say where they are, and (n, 2) how far from where they are here that is."""
        members: list[int] = []
        apart_ne_m: list[Array] = []
        for row, station in enumerate(self._near.members.tolist()):
            told = self._told[station]
            if row == localisation.own or told is None or now_us - told[0] > SILENCE_US:
                continue
            odometry_ned_m = localisation.odometry_at(row, told[1]) if localisation.located[row] else None
            if odometry_ned_m is None:
                continue
            believed_ne_m = np.array((told[2] - told[4], told[3] - told[5]))
            members.append(row)
            apart_ne_m.append(believed_ne_m - odometry_ned_m[:2] - localisation.offsets_ned_m[row, :2])
        return members, np.array(apart_ne_m).reshape(-1, 2)

    def _anchoring(self, now_us: int, own_ne_m: Array) -> Array:
        """(2,) the way of a round to where the GPS of everybody heard has the common place and heading."""
        heard = [told for told in self._told if told is not None and now_us - told[0] <= SILENCE_US]
        if len(heard) < 2:  # one alone has no heading
            return np.zeros(2)
        told = np.array(heard)
        error_ne_m, variance_m2 = told[:, 4:6], told[:, 6]
        weights = 1.0 / np.maximum(variance_m2, (error_ne_m**2).max(axis=1) / BIAS_SIGMAS**2)
        return PERIOD_US * 1e-6 / ANCHOR_S * _moved(told[:, 2:4] - error_ne_m, error_ne_m, weights, own_ne_m)


def laid_onto(pos_ne_m: Array, apart_ne_m: Array) -> Array:
    """(2,) way of the last of some positions (n, 2) when all are laid onto where others have them.

    apart_ne_m (n, 2) leads there. Turns are small, so that the way is linear in them. The weight of each but
    the last, which is 1, falls with its misfit.
    """
    moved_ne_m = np.median(apart_ne_m, axis=0)
    misfits_m = np.hypot(*(apart_ne_m - moved_ne_m).T)
    for _ in range(FITS):
        weights = np.minimum(1.0, MISFIT_M / np.maximum(misfits_m, MISFIT_M))
        weights[-1] = 1.0
        moved_ne_m = _moved(pos_ne_m, apart_ne_m, weights, pos_ne_m)
        misfits_m = np.hypot(*(apart_ne_m - moved_ne_m).T)
    return np.asarray(moved_ne_m[-1])


def _moved(pos_ne_m: Array, apart_ne_m: Array, weights: Array, at_ne_m: Array) -> Array:
    """Way (.., 2) of points at_ne_m (.., 2) in the rigid motion that best takes all (n, 2) by apart_ne_m."""
    share = weights / weights.sum()
    middle_m = share @ pos_ne_m
    arms_m = pos_ne_m - middle_m
    spread_m2 = float(share @ (arms_m**2).sum(axis=1))
    turn = 0.0
    if spread_m2 > 0.0:
        crossed_m2 = arms_m[:, 0] * apart_ne_m[:, 1] - arms_m[:, 1] * apart_ne_m[:, 0]
        turn = float(share @ crossed_m2) / spread_m2
    moved_ne_m: Array = share @ apart_ne_m + turn * (at_ne_m - middle_m)[..., ::-1] * (-1.0, 1.0)
    return moved_ne_m
