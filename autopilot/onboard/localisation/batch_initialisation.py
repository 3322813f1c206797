"""Batch initialisation: solves the distances and the GPS of the UAVs that join the localisation together.

Distances alone do not distinguish a formation from its mirror image, and GPS errors are as large as the
spacing, so a filter linearised about GPS could converge to a wrong arrangement. The distances of the joining
UAVs are held until there are enough, and are then solved by Gauss-Newton iteration. It starts from the layout
of the formation's places, below which the UAVs stand on the ground. The places have no weight in the result:
they are the starting point, and decide whether distances can observe the shape at all, which they cannot
across a line. Distances and GPS of the joining UAVs are weighted by their misfit, with wide limits at first.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.localisation.kernels import BIAS, STATES, STUDENT_NU, Array, fuse_range
from autopilot.onboard.localisation.uncertainty import shape_variance

WEIGHT_WIDTHS_M = (2.0, 1.0, 0.5, 0.25, *(8 * (0.0,)))
"""Extra standard deviation of the outlier weights in each Gauss-Newton pass: wide at first."""
SETTLED_M = 0.01
"""The iteration ends when a pass without extra standard deviation moves every UAV by less than this."""
AGREE_WEIGHT, AGREE_LIMIT = 0.5, 0.3
"""A UAV does not join if more than 0.3 of its distances have a weight below 0.5 (beyond 2.4 sigma, which 1.4
% of correct ones exceed); even for wrong distances there is a position that a bare majority of them fits."""
FAULTY_SHARE = 0.7
"""A UAV is found to measure wrongly if at least this share of its distances disagrees with the rest."""
ARMIJO, LEAST_SHARE, BACKTRACKS = 1e-4, 0.1, 6
"""Line search: required share of the predicted decrease; smallest shortening factor per try; number of
tries."""
LEAST_WEIGHT = 1e-3
"""Lower limit of a distance's weight, which keeps its variance finite."""
SHAPE_KNOWN_M = 0.3
"""Expected shape error below which directions are better taken from the estimates than from the places."""
LEAST_LINKS = 3
"""Number of distances that a UAV needs to join; the layout of the places resolves a mirror ambiguity."""

TO_COMPLEX = np.array((1.0, 1.0j))
"""Factors that convert (north, east) to the complex number north + j east."""

Flags = NDArray[np.bool_]


@dataclass(slots=True)
class Range:
    """A distance to fuse; ``odometry_between_m`` (3,): odometry of initiator minus responder at its time."""

    initiator: int
    responder: int
    time_us: int
    distance_m: float
    variance_m2: float
    odometry_between_m: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """The filter's state and covariance after fusing distances, and the weight of each distance."""

    state: Array
    cov: Array
    weights: list[float]


