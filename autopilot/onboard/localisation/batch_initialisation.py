"""Bringing UAVs into the localisation: their distances and GPS are solved for together.

Distances alone do not tell a formation from its mirror image, and GPS errors are as large as the spacing, so
a filter that linearised about GPS could lock onto a wrong arrangement. The distances of those who join are
held until enough are there and then solved by Gauss-Newton iteration from the layout of the formation's
places, below which the UAVs are put on the ground. No weight of the places is in the result: they are where
to start, and by them it is judged whether distances can tell the shape at all, which they cannot across a
line. Both the distances and the GPS of those who join are weighed by how they fit, widely at first.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.localisation.kernels import BIAS, STATES, STUDENT_NU, Array, fuse_range
from autopilot.onboard.localisation.uncertainty import shape_variance

WEIGHT_WIDTHS_M = (2.0, 1.0, 0.5, 0.25, *(8 * (0.0,)))
"""Extra standard deviation by which each Gauss-Newton pass judges outliers: wide at first."""
SETTLED_M = 0.01
"""The passes are over, once outliers are judged by what they are, when one moves nobody by more than this."""
AGREE_WEIGHT, AGREE_LIMIT = 0.5, 0.3
"""A UAV does not join when more than 0.3 of its distances get less weight than 0.5 (beyond 2.4 sigma, where
1.4 % of right ones lie): a place that a bare majority agrees on exists even for distances that are all
wrong."""
LIES_SHARE = 0.7
"""Share of what a UAV measured that must not agree with the rest for it to be held to measure wrongly."""
ARMIJO, LEAST_SHARE, BACKTRACKS = 1e-4, 0.1, 6
"""The share that a step must bring of the fall it promises; by how much a try is shortened at most; tries."""
LEAST_WEIGHT = 1e-3
"""A distance that has less counts for this, so that its variance stays a number."""
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
class InitialisationProblem:
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
            joining = self._linked(usable, joining, enough)
            if not joining.any():
                return None
            batch, solution = self._solve(usable, joining)
            if not (np.isfinite(solution.state).all() and np.isfinite(solution.cov).all()):
                return None
            badly = badly_fitting(batch, solution.weights, len(joining))
            contradictory = joining & ~(badly[:, 0] <= AGREE_LIMIT)
            if not contradictory.any():
                return Joined(joining, batch, solution, liars)
            liar = self._liar(usable, joining, badly, enough)
            if liar is None:
                # Nowhere do the distances of these agree with each other: the rest is solved without them.
                joining = joining & ~contradictory
            else:
                liars.add(liar)

    def _linked(self, usable: list[Range], joining: Flags, enough: int) -> Flags:
        """Those of ``joining`` who have distances to ``enough`` of each other and of those located."""
        linked = links(usable, len(joining))
        while True:
            kept: Flags = joining & (linked[:, self.located | joining].sum(axis=1) >= enough)
            if np.array_equal(kept, joining):
                return kept
            joining = kept

    def _liar(self, usable: list[Range], joining: Flags, badly: Array, enough: int) -> int | None:
        """UAV whose own distances are what does not fit; None if there is none.

        Without them all else of it fits, and to what comes of that nearly none of them does.
        """
        found, least = None, float(badly[:, 0].sum())
        for suspect in np.flatnonzero(badly[:, 1] > AGREE_LIMIT).tolist():
            without = [item for item in usable if item.initiator != suspect]
            members = self.located | joining
            if links(without, len(joining))[suspect, members].sum() < enough:
                continue
            batch, solution = self._solve(without, joining)
            left = badly_fitting(batch, solution.weights, len(joining))[:, 0]
            own = [item for item in usable if item.initiator == suspect and members[item.responder]]
            lies = [not self._weight(item, solution) >= AGREE_WEIGHT for item in own]
            if left[suspect] <= AGREE_LIMIT and sum(lies) >= LIES_SHARE * len(lies) and left.sum() < least:
                found, least = suspect, float(left.sum())
        return found

    def _weight(self, item: Range, solution: Solution) -> float:
        """Weight that a distance would get beside a solution which it has no part in."""
        no_reference = np.zeros((len(self.active), 2))
        variance_m2 = self._variance_m2(item)
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
            # The heading of the whole follows from GPS (`_agreeing`).
            layout_m = shifted_to(self.places_ned_m, there_m, members)
        start = self.state.copy()
        start.reshape(-1, STATES)[joining, :2] = (layout_m - self.odometry_ned_m[:, :2])[joining]
        solution = self._solve_from(start, batch, joining)
        if self.located.any() and not fits(batch, solution, joining):
            other = self._solve_from(self.state, batch, joining)
            solution = max(solution, other, key=lambda found: sum(found.weights))
        return batch, solution

    def _positions_ne_m(self, state: Array) -> Array:
        return np.asarray(self.odometry_ned_m[:, :2] + state.reshape(-1, STATES)[:, :2])

    def _solve_from(self, start: Array, batch: list[Range], joining: Flags) -> Solution:
        """Solve; where distances in the places do not tell the shape, they are not held to tell of it here.

        Across a line the estimates are wrong as GPS is, cut down to what the distances allow, and with their
        derivatives distances would seem to tell more. What is known is then what the places' derivatives say.
        """
        members = joining | self.located
        solution = self._iterate(start, batch, joining)
        laid_m = laid_over(self.places_ned_m, self._positions_ne_m(solution.state), members)
        in_place = solution.state.copy()
        in_place.reshape(-1, STATES)[members, :2] = (laid_m - self.odometry_ned_m[:, :2])[members]
        weighed = [
            replace(item, variance_m2=item.variance_m2 / max(weight, LEAST_WEIGHT))
            for item, weight in zip(batch, solution.weights, strict=True)
        ]
        # Nobody need be in place to the centimetre: the weights are those of before.
        told = self._pass(in_place, self._prior_cov(solution.state, joining), weighed, WEIGHT_WIDTHS_M[0])
        if shape_variance(laid_m, told.cov, np.flatnonzero(members)) < SHAPE_KNOWN_M**2:
            return solution
        return Solution(solution.state, told.cov, solution.weights)

    def _iterate(self, start: Array, batch: list[Range], joining: Flags) -> Solution:
        """Gauss-Newton: every pass starts from the prior, expanded about where the last has led."""
        at = start
        for width_m in WEIGHT_WIDTHS_M:
            prior_cov = self._prior_cov(at, joining)
            at = self._agreeing(at, prior_cov, joining)
            solution = self._pass(at, prior_cov, batch, width_m)
            step = solution.state - at
            if width_m == 0.0 and np.abs(step).max() < SETTLED_M:
                return solution
            at = at + self._share(at, step, prior_cov, batch, solution.weights, joining) * step
        return Solution(self._agreeing(at, prior_cov, joining), solution.cov, solution.weights)

    def _agreeing(self, at: Array, prior_cov: Array, joining: Flags) -> Array:
        """Turn all to where GPS has the heading, with the GPS biases that follow from where they are.

        Distances do not see a turn, so it is best at once and exactly; by steps, which are tangents, two near
        each other would turn slowly. With others located it is theirs.
        """
        at = at.copy()
        own, prior = at.reshape(-1, STATES), self.state.reshape(-1, STATES)
        if not self.located.any():
            variances_m2 = prior_cov.diagonal().reshape(-1, STATES)[joining, :2].mean(axis=1)
            there_m, gps_m = self._positions_ne_m(at)[joining], self._positions_ne_m(self.state)[joining]
            own[joining, :2] += turned_to(there_m, gps_m, 1.0 / variances_m2) - there_m
        for station in np.flatnonzero(joining).tolist():
            for a in range(2):
                off, bias = STATES * station + a, STATES * station + BIAS + a
                slope = prior_cov[bias, off] / prior_cov[off, off]
                own[station, BIAS + a] = prior[station, BIAS + a] + slope * (at[off] - self.state[off])
        return at

    def _prior_cov(self, at: Array, joining: Flags) -> Array:
        """(5N, 5N) the prior's, with GPS that is far from there believed less."""
        cov = self.cov.copy()
        for station in np.flatnonzero(joining).tolist():
            _widen_bias(cov, station, self.state, at, self.bias_var_m2.item(station))
        return cov

    def _share(
        self,
        at: Array,
        step: Array,
        prior_cov: Array,
        batch: Sequence[Range],
        weights: Sequence[float],
        joining: Flags,
    ) -> float:
        """Share of a step by which the weighted sum of squares falls: backtracking by parabolas.

        A full step goes along a tangent, far past where GPS has the heading when that shows two UAVs more
        than twice as far apart as they are, and leaves a line as bent as GPS has it. The weights are those
        at the beginning of the step, with which the sum is an upper bound of the robust cost. Armijo's
        condition; Nocedal and Wright, "Numerical optimization", section 3.5.
        """
        members = np.flatnonzero(joining | self.located)
        offsets = (STATES * members[:, np.newaxis] + np.arange(3)).ravel()
        both = np.column_stack(((at - self.state)[offsets], step[offsets]))
        prior = both.T @ np.linalg.solve(prior_cov[np.ix_(offsets, offsets)], both)
        ends = np.array([(item.initiator, item.responder) for item in batch])
        there_m, moved_m = (m.reshape(-1, STATES)[:, :3] for m in (at, step))
        between_m = np.array([item.odometry_between_m for item in batch])
        between_m += there_m[ends[:, 0]] - there_m[ends[:, 1]]
        moving_m = moved_m[ends[:, 0]] - moved_m[ends[:, 1]]
        measured_m = np.array([item.distance_m for item in batch])
        information = np.asarray(weights) / [self._variance_m2(item) for item in batch]

        def cost(share: float) -> float:
            residual_m = measured_m - np.linalg.norm(between_m + share * moving_m, axis=1)
            return float(
                prior[0, 0] + share * (2.0 * prior[0, 1] + share * prior[1, 1])
                + information @ residual_m**2
            )  # fmt: skip

        apart_m = np.maximum(np.linalg.norm(between_m, axis=1), 1e-3)
        along_m = np.sum(between_m * moving_m, axis=1) / apart_m
        slope = 2.0 * float(prior[0, 1] - information @ ((measured_m - apart_m) * along_m))
        before, share = cost(0.0), 1.0
        for _ in range(BACKTRACKS):
            rise = cost(share) - before
            if not rise > ARMIJO * slope * share:
                break
            share *= max(-0.5 * slope * share / (rise - slope * share), LEAST_SHARE)
        return share

    def _variance_m2(self, item: Range) -> float:
        """Of a distance, with what odometry has lost since."""
        return item.variance_m2 + 2e-6 * self.drift_m2_s * (self.time_us - item.time_us)

    def _pass(self, at: Array, prior_cov: Array, batch: list[Range], width_m: float) -> Solution:
        """One pass from the prior, expanded about ``at``."""
        state, cov = self.state.copy(), prior_cov.copy()
        reference_ne_m = self._positions_ne_m(at)
        weights = [
            fuse_range(
                state, cov, at, reference_ne_m, item.initiator, item.responder, item.odometry_between_m,
                item.distance_m, self._variance_m2(item), width_m**2, 1.0,
            )
            for item in batch
        ]  # fmt: skip
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


