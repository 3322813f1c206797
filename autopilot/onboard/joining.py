"""Bringing UAVs into the localisation: their distances and GPS are solved for together.

Distances alone do not tell a formation from its mirror image, and GPS errors are as large as the spacing, so
a filter that linearised about GPS could lock onto a wrong arrangement. The distances of those who join are
held until enough are there and then solved by Gauss-Newton iteration from the layout of the formation's
places, below which the UAVs are put on the ground. The places serve as the starting point alone: no weight
of theirs is in the result. Both the distances and the GPS of those who join are weighed by how they fit,
widely at first.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.kernels import BIAS, STATES, STUDENT_NU, Array, fuse_range
from autopilot.onboard.uncertainty import bend, shape_variance

WEIGHT_WIDTHS_M = (2.0, 1.0, 0.5, 0.25, 0.0, 0.0)
"""Extra standard deviation by which each Gauss-Newton pass judges outliers: wide at first."""
AGREE_WEIGHT, AGREE_LIMIT = 0.5, 0.3
"""A UAV does not join when more than 0.3 of its distances get less weight than 0.5 (beyond 2.4 sigma, where
1.4 % of right ones lie): a place that a bare majority agrees on exists even for distances that are all
wrong."""
LIES_SHARE = 0.7
"""Share of what a UAV measured that must not agree with the rest for it to be held to measure wrongly."""
BEND_MATTERS_M = 0.02
"""Where `bend` lengthens no distance by more than this, the batch is not solved again with it."""
SHAPE_KNOWN_M = 0.3
"""Shape error to expect below which the estimates tell directions better than the places do."""
LEAST_LINKS = 3
"""Distances to others settle a point in the plane once its side of them is known from the layout."""

TO_COMPLEX = np.array((1.0, 1.0j))
"""Makes north + j east of them."""

Flags = NDArray[np.bool_]


@dataclass(slots=True)
class Range:
    """A distance on its way into the filter; ``odometry_between_m`` (3,) is that of its time."""

    initiator: int
    responder: int
    time_us: int
    distance_m: float
    variance_m2: float
    odometry_between_m: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """What distances lead to: the filter's arrays after them, and the weight of each."""

    state: Array
    cov: Array
    weights: list[float]


