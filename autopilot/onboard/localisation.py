"""Cooperative localisation at one UAV: where everybody in the formation is.

A Kalman filter (`kernels`) over the offset between each UAV's odometry and its true position, and each UAV's
GPS bias. GPS of all holds the formation as a whole, the distances hold its shape. Measurements come in any
order and late; each is compared with the odometry of its own time, waits until both ends' odometry covers
that time, and is used once.

Distances alone do not tell a formation from its mirror image, and GPS errors are as large as the spacing, so
a filter that linearised about GPS could lock onto a wrong arrangement. UAVs therefore join the filter in a
batch: distances are held until enough of them are there, then solved together by Gauss-Newton iteration from
the layout of the formation's places, below which the UAVs are put on the ground. The places serve as the
starting point alone: no weight of theirs is in the result.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.kernels import (
    BIAS,
    KNOWN,
    STATES,
    Array,
    fuse_fix,
    fuse_range,
    odometry_at,
    predict,
    separation_push,
    shape_variance,
)

TRACK_SAMPLES = 64
"""Odometry samples kept per UAV: two seconds of the own ones at 30 Hz, six of a neighbour's at 10 Hz."""
CLOCK_TOLERANCE_US = 10_000
"""A time stamp may be this far in the future; beyond, it is wrong."""
PENDING_LIMIT_US = 1_000_000
"""A distance whose ends' odometry does not arrive within this is given up."""
WEIGHT_WIDTHS_M = (2.0, 1.0, 0.5, 0.25, 0.0, 0.0)
"""Extra standard deviation by which each Gauss-Newton pass judges outliers: wide at first."""
MISFIT_MEMORY = 30
"""Distances of a UAV over which the share of badly fitting ones is averaged."""
MISFIT_WEIGHT = 0.2
"""A distance that gets less weight than this fits badly: beyond about 4.6 sigma."""
MISFIT_LIMIT = 0.7
"""Above this share a UAV is not where the filter has it, and is solved for afresh. A UAV that itself
measures wrongly spoils half of the distances that it is an end of, and a seventh of another's."""
AGREE_WEIGHT, AGREE_LIMIT = 0.5, 0.3
"""A UAV does not join when more than 0.3 of its distances get less weight than 0.5 (beyond 2.4 sigma, where
1.4 % of right ones lie): a place that a bare majority agrees on exists even for distances that are all
wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalisationModel:
    """What the filter assumes of its inputs; standard deviations are one sigma."""

    gps_bias_std_m: float = 1.5
    """Per horizontal axis."""
    gps_bias_time_constant_s: float = 60.0
    gps_white_std_m: float = 0.2
    """Per horizontal axis, of one fix."""
    odometry_drift_m_sqrt_s: float = 0.1
    """Horizontal, per axis, after one second; grows with the root of time."""
    height_std_m: float = 0.2
    height_time_constant_s: float = 100.0
    range_floor_std_m: float = 0.05
    """What averaging within a session does not reduce; added in squares to what the session states."""
    gather_s: float = 2.5
    """How long distances are gathered for those who do not answer before the others are solved for."""


@dataclass(slots=True)
class _Range:
    initiator: int
    responder: int
    time_us: int
    distance_m: float
    variance_m2: float
    odometry_between_m: Array


class CooperativeLocalisation:
    """Filter over N UAVs at one of them.

    Args:
        own: index of the UAV that runs it.
        places_ned_m: (N, 3) the formation's places, site NED.
        model: noise model.

    Attributes:
        state: (5N,) and ``cov`` (5N, 5N), laid out as `kernels` says.
        located: (N,) bool, whose distances are fused.
        ranges_used, ranges_downweighted: counters.
        restarts: times that a UAV was found to be elsewhere than thought.
        own_range_us: when the newest fused distance that involves the own UAV was measured, or None.

    """

    def __init__(self, *, own: int, places_ned_m: Array, model: LocalisationModel) -> None:
        count = len(places_ned_m)
        self.own = own
        self.count = count
        self.state = np.zeros(STATES * count)
        self.cov = np.zeros((STATES * count, STATES * count))
        self.active = np.zeros(count, bool)
        self.located = np.zeros(count, bool)
        self.ranges_used = 0
        self.ranges_downweighted = 0
        self.restarts = 0
        self.own_range_us: int | None = None
        self._places_ned_m = np.array(places_ned_m, float)
        self._model = model
        self._drift_m2_s = model.odometry_drift_m_sqrt_s**2
        self._time_us = 0
        self._track_times_us = np.zeros((count, TRACK_SAMPLES), np.int64)
        self._track = np.zeros((count, TRACK_SAMPLES, 6))
        self._track_pushed = [0] * count
        self._newest = np.zeros((count, 6))
        self._newest_odometry_us = np.full(count, -1, np.int64)
        self._newest_fix_us = [-1] * count
        self._fix_less_odometry_m = np.zeros((count, 2))
        self._newest_range_us = [[-1] * count for _ in range(count)]
        self._pending: list[_Range] = []
        self._held: dict[tuple[int, int], _Range] = {}
        self._held_since_us = 0
        self._misfit = np.zeros(count)
        self._reference_ne_m = np.zeros((count, 2))

    def on_odometry(
        self, station: int, time_us: int, odometry_ned_m: Sequence[float], vel_ned_m_s: Sequence[float]
    ) -> None:
        """Take odometry of a UAV (north, east integrated velocity, down the barometer's); old is ignored."""
        if time_us <= self._newest_odometry_us[station]:
            return
        slot = self._track_pushed[station] % TRACK_SAMPLES
        self._track_times_us[station, slot] = time_us
        self._track[station, slot] = self._newest[station] = (*odometry_ned_m, *vel_ned_m_s)
        self._track_pushed[station] += 1
        self._newest_odometry_us[station] = time_us

    def on_fix(self, station: int, time_us: int, pos_ned_m: Sequence[float]) -> None:
        """Take a GPS position (site NED) at ``time_us``; used once, and only with odometry of that time."""
        if time_us <= self._newest_fix_us[station]:
            return
        odometry_m = np.empty(3)
        if self._odometry_at(station, time_us, odometry_m) != KNOWN:
            return
        self._newest_fix_us[station] = time_us
        difference_m = np.array((pos_ned_m[0] - odometry_m[0], pos_ned_m[1] - odometry_m[1]))
        self._fix_less_odometry_m[station] = difference_m
        if not self.active[station]:
            self._activate(station)
            return
        lag_s = self._advance(time_us)
        variance_m2 = self._model.gps_white_std_m**2 + self._drift_m2_s * lag_s
        fuse_fix(self.state, self.cov, station, difference_m, variance_m2)

    def on_range(
        self, initiator: int, responder: int, time_us: int, distance_m: float, std_m: float, *, now_us: int
    ) -> None:
        """Take a distance that ``initiator`` measured; told by (initiator, responder, time), and used once.

        One that is not newer than what is known of the two is ignored, as is one from the future, which would
        hide the right ones that follow, and one of which an end is no UAV of the formation.
        """
        if responder >= self.count or initiator == responder:
            return
        if not self._newest_range_us[initiator][responder] < time_us <= now_us + CLOCK_TOLERANCE_US:
            return
        self._newest_range_us[initiator][responder] = time_us
        variance_m2 = std_m**2 + self._model.range_floor_std_m**2
        self._pending.append(_Range(initiator, responder, time_us, distance_m, variance_m2, np.empty(3)))

    def update(self, now_us: int) -> None:
        """Use what has become usable by now."""
        if self._pending:
            self._pending = [item for item in self._pending if not self._take(item, now_us)]
        if self._held:
            self._locate(now_us)

    def advance(self, now_us: int) -> None:
        """Propagate the covariance to now, for whoever wants to read it."""
        self._advance(now_us)

    def offset_ne_m(self) -> Array:
        """(2,) estimated true position less odometry of the own UAV: a view, north and east."""
        base = STATES * self.own
        return self.state[base : base + 2]

    def positions_ned_m(self, now_us: int) -> Array:
        """(N, 3) estimated positions, site NED; neighbours' extrapolated by their velocity, 1 s at most."""
        offsets_m = self.state.reshape(-1, STATES)[:, :3]
        age_s = np.minimum((now_us - self._newest_odometry_us) * 1e-6, 1.0)
        positions_ned_m: Array = self._newest[:, :3] + self._newest[:, 3:] * age_s[:, None] + offsets_m
        return positions_ned_m

    def std_ned_m(self) -> Array:
        """(3,) one sigma of the own position, the formation's place as a whole included."""
        base = STATES * self.own
        return np.sqrt(self.cov.diagonal()[base : base + 3])

    def shape_std_m(self, now_us: int) -> float:
        """Horizontal rms error to expect of the located UAVs' shape, aligned; inf with fewer than two."""
        members = np.flatnonzero(self.located)
        if len(members) < 2:
            return float("inf")
        return float(np.sqrt(shape_variance(self.positions_ned_m(now_us), self.cov, members)))

    def separation_push_ne_m(
        self, now_us: int, *, radius_m: float, radius_limit_m: float, silence_us: int
    ) -> Array:
        """(2,) shift of the own setpoint that keeps it clear of neighbours heard within ``silence_us``."""
        fresh = self.located & (self._newest_odometry_us >= now_us - silence_us)
        push_ne_m = np.zeros(2)
        if self.located[self.own]:
            positions_ned_m = self.positions_ned_m(now_us)
            separation_push(self.own, positions_ned_m, self.cov, fresh, radius_m, radius_limit_m, push_ne_m)
        return push_ne_m

    def _odometry_at(self, station: int, time_us: int, out_ned_m: Array) -> int:
        pushed = self._track_pushed[station]
        times_us, samples = self._track_times_us[station], self._track[station]
        return int(odometry_at(times_us, samples, pushed, time_us, out_ned_m))

    def _advance(self, time_us: int) -> float:
        """Propagate to ``time_us`` if that is news; return how many seconds the filter is ahead of it."""
        ahead_us = self._time_us - time_us
        if ahead_us < 0:
            model = self._model
            dt_s = -ahead_us * 1e-6 if self._time_us else 0.0
            predict(
                self.state, self.cov, self.active, dt_s, self._drift_m2_s,
                model.height_std_m**2, model.height_time_constant_s,
                model.gps_bias_std_m**2, model.gps_bias_time_constant_s,
            )  # fmt: skip
            self._time_us = time_us
        return max(ahead_us, 0) * 1e-6

    def _activate(self, station: int) -> None:
        """Begin a UAV with its GPS alone: offset = fix - bias - noise, the bias at its stationary spread."""
        base = STATES * station
        bias_var_m2 = self._model.gps_bias_std_m**2
        self.state[base : base + STATES] = 0.0
        self.cov[base : base + STATES, :] = 0.0
        self.cov[:, base : base + STATES] = 0.0
        for a in range(2):
            self.state[base + a] = self._fix_less_odometry_m[station, a]
            self.cov[base + a, base + a] = bias_var_m2 + self._model.gps_white_std_m**2
            self.cov[base + BIAS + a, base + BIAS + a] = bias_var_m2
            self.cov[base + a, base + BIAS + a] = self.cov[base + BIAS + a, base + a] = -bias_var_m2
        self.cov[base + 2, base + 2] = self._model.height_std_m**2
        self.active[station] = True

    def _take(self, item: _Range, now_us: int) -> bool:
        """Use or hold a distance; False when it must wait for odometry."""
        newest_us = self._newest_odometry_us
        if item.time_us > newest_us[item.initiator] or item.time_us > newest_us[item.responder]:
            return now_us - item.time_us > PENDING_LIMIT_US
        far_m = np.empty(3)
        known = self._odometry_at(item.initiator, item.time_us, item.odometry_between_m)
        if known == KNOWN:
            known = self._odometry_at(item.responder, item.time_us, far_m)
        if known != KNOWN:
            return True
        if not (self.active[item.initiator] and self.active[item.responder]):
            return now_us - item.time_us > PENDING_LIMIT_US
        item.odometry_between_m -= far_m
        if self.located[item.initiator] and self.located[item.responder]:
            self._fuse(item)
        else:
            if not self._held:
                self._held_since_us = now_us
            self._held[item.initiator, item.responder] = item
        return True

    def _fuse(self, item: _Range) -> None:
        lag_s = self._advance(item.time_us)
        weight = fuse_range(
            self.state, self.cov, self.state, self._reference_ne_m, item.initiator, item.responder,
            item.odometry_between_m, item.distance_m, item.variance_m2 + 2.0 * self._drift_m2_s * lag_s, -1.0,
        )  # fmt: skip
        self._count(item, weight)
        for station in (item.initiator, item.responder):
            if self._misfit[station] > MISFIT_LIMIT:
                self._restart(station)

    def _count(self, item: _Range, weight: float) -> None:
        badly = weight < MISFIT_WEIGHT
        self.ranges_used += 1
        self.ranges_downweighted += badly
        for station in (item.initiator, item.responder):
            self._misfit[station] += (badly - self._misfit[station]) / MISFIT_MEMORY
        if self.own in (item.initiator, item.responder) and not badly:
            self.own_range_us = max(item.time_us, self.own_range_us or 0)

    def _locate(self, now_us: int) -> None:
        """Bring in those whose distances have been held, once enough of them are there."""
        linked = np.zeros((self.count, self.count), bool)
        for i, j in self._held:
            linked[i, j] = linked[j, i] = True
        joining = self.active & ~self.located
        complete = self.active.all() and (linked | np.eye(self.count, dtype=bool))[joining].all()
        if not complete and now_us - self._held_since_us < self._model.gather_s * 1e6:
            return
        # Three distances to others settle a point in the plane once its side of them is known from the
        # layout.
        enough = min(3, int(self.active.sum()) - 1)
        joining &= linked[:, self.active].sum(axis=1) >= enough
        held = [item for _, item in sorted(self._held.items())]
        self._held.clear()
        if held:
            self._advance(max(item.time_us for item in held))
        prior_state, prior_cov = self.state.copy(), self.cov.copy()
        while joining.any():
            members = self.located | joining
            batch = [item for item in held if members[item.initiator] and members[item.responder]]
            weights = self._solve(batch, joining, members)
            badly = np.zeros((self.count, 2))
            for item, weight in zip(batch, weights, strict=True):
                for station in (item.initiator, item.responder):
                    badly[station] += (weight < AGREE_WEIGHT, 1.0)
            contradictory = joining & (badly[:, 0] > AGREE_LIMIT * badly[:, 1])
            if not contradictory.any():
                self.located = members
                self._reference_ne_m[joining] = self.positions_ned_m(now_us)[joining, :2]
                for item, weight in zip(batch, weights, strict=True):
                    self._count(item, weight)
                return
            # Nowhere do the distances of these agree with each other: the rest is solved without them.
            joining &= ~contradictory
            self.state[:], self.cov[:] = prior_state, prior_cov

    def _solve(
        self, batch: list[_Range], joining: NDArray[np.bool_], members: NDArray[np.bool_]
    ) -> list[float]:
        """Fuse the batch by Gauss-Newton: every pass starts from the prior, expanded about the last."""
        prior_state, prior_cov = self.state.copy(), self.cov.copy()
        linearised_at = self._from_layout(joining, members)
        no_reference = np.zeros((self.count, 2))
        weights: list[float] = []
        for width_m in WEIGHT_WIDTHS_M:
            self.state[:], self.cov[:] = prior_state, prior_cov
            weights.clear()
            for item in batch:
                lag_s = (self._time_us - item.time_us) * 1e-6
                variance_m2 = item.variance_m2 + 2.0 * self._drift_m2_s * lag_s
                weight = fuse_range(
                    self.state, self.cov, linearised_at, no_reference, item.initiator, item.responder,
                    item.odometry_between_m, item.distance_m, variance_m2, width_m**2,
                )  # fmt: skip
                weights.append(weight)
            linearised_at = self.state.copy()
        return weights

    def _from_layout(self, joining: NDArray[np.bool_], members: NDArray[np.bool_]) -> Array:
        """State to start from: those who join stand as the places do, about where GPS has the whole."""
        start = self.state.copy()
        offsets_m = start.reshape(-1, STATES)
        from_places_m = self._places_ned_m[:, :2] - self._newest[:, :2]
        shift_m = (offsets_m[members, :2] - from_places_m[members]).mean(axis=0)
        offsets_m[joining, :2] = from_places_m[joining] + shift_m
        return start

    def _restart(self, station: int) -> None:
        """Forget where a UAV is thought to be, for it does not fit: back to its GPS."""
        self.restarts += 1
        self._misfit[station] = 0.0
        self.located[station] = False
        self._activate(station)
