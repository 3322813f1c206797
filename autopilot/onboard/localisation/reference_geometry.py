"""The fixed geometry that the derivatives of distances are taken at, and what bending does to distances.

Derivatives at the estimates would let distances seem to tell of what they do not, so all of a UAV's are
taken at a reference of its own time of joining, which is turned with the formation when that has turned.
"""

import numpy as np

from autopilot.onboard.localisation.batch_initialisation import SHAPE_KNOWN_M, TO_COMPLEX, Flags, laid_over
from autopilot.onboard.localisation.kernels import Array
from autopilot.onboard.localisation.uncertainty import bend, shape_variance

TURN_LIMIT_RAD = 0.2
"""The fixed geometry of the derivatives is renewed when the formation has turned by this."""


class ReferenceGeometry:
    """Reference of N UAVs.

    ``members`` (N,) are those who are located and heard of, pos_ned_m (N, 3) all estimated positions, and
    cov (5N, 5N) their covariance, laid out as `kernels` says.

    Args:
        places_ned_m: (N, 3) the formation's places, site NED.

    Attributes:
        ne_m: (N, 2) where the derivatives are taken.
        bend_m: (N, N) by how much unknown bending of the shape lengthens distances, on average.
        bend_var_m2: (N, N) variance of that.

    """

    def __init__(self, places_ned_m: Array) -> None:
        count = len(places_ned_m)
        self.ne_m = np.zeros((count, 2))
        self.bend_m = np.zeros((count, count))
        self.bend_var_m2 = np.zeros((count, count))
        self._places_ned_m = places_ned_m

    def fix(self, joining: Flags, members: Flags, pos_ned_m: Array, cov: Array) -> None:
        """Fix the geometry for those who join, who are members already.

        Where the shape is known it is that of the estimates. Else, as across a line, they are as wrong as GPS
        and with them distances would seem to tell of it: the places then tell directions better.
        """
        there_m = pos_ned_m[:, :2]
        reference_m = there_m
        if shape_std_m(pos_ned_m, cov, members) > SHAPE_KNOWN_M:
            reference_m = laid_over(self._places_ned_m, there_m, members)
        before = members & ~joining
        if before.any():
            # They keep the place and the heading of those before them.
            there, then = (m[before] @ TO_COMPLEX for m in (reference_m, self.ne_m))
            turn = np.exp(1j * np.angle(np.vdot(there - there.mean(), then - then.mean())))
            turned = (reference_m @ TO_COMPLEX - there.mean()) * turn + then.mean()
            reference_m = np.column_stack((turned.real, turned.imag))
        self.ne_m[joining] = reference_m[joining]

    def keep(self, members: Flags, pos_ned_m: Array, cov: Array) -> None:
        """Renew the geometry when the formation has turned away from it, and what bending does."""
        if members.sum() < 2:
            return
        there = pos_ned_m[members, :2] @ TO_COMPLEX
        reference = self.ne_m @ TO_COMPLEX
        then = reference[members]
        turn_rad = np.angle(np.vdot(then - then.mean(), there - there.mean()))
        if abs(turn_rad) > TURN_LIMIT_RAD:
            # Who is silent is taken along, for the time when it is heard again.
            turned = (reference - then.mean()) * np.exp(1j * turn_rad) + there.mean()
            self.ne_m[:] = np.column_stack((turned.real, turned.imag))
            self.fix(members, members, pos_ned_m, cov)
            turn_rad = 0.0
        headed = (pos_ned_m[:, :2] @ TO_COMPLEX) * np.exp(-1j * turn_rad)
        headed_m = np.column_stack((headed.real, headed.imag))
        bend(self.ne_m, headed_m, cov, np.flatnonzero(members), self.bend_m, self.bend_var_m2)


def shape_std_m(pos_ned_m: Array, cov: Array, members: Flags) -> float:
    """Horizontal rms error to expect of the members' shape, aligned; inf with fewer than two."""
    among = np.flatnonzero(members)
    if len(among) < 2:
        return float("inf")
    return float(np.sqrt(shape_variance(pos_ned_m, cov, among)))
