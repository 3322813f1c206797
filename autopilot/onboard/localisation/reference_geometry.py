"""The fixed geometry at which distances are linearised, and the effect of bending on distances.

Derivatives at the newest estimates would give distances information that they do not hold (see `kernels`).
All derivatives of a UAV are therefore taken at a reference fixed when it joined, which is turned when the
formation has turned.
"""

import numpy as np

from autopilot.onboard.localisation.batch_initialisation import SHAPE_KNOWN_M, TO_COMPLEX, Flags, laid_over
from autopilot.onboard.localisation.kernels import Array
from autopilot.onboard.localisation.uncertainty import bend, shape_variance

TURN_LIMIT_RAD = 0.2
"""Turn of the formation at which the reference is renewed."""


class ReferenceGeometry:
    """Reference of N UAVs with places (N, 3), site NED.

    ``members`` (N,) are the located UAVs that are present, pos_ned_m (N, 3) all estimated positions, and
    cov (5N, 5N) their covariance with the layout of `kernels`.
    """

    def __init__(self, places_ned_m: Array) -> None:
        count = len(places_ned_m)
        self.ne_m = np.zeros((count, 2))
        """Positions at which the derivatives are taken."""
        self.bend_m, self.bend_var_m2 = np.zeros((2, count, count))
        """Mean lengthening of distances by an unknown bending of the shape, and its variance."""
        self._places_ned_m = places_ned_m

    def fix(self, joining: Flags, members: Flags, pos_ned_m: Array, cov: Array) -> None:
        """Set the reference of the UAVs that join, which must already be members.

        If the shape is known, it is that of the estimates. Otherwise, as across a line, the estimates have
        GPS errors, and the directions between the places are better.
        """
        there_m = pos_ned_m[:, :2]
        reference_m = there_m
        if shape_std_m(pos_ned_m, cov, members) > SHAPE_KNOWN_M:
            reference_m = laid_over(self._places_ned_m, there_m, members)
        before = members & ~joining
        if before.any():
            # Align the new reference to the position and heading of the earlier members.
            there, then = (m[before] @ TO_COMPLEX for m in (reference_m, self.ne_m))
            turn = np.exp(1j * np.angle(np.vdot(there - there.mean(), then - then.mean())))
            turned = (reference_m @ TO_COMPLEX - there.mean()) * turn + then.mean()
            reference_m = np.column_stack((turned.real, turned.imag))
        self.ne_m[joining] = reference_m[joining]

    def keep(self, members: Flags, pos_ned_m: Array, cov: Array) -> None:
        """Renew the reference if the formation has turned from it, and update the effect of bending."""
        if members.sum() < 2:
            return
        there = pos_ned_m[members, :2] @ TO_COMPLEX
        reference = self.ne_m @ TO_COMPLEX
        then = reference[members]
        turn_rad = np.angle(np.vdot(then - then.mean(), there - there.mean()))
        if abs(turn_rad) > TURN_LIMIT_RAD:
            # Silent UAVs are turned along, so that their reference is valid when they return.
            turned = (reference - then.mean()) * np.exp(1j * turn_rad) + there.mean()
            self.ne_m[:] = np.column_stack((turned.real, turned.imag))
            self.fix(members, members, pos_ned_m, cov)
            turn_rad = 0.0
        headed = (pos_ned_m[:, :2] @ TO_COMPLEX) * np.exp(-1j * turn_rad)
        headed_m = np.column_stack((headed.real, headed.imag))
        bend(self.ne_m, headed_m, cov, np.flatnonzero(members), self.bend_m, self.bend_var_m2)


def shape_std_m(pos_ned_m: Array, cov: Array, members: Flags) -> float:
    """Return the expected horizontal rms shape error of the members, aligned; inf with fewer than two."""
    among = np.flatnonzero(members)
    if len(among) < 2:
        return float("inf")
    return float(np.sqrt(shape_variance(pos_ned_m, cov, among)))