def fits(batch: Sequence[Range], solution: Solution, joining: Flags) -> bool:
    """Whether the distances of those who join agree with a solution."""
    badly = badly_fitting(batch, solution.weights, len(joining))
    return bool((badly[joining, 0] <= AGREE_LIMIT).all())


def badly_fitting(batch: Sequence[Range], weights: Sequence[float], count: int) -> Array:
    """(N, 2) share of each UAV's distances that do not agree: as either end, and of its own."""
    found = np.zeros((count, 2, 2))
    for item, weight in zip(batch, weights, strict=True):
        disagrees = (not weight >= AGREE_WEIGHT, 1.0)
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


def turned_to(pos_m: Array, there_m: Array, weights: Array) -> Array:
    """(M, 2) positions turned about their middle to lie best, weighted (M,), over others."""
    share = weights / weights.sum()
    middle_m = share @ pos_m
    here, there = (pos_m - middle_m) @ TO_COMPLEX, (there_m - share @ there_m) @ TO_COMPLEX
    turned = here * np.exp(1j * np.angle(np.vdot(here, share * there)))
    return np.asarray(np.column_stack((turned.real, turned.imag)) + middle_m)


def shifted_to(places_ned_m: Array, there_m: Array, members: Flags) -> Array:
    """(N, 2) the places shifted to where most of the members of there_m (N, 2) have them."""
    places_m = places_ned_m[:, :2]
    return np.asarray(places_m + np.median((there_m - places_m)[members], axis=0))