@dataclass(frozen=True, slots=True)
class Joined:
    """Result of a batch initialisation: its distances and their solution."""

    joining: Flags
    """(N,) UAVs that have joined."""
    batch: list[Range]
    solution: Solution
    faulty: set[int]
    """UAVs that measure wrongly; their own distances were excluded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialisationProblem:
    """Prior, geometry and noise of a batch initialisation."""

    state: Array
    """(5N,) prior, with ``cov`` (5N, 5N), at ``time_us``."""
    cov: Array
    time_us: int
    active: Flags
    """(N,) UAVs with GPS and with recent odometry."""
    located: Flags
    """(N,) the active UAVs that have joined before; the prior of the others is their GPS alone."""
    places_ned_m: Array
    odometry_ned_m: Array
    """(N, 3) newest odometry, like the places."""
    drift_m2_s: float
    """Variance rate of each horizontal axis of odometry."""
    bias_var_m2: Array
    """(N,) bias variance of each UAV's GPS, per axis."""

    def join(self, held: Sequence[Range]) -> Joined | None:
        """Return the solution for all UAVs that the held distances allow to join; None if none can."""
        faulty: set[int] = set()
        joining = self.active & ~self.located
        enough = max(min(LEAST_LINKS, int(self.active.sum()) - 1), 1)
        while True:
            usable = [item for item in held if item.initiator not in faulty]
            joining = self._linked(usable, joining, enough)
            if not joining.any():
                return None
            batch, solution = self._solve(usable, joining)
            if not (np.isfinite(solution.state).all() and np.isfinite(solution.cov).all()):
                return None
            badly = badly_fitting(batch, solution.weights, len(joining))
            contradictory = joining & ~(badly[:, 0] <= AGREE_LIMIT)
            if not contradictory.any():
                return Joined(joining, batch, solution, faulty)
            suspect = self._faulty_initiator(usable, joining, badly, enough)
            if suspect is None:
                # No position fits the distances of these UAVs: the rest is solved without them.
                joining = joining & ~contradictory
            else:
                faulty.add(suspect)

    def _linked(self, usable: list[Range], joining: Flags, enough: int) -> Flags:
        """Return the UAVs of ``joining`` with distances to ``enough`` of each other and of the located."""
        linked = links(usable, len(joining))
        while True:
            kept: Flags = joining & (linked[:, self.located | joining].sum(axis=1) >= enough)
            if np.array_equal(kept, joining):
                return kept
            joining = kept

    def _faulty_initiator(self, usable: list[Range], joining: Flags, badly: Array, enough: int) -> int | None:
        """Return the UAV that measures wrongly; None if there is none.

        Without its own distances all others of it fit, and nearly none of its own fits that solution.
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
            misfits = [not self._weight(item, solution) >= AGREE_WEIGHT for item in own]
            if (
                left[suspect] <= AGREE_LIMIT
                and sum(misfits) >= FAULTY_SHARE * len(misfits)
                and left.sum() < least
            ):
                found, least = suspect, float(left.sum())
        return found

    def _weight(self, item: Range, solution: Solution) -> float:
        """Return the weight of a distance relative to a solution that does not include it."""
        no_reference = np.zeros((len(self.active), 2))
        return float(fuse_range(
            solution.state, solution.cov, solution.state, no_reference, item.initiator, item.responder,
            item.odometry_between_m, item.distance_m, self._variance_m2(item), -1.0, 0.0,
        ))  # fmt: skip

    def _solve(self, usable: list[Range], joining: Flags) -> tuple[list[Range], Solution]:
        """Solve from the layout of the places; if that does not fit and UAVs are located, also from GPS."""
        members = self.located | joining
        batch = [item for item in usable if members[item.initiator] and members[item.responder]]
        there_m = self._positions_ne_m(self.state)
        if self.located.sum() >= 2:
            layout_m = laid_over(self.places_ned_m, there_m, self.located)
        else:
            # GPS determines the heading of the whole (`_aligned_to_gps`).
            layout_m = shifted_to(self.places_ned_m, there_m, members)
        start = self.state.copy()
        start.reshape(-1, STATES)[joining, :2] = (layout_m - self.odometry_ned_m[:, :2])[joining]
        solution = self._solve_from(start, batch, joining)
        badly = badly_fitting(batch, solution.weights, len(joining))
        if self.located.any() and not (badly[joining, 0] <= AGREE_LIMIT).all():
            other = self._solve_from(self.state, batch, joining)
            solution = max(solution, other, key=lambda found: sum(found.weights))
        return batch, solution

    def _positions_ne_m(self, state: Array) -> Array:
        return np.asarray(self.odometry_ned_m[:, :2] + state.reshape(-1, STATES)[:, :2])

    def _solve_from(self, start: Array, batch: list[Range], joining: Flags) -> Solution:
        """Solve from ``start``; where the places' distances do not observe the shape, use their covariance.

        Across a line the estimates have GPS errors, within the limits of the distances. Derivatives at such
        estimates would give the distances too much information, so the covariance is that at the places.
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
        # The UAVs need not be exactly at their places, so the weights of the solution are kept.
        at_places = self._pass(
            in_place, self._prior_cov(solution.state, joining), weighed, WEIGHT_WIDTHS_M[0]
        )
        if shape_variance(laid_m, at_places.cov, np.flatnonzero(members)) < SHAPE_KNOWN_M**2:
            return solution
        return Solution(solution.state, at_places.cov, solution.weights)

    def _iterate(self, start: Array, batch: list[Range], joining: Flags) -> Solution:
        """Run Gauss-Newton passes, each from the prior and linearised at the previous result."""
        at = start
        for width_m in WEIGHT_WIDTHS_M:
            prior_cov = self._prior_cov(at, joining)
            at = self._aligned_to_gps(at, prior_cov, joining)
            solution = self._pass(at, prior_cov, batch, width_m)
            step = solution.state - at
            if width_m == 0.0 and np.abs(step).max() < SETTLED_M:
                return solution
            at = at + self._share(at, step, prior_cov, batch, solution.weights, joining) * step
        return Solution(self._aligned_to_gps(at, prior_cov, joining), solution.cov, solution.weights)

    def _aligned_to_gps(self, at: Array, prior_cov: Array, joining: Flags) -> Array:
        """Return the state turned to the heading that GPS gives, with the GPS biases of these positions.

        Distances do not observe a turn, so the whole turn is made exactly and at once; tangential steps would
        turn two close UAVs slowly only. If UAVs are located, their heading is kept.
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
        """Return the prior covariance; as by a Student-t likelihood, biases far from ``at`` are wider."""
        cov = self.cov.copy()
        for station in np.flatnonzero(joining).tolist():
            bias_var_m2 = self.bias_var_m2.item(station)
            for a in range(2):
                off = STATES * station + a
                bias = off + BIAS
                excess = (self.state[off] - at[off]) ** 2 / bias_var_m2
                widening_m2 = bias_var_m2 * max((STUDENT_NU + excess) / (STUDENT_NU + 1.0) - 1.0, 0.0)
                cov[off, off] += widening_m2
                cov[bias, bias] += widening_m2
                cov[off, bias] -= widening_m2
                cov[bias, off] -= widening_m2
        return cov

    def _share(
        self, at: Array, step: Array, prior_cov: Array, batch: Sequence[Range], weights: Sequence[float],
        joining: Flags,
    ) -> float:  # fmt: skip
        """Return the share of a step that decreases the weighted sum of squares: backtracking by parabolas.

        A full step follows a tangent: it overshoots the heading of GPS if GPS shows two UAVs more than twice
        as far apart as they are. For the weights at the beginning of the step the sum is an upper bound of
        the robust cost. Armijo's condition: Nocedal and Wright, "Numerical optimization", section 3.5.
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
        """Return the variance of a distance, including the drift of odometry since its time."""
        return item.variance_m2 + 2e-6 * self.drift_m2_s * (self.time_us - item.time_us)

    def _pass(self, at: Array, prior_cov: Array, batch: list[Range], width_m: float) -> Solution:
        """Return the result of one pass from the prior, linearised at ``at``."""
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