@dataclass(frozen=True, slots=True)
class Joined:
    """Who has joined, by what."""

    joining: Flags
    """(N,)"""
    batch: list[Range]
    solution: Solution
    liars: set[int]
    """Whose own distances were left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """What there is to solve."""

    state: Array
    """(5N,) prior, with ``cov`` (5N, 5N), at ``time_us``."""
    cov: Array
    time_us: int
    active: Flags
    """(N,) those of whom there is GPS and who are heard of."""
    located: Flags
    """(N,) those of them who have joined before; the prior of the others consists of their GPS alone."""
    places_ned_m: Array
    """(N, 3)"""
    odometry_ned_m: Array
    """(N, 3) the newest."""
    drift_m2_s: float
    """Of each axis of odometry."""
    bias_var_m2: Array
    """(N,) of each UAV's GPS, per axis."""

    def join(self, held: Sequence[Range]) -> Joined | None:
        """Bring in whom the distances held allow to; None if nobody.

        Who measures wrongly is told from others that contradict themselves by leaving its own distances out.
        """
        liars: set[int] = set()
        joining = self.active & ~self.located
        enough = max(min(LEAST_LINKS, int(self.active.sum()) - 1), 1)
        while True:
            usable = [item for item in held if item.initiator not in liars]
            joining &= links(usable, len(joining))[:, self.active].sum(axis=1) >= enough
            if not joining.any():
                return None
            batch, solution = self._solve(usable, joining)
            badly = badly_fitting(batch, solution.weights, len(joining))
            contradictory = joining & (badly[:, 0] > AGREE_LIMIT)
            if not contradictory.any():
                return Joined(joining, batch, solution, liars)
            liar = self._liar(usable, joining, badly, enough)
            if liar is None:
                # Nowhere do the distances of these agree with each other: the rest is solved without them.
                joining &= ~contradictory
            else:
                liars.add(liar)

    def _liar(self, usable: list[Range], joining: Flags, badly: Array, enough: int) -> int | None:
        """UAV whose own distances are what does not fit; None if there is none.

        Without them all else of it fits, and to what comes of that nearly none of them does.
        """
        found, least = None, float(badly[:, 0].sum())
        for suspect in np.flatnonzero(badly[:, 1] > AGREE_LIMIT).tolist():
            without = [item for item in usable if item.initiator != suspect]
            if links(without, len(joining))[suspect, self.active].sum() < enough:
                continue
            batch, solution = self._solve(without, joining)
            left = badly_fitting(batch, solution.weights, len(joining))[:, 0]
            members = self.located | joining
            own = [item for item in usable if item.initiator == suspect and members[item.responder]]
            lies = [self._weight(item, solution) < AGREE_WEIGHT for item in own]
            if left[suspect] <= AGREE_LIMIT and sum(lies) >= LIES_SHARE * len(lies) and left.sum() < least:
                found, least = suspect, float(left.sum())
        return found

    def _weight(self, item: Range, solution: Solution) -> float:
        """Weight that a distance would get beside a solution which it has no part in."""
        no_reference = np.zeros((len(self.active), 2))
        variance_m2 = item.variance_m2 + 2e-6 * self.drift_m2_s * (self.time_us - item.time_us)
        return float(
            fuse_range(
                solution.state, solution.cov, solution.state, no_reference, item.initiator, item.responder,
                item.odometry_between_m, item.distance_m, variance_m2, -1.0, 0.0,
            )
        )  # fmt: skip

    def _solve(self, usable: list[Range], joining: Flags) -> tuple[list[Range], Solution]:
        """Solve from the layout; if that fails, and others are located, from where GPS is."""
        members = self.located | joining
        batch = [item for item in usable if members[item.initiator] and members[item.responder]]
        there_m = self._positions_ne_m(self.state)
        if self.located.sum() >= 2:
            layout_m = laid_over(self.places_ned_m, there_m, self.located)
        else:
            # GPS has no say in the heading of the whole, which the layout knows better.
            layout_m = shifted_to(self.places_ned_m, there_m, members)
        start = self.state.copy()
        start.reshape(-1, STATES)[joining, :2] = (layout_m - self.odometry_ned_m[:, :2])[joining]
        solution = self._solve_from(start, batch, joining)
        badly = badly_fitting(batch, solution.weights, len(joining))[:, 0]
        if self.located.any() and (badly[joining] > AGREE_LIMIT).any():
            other = self._solve_from(self.state, batch, joining)
            solution = max(solution, other, key=lambda found: sum(found.weights))
        return batch, solution

    def _positions_ne_m(self, state: Array) -> Array:
        return np.asarray(self.odometry_ned_m[:, :2] + state.reshape(-1, STATES)[:, :2])

    def _solve_from(self, start: Array, batch: list[Range], joining: Flags) -> Solution:
        """Solve with the derivatives of the places; then, if that knows the shape, with the estimates' own.

        Across a line the estimates are as wrong as GPS, and with their derivatives distances would seem to
        tell of it.
        """
        members = joining | self.located
        among = np.flatnonzero(members)
        bend_m = np.zeros((len(joining), len(joining)))
        solution = self._iterate(start, batch, joining, bend_m, places=True)
        there_m = self._positions_ne_m(solution.state)
        bend(there_m, solution.cov, among, bend_m)
        known = shape_variance(there_m, solution.cov, among) < SHAPE_KNOWN_M**2
        if known or bend_m.max() > BEND_MATTERS_M:
            solution = self._iterate(solution.state, batch, joining, bend_m, places=not known)
        return solution

    def _iterate(
        self, start: Array, batch: list[Range], joining: Flags, bend_m: Array, *, places: bool
    ) -> Solution:
        """Gauss-Newton: every pass starts from the prior, expanded about the last.

        With ``places`` the derivatives are those of the places, laid over where the last pass has everybody.
        """
        linearised_at = start
        weights: list[float] = []
        state, cov = self.state, self.cov
        members = joining | self.located
        for width_m in WEIGHT_WIDTHS_M:
            state, cov = self.state.copy(), self.cov.copy()
            weights = []
            for station in np.flatnonzero(joining).tolist():
                _widen_bias(cov, station, self.state, linearised_at, self.bias_var_m2.item(station))
            reference_ne_m = self._positions_ne_m(linearised_at)
            if places:
                reference_ne_m = laid_over(self.places_ned_m, reference_ne_m, members)
            for item in batch:
                longer_m = bend_m.item(item.initiator, item.responder)
                lag_s = (self.time_us - item.time_us) * 1e-6
                weight = fuse_range(
                    state, cov, linearised_at, reference_ne_m, item.initiator, item.responder,
                    item.odometry_between_m, item.distance_m - longer_m,
                    item.variance_m2 + 2.0 * (self.drift_m2_s * lag_s + longer_m**2), width_m**2, 1.0,
                )  # fmt: skip
                weights.append(weight)
            linearised_at = state.copy()
        return Solution(state, cov, weights)