def badly_fitting(batch: Sequence[Range], weights: Sequence[float], count: int) -> Array:
    """Return (N, 2) the share of each UAV's distances that disagree: as either end, and as initiator."""
    found = np.zeros((count, 2, 2))
    for item, weight in zip(batch, weights, strict=True):
        disagrees = (not weight >= AGREE_WEIGHT, 1.0)
        found[item.initiator, 0] += disagrees
        found[item.initiator, 1] += disagrees
        found[item.responder, 0] += disagrees
    shares: Array = found[:, :, 0] / np.maximum(found[:, :, 1], 1.0)
    return shares


def links(items: Iterable[Range], count: int) -> Flags:
    """Return (N, N), symmetric: whether there is a distance between two UAVs."""
    linked = np.zeros((count, count), bool)
    for item in items:
        linked[item.initiator, item.responder] = linked[item.responder, item.initiator] = True
    return linked


def laid_over(places_ned_m: Array, there_m: Array, members: Flags) -> Array:
    """Return (N, 2) the places (N, 3) turned and shifted to fit the members of there_m (N, 2) best."""
    middle_m = there_m[members].mean(axis=0)
    places = places_ned_m[:, :2] - places_ned_m[members, :2].mean(axis=0)
    there, here = (there_m[members] - middle_m) @ TO_COMPLEX, places[members] @ TO_COMPLEX
    laid = (places @ TO_COMPLEX) * np.exp(1j * np.angle(np.vdot(here, there)))
    return np.asarray(np.column_stack((laid.real, laid.imag)) + middle_m)


def turned_to(pos_m: Array, there_m: Array, weights: Array) -> Array:
    """Return (M, 2) positions turned about their weighted mean to fit there_m (M, 2) best; weights (M,)."""
    share = weights / weights.sum()
    middle_m = share @ pos_m
    here, there = (pos_m - middle_m) @ TO_COMPLEX, (there_m - share @ there_m) @ TO_COMPLEX
    turned = here * np.exp(1j * np.angle(np.vdot(here, share * there)))
    return np.asarray(np.column_stack((turned.real, turned.imag)) + middle_m)


def shifted_to(places_ned_m: Array, there_m: Array, members: Flags) -> Array:
    """Return (N, 2) the places shifted by the median offset of the members of there_m (N, 2)."""
    places_m = places_ned_m[:, :2]
    return np.asarray(places_m + np.median((there_m - places_m)[members], axis=0))