def _widen_bias(cov: Array, station: int, prior: Array, linearised_at: Array, bias_var_m2: float) -> None:
    """Give a GPS that is far from where the iteration is a wider bias, as a Student-t likelihood would."""
    for a in range(2):
        off = STATES * station + a
        excess = (prior[off] - linearised_at[off]) ** 2 / bias_var_m2
        widening_m2 = bias_var_m2 * max((STUDENT_NU + excess) / (STUDENT_NU + 1.0) - 1.0, 0.0)
        bias = off + BIAS
        cov[off, off] += widening_m2
        cov[bias, bias] += widening_m2
        cov[off, bias] -= widening_m2
        cov[bias, off] -= widening_m2


def badly_fitting(batch: Sequence[Range], weights: Sequence[float], count: int) -> Array:
    """(N, 2) share of each UAV's distances that do not agree: as either end, and of its own."""
    found = np.zeros((count, 2, 2))
    for item, weight in zip(batch, weights, strict=True):
        disagrees = (weight < AGREE_WEIGHT, 1.0)
        found[item.initiator, 0] += disagrees
        found[item.initiator, 1] += disagrees
        found[item.responder, 0] += disagrees
    shares: Array = found[:, :, 0] / np.maximum(found[:, :, 1], 1.0)
    return shares


def links(items: Iterable[Range], count: int) -> Flags:
    """(N, N) symmetric: between whom there are distances."""
    linked = np.zeros((count, count), bool)
    for item in items:
        linked[item.initiator, item.responder] = linked[item.responder, item.initiator] = True
    return linked


def laid_over(places_ned_m: Array, there_m: Array, members: Flags) -> Array:
    """(N, 2) the places (N, 3) turned and shifted to lie best over the members of there_m (N, 2)."""
    middle_m = there_m[members].mean(axis=0)
    places = places_ned_m[:, :2] - places_ned_m[members, :2].mean(axis=0)
    there, here = (there_m[members] - middle_m) @ TO_COMPLEX, places[members] @ TO_COMPLEX
    laid = (places @ TO_COMPLEX) * np.exp(1j * np.angle(np.vdot(here, there)))
    return np.asarray(np.column_stack((laid.real, laid.imag)) + middle_m)


def shifted_to(places_ned_m: Array, there_m: Array, members: Flags) -> Array:
    """(N, 2) the places shifted to where most of the members of there_m (N, 2) have them."""
    places_m = places_ned_m[:, :2]
    return np.asarray(places_m + np.median((there_m - places_m)[members], axis=0))
