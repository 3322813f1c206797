"""Cooperative localisation at one UAV: where everybody in the formation is.

A Kalman filter (`kernels`) over the offset between each UAV's odometry and its true position, and each UAV's
GPS bias. GPS of all holds the formation as a whole, the distances hold its shape. Measurements come in any
order and late; each is compared with the odometry of its own time, waits until both ends' odometry covers
that time, and is used once. UAVs join the filter in a batch (`joining`), for it must begin near the truth.

Against what is wrong: every measurement's weight falls with its misfit; a UAV whose distances all misfit is
solved for afresh, as is on trial one of which some misfit for long, and one that only measures wrongly is
not listened to (`trust`); who is silent has no part in the geometry; a GPS whose error is estimated beyond
what its receiver states is taken to have errors of that size, and after a step of it they are estimated anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from autopilot.onboard.beacon import Distance
from autopilot.onboard.fixes import GROUP_US, FixGroup, FixMean
from autopilot.onboard.joining import (
    SHAPE_KNOWN_M,
    TO_COMPLEX,
    Flags,
    Joined,
    Problem,
    Range,
    laid_over,
    links,
)
from autopilot.onboard.kernels import (
    BIAS,
    KNOWN,
    STATES,
    Array,
    fuse_fix,
    fuse_range,
    predict,
    relearn_bias,
)
from autopilot.onboard.tracks import Tracks
from autopilot.onboard.trust import Trust
from autopilot.onboard.uncertainty import bend, relative_stds, relative_variance, shape_variance

CLOCK_TOLERANCE_US = 10_000
"""A time stamp may be this far in the future; beyond, it is wrong."""
PENDING_LIMIT_US = 1_000_000
"""A distance whose ends' odometry does not arrive within this is given up."""
SILENCE_US = 3_000_000
"""Who has not been heard of for this long is not waited for, and has no part in the geometry."""
LOST_US = 30_000_000
"""Who returns after this long is solved for afresh: its odometry has lost half a metre or more, and with so
much a few distances may be fitted by a mirror image."""
DECAY_SHARE = 0.01
"""Of the shortest time constant: the stride in which slow errors are propagated."""
MISFIT_WEIGHT = 0.2
"""A distance that gets less weight than this fits badly: beyond about 4.6 sigma."""
JUMP_SHARE = 0.1
"""Standard deviation of a jump of odometry, by its size."""
PULLED_STD_M = 1.0
"""By how much a UAV may be misplaced that has just been found to measure wrongly."""
STEP_FIXES = 3
"""So many means of fixes in succession that fit badly are a step of GPS."""
BIAS_SIGMAS = 2.0
"""A GPS bias that is estimated beyond this has a larger spread than its receiver states."""
TURN_LIMIT_RAD = 0.2
"""The fixed geometry of the derivatives is renewed when the formation has turned by this."""
GEOMETRY_PERIOD_US = 1_000_000
"""How often that is looked at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalisationModel:
    """What the filter assumes of its inputs; standard deviations are one sigma."""

    gps_bias_std_m: float = 1.5
    """Per horizontal axis; a receiver that states a worse accuracy is taken at its word."""
    gps_bias_vertical_std_m: float = 2.5
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


class Others(NamedTuple):
    """All N UAVs as one of them has them now; rows in their order, the own one included."""

    pos_ned_m: Array
    """(N, 3) site NED."""
    vel_ned_m_s: Array
    """(N, 3)"""
    std_m: Array
    """(N,) one sigma of the position relative to the own, horizontally, along the line."""
    fresh: Flags
    """(N,) bool: located, and heard of lately."""


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
        odometry_jumps: times that a UAV's odometry has begun anew, by its own step or as told by `restart`.
        gps_steps: times that a GPS error was found to have changed at once.
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
        self.odometry_jumps = 0
        self.gps_steps = 0
        self.own_range_us: int | None = None
        self._places_ned_m = np.array(places_ned_m, float)
        self._model = model
        self._drift_m2_s = model.odometry_drift_m_sqrt_s**2
        self._floor_m2 = model.range_floor_std_m**2
        self._time_us = 0
        self._decay_owed_us = 0
        self._decay_stride_us = int(
            1e6 * DECAY_SHARE * min(model.gps_bias_time_constant_s, model.height_time_constant_s)
        )
        self._tracks = Tracks(count)
        self._newest_fix_us = [-1] * count
        self._fixes = [FixGroup() for _ in range(count)]
        self._fix_less_odometry_m = np.zeros((count, 3))
        self._bad_fixes = [0] * count
        self._stated_var_m2 = np.full(count, model.gps_bias_std_m**2)
        self._stated_vertical_var_m2 = np.full(count, model.gps_bias_vertical_std_m**2)
        self._bias_var_m2 = self._stated_var_m2.copy()
        self._newest_range_us = [[-1] * count for _ in range(count)]
        self._pending: list[Range] = []
        self._held: dict[tuple[int, int], Range] = {}
        self._held_since_us = 0
        self._fused: dict[tuple[int, int], Range] = {}
        """The newest of each pair, to solve again should it not fit."""
        self._trust = Trust(count)
        self._reference_ne_m = np.zeros((count, 2))
        self._bend_m = np.zeros((count, count))
        self._geometry_due_us = 0
        self._returned = False
        """Whether somebody has been heard of again since the geometry was last looked at."""
        self._distances_hz = 0.0
        """Of one UAV, either end."""
        self._counted = 0
        self._scratch_m = np.empty(3)

    def on_odometry(
        self, station: int, time_us: int, odometry_ned_m: Sequence[float], vel_ned_m_s: Sequence[float]
    ) -> None:
        """Take odometry of a UAV (north, east integrated velocity, down the barometer's); old is ignored."""
        silent_us = time_us - self._tracks.newest_us.item(station)
        if silent_us > SILENCE_US:
            self._returned = True
            if silent_us > LOST_US and self.located[station]:
                self._lose(station)
        jump = self._tracks.push(station, time_us, odometry_ned_m, vel_ned_m_s)
        if jump is not None and self.active[station]:
            # The UAV has not jumped: its odometry has begun anew.
            self.odometry_jumps += 1
            self._fixes[station] = FixGroup()
            self._drop_distances(station)
            for a, jump_m in enumerate(jump):
                self.state[STATES * station + a] -= jump_m
                self.cov[STATES * station + a, STATES * station + a] += (JUMP_SHARE * jump_m) ** 2

    def on_fix(
        self,
        station: int,
        time_us: int,
        pos_ned_m: Sequence[float],
        std_h_m: float | None = None,
        std_v_m: float | None = None,
    ) -> None:
        """Take a GPS position (site NED) at ``time_us``; used once, and only with odometry of that time.

        ``std_h_m`` (per axis) and ``std_v_m`` are what the receiver states; None: nothing.
        """
        if time_us <= self._newest_fix_us[station]:
            return
        odometry_m = self._scratch_m
        if self._tracks.at(station, time_us, odometry_m) != KNOWN:
            return
        self._newest_fix_us[station] = time_us
        if std_h_m is not None or std_v_m is not None:
            self._take_stated(station, std_h_m or 0.0, std_v_m or 0.0)
        mean = self._fixes[station].add(
            time_us, pos_ned_m, odometry_m.tolist(), at_once=not self.active[station]
        )
        if mean is not None:
            self._fuse_fixes(station, time_us, mean)

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
        variance_m2 = std_m**2 + self._floor_m2
        self._pending.append(Range(initiator, responder, time_us, distance_m, variance_m2, np.empty(3)))

    def on_distances(self, initiator: int, distances: Sequence[Distance], *, now_us: int) -> None:
        """Take all that a beacon of ``initiator`` tells, as `on_range` does one by one, in less time."""
        newest_us = self._newest_range_us[initiator]
        for item in distances:
            if item.peer < self.count and newest_us[item.peer] < item.time_ms * 1_000:
                self.on_range(
                    initiator, item.peer, item.time_ms * 1_000, item.distance_m, item.std_m, now_us=now_us
                )

    def restart(self, station: int) -> None:
        """Forget a UAV whose application has begun anew: its odometry counts from elsewhere since.

        To be told before that odometry. It is brought in again once there are GPS and distances of it.
        """
        self.odometry_jumps += 1
        self._lose(station)

    def update(self, now_us: int) -> None:
        """Use what has become usable by now."""
        due = now_us >= self._geometry_due_us
        if due or self._returned:
            self._returned = False
            self._keep_geometry(now_us)
        if self._pending:
            self._pending = [item for item in self._pending if not self._take(item, now_us)]
        if self._held:
            self._locate(now_us)
        if due:
            self._geometry_due_us = now_us + GEOMETRY_PERIOD_US
            self._distances_hz = 2e6 * (self.ranges_used - self._counted) / (self.count * GEOMETRY_PERIOD_US)
            self._counted = self.ranges_used
            suspects = self._trust.suspects(now_us, np.flatnonzero(self.located & self._present(now_us)))
            if suspects:
                self._try_afresh(suspects, now_us)

    def advance(self, now_us: int) -> None:
        """Propagate the covariance to now, for whoever wants to read it."""
        self._advance(now_us, decay=True)

    def offset_ne_m(self) -> Array:
        """(2,) estimated true position less odometry of the own UAV: a view, north and east."""
        base = STATES * self.own
        return self.state[base : base + 2]

    def offset_ned_m(self) -> Array:
        """(3,) the same with down: less the barometer's height; a view."""
        base = STATES * self.own
        return self.state[base : base + 3]

    def positions_ned_m(self, now_us: int) -> Array:
        """(N, 3) estimated positions, site NED; neighbours' extrapolated by their velocity, 1 s at most."""
        return self._tracks.now_ned_m(now_us) + self.state.reshape(-1, STATES)[:, :3]

    def std_ned_m(self) -> Array:
        """(3,) one sigma of the own position, the formation's place as a whole included."""
        base = STATES * self.own
        return np.sqrt(self.cov.diagonal()[base : base + 3])

    def gps_error(self, station: int) -> tuple[Array, float]:
        """Estimated error of a UAV's GPS, (3,) NED, m, and one sigma of each horizontal axis of it.

        Horizontally the slow part alone; vertically that of the last fixes, against the barometer.
        """
        base = STATES * station
        error_ned_m = np.zeros(3)
        error_ned_m[:2] = self.state[base + BIAS : base + STATES]
        if self.active[station]:
            error_ned_m[2] = self._fix_less_odometry_m[station, 2] - self.state[base + 2]
            variance = self.cov[base + BIAS, base + BIAS] + self.cov[base + BIAS + 1, base + BIAS + 1]
        else:
            variance = 2.0 * self._stated_var_m2[station]
        return error_ned_m, float(np.sqrt(0.5 * variance))

    def distance_variance_m2(self, peer: int, now_us: int) -> float | None:
        """Variance with which the distance to a UAV is known now; None while either end is not located."""
        if not (self.located[self.own] and self.located[peer]):
            return None
        tracks, offsets_m = self._tracks, self.state.reshape(-1, STATES)
        line_m = tracks.newest[self.own, :3] - tracks.newest[peer, :3]
        line_m += offsets_m[self.own, :3] - offsets_m[peer, :3]
        if not line_m.any():
            line_m[0] = 1.0
        return float(relative_variance(self.cov, self.own, peer, line_m)) + self._walked_m2(now_us)

    def others(self, now_us: int, *, fresh_us: int) -> Others:
        """Everybody, as avoidance wants them; fresh is who was heard within ``fresh_us``."""
        fresh = self.located & (self._tracks.newest_us >= now_us - fresh_us)
        pos_ned_m = self.positions_ned_m(now_us)
        std_m = np.empty(self.count)
        relative_stds(self.cov, self.own, pos_ned_m, fresh, self._walked_m2(now_us), std_m)
        return Others(pos_ned_m, self._tracks.newest[:, 3:], std_m, fresh)

    def shape_std_m(self, now_us: int) -> float:
        """Horizontal rms error to expect of the shape of those located and heard of, aligned.

        Inf with fewer than two.
        """
        members = np.flatnonzero(self.located & self._present(now_us))
        if len(members) < 2:
            return float("inf")
        return float(np.sqrt(shape_variance(self.positions_ned_m(now_us), self.cov, members)))

    def _present(self, now_us: int) -> Flags:
        """(N,) who has been heard of within `SILENCE_US`."""
        return np.asarray(self._tracks.newest_us >= max(now_us - SILENCE_US, 0))

    def _walked_m2(self, now_us: int) -> float:
        """What the odometry of two has lost since the filter's time, per axis of their difference."""
        return 2.0e-6 * self._drift_m2_s * max(now_us - self._time_us, 0)

    def _advance(self, time_us: int, *, decay: bool = False) -> float:
        """Propagate to ``time_us`` if that is news; return how many seconds the filter is ahead of it."""
        ahead_us = self._time_us - time_us
        if ahead_us >= 0 and not decay:
            return ahead_us * 1e-6
        step_us = max(-ahead_us, 0) if self._time_us else 0
        self._decay_owed_us += step_us
        decay_us = self._decay_owed_us if decay or self._decay_owed_us >= self._decay_stride_us else 0
        self._decay_owed_us -= decay_us
        model = self._model
        predict(
            self.state, self.cov, self.active, self._drift_m2_s * step_us * 1e-6, decay_us * 1e-6,
            model.height_std_m**2, model.height_time_constant_s,
            self._bias_var_m2, model.gps_bias_time_constant_s,
        )  # fmt: skip
        self._time_us = max(self._time_us, time_us)
        return max(ahead_us, 0) * 1e-6

    def _take_stated(self, station: int, std_h_m: float, std_v_m: float) -> None:
        """Take a receiver at its word when it is worse than the model; its bias is less known at once."""
        model = self._model
        self._stated_vertical_var_m2[station] = max(model.gps_bias_vertical_std_m, std_v_m) ** 2
        variance_m2 = max(model.gps_bias_std_m, std_h_m) ** 2
        added_m2 = variance_m2 - self._stated_var_m2[station]
        self._stated_var_m2[station] = variance_m2
        if added_m2 > 0.0:
            self._bias_var_m2[station] = max(self._bias_var_m2[station], variance_m2)
            if self.active[station]:
                # No further than to the new variance, or a receiver that wavers would add up.
                for at in range(STATES * station + BIAS, STATES * station + STATES):
                    self.cov[at, at] += max(min(added_m2, variance_m2 - self.cov[at, at]), 0.0)

    def _fuse_fixes(self, station: int, time_us: int, mean: FixMean) -> None:
        model = self._model
        difference_m = self._fix_less_odometry_m[station]
        difference_m[:] = mean.less_odometry_ned_m
        if not self.active[station]:
            self._activate(station)
            return
        self._advance(time_us)
        # The mean is as old as its middle, since when both odometry and bias have moved on.
        age_s = (self._time_us - mean.time_us) * 1e-6
        moved_m2_s = self._drift_m2_s + 2.0 * self._bias_var_m2.item(station) / model.gps_bias_time_constant_s
        variance_m2 = model.gps_white_std_m**2 / mean.count + moved_m2_s * age_s
        periods = 2.0e6 * model.gps_bias_time_constant_s / max(mean.span_us, GROUP_US)
        height_m2 = self._stated_vertical_var_m2.item(station) * max(periods, 1.0)
        weight = fuse_fix(self.state, self.cov, station, difference_m, variance_m2, height_m2)
        self._bad_fixes[station] = self._bad_fixes[station] + 1 if weight < MISFIT_WEIGHT else 0
        if self._bad_fixes[station] >= STEP_FIXES and self.located[station]:
            self._bad_fixes[station] = 0
            self.gps_steps += 1
            relearn_bias(self.state, self.cov, station, difference_m, variance_m2)
        self._rate_gps(station)

    def _rate_gps(self, station: int) -> None:
        """Take the spread of a GPS bias from its estimate where that is beyond what the receiver states."""
        base = STATES * station
        bias_n_m, bias_e_m = self.state[base + BIAS : base + STATES].tolist()
        seen_m2 = max(bias_n_m**2, bias_e_m**2) / BIAS_SIGMAS**2
        self._bias_var_m2[station] = max(self._stated_var_m2[station], seen_m2)

    def _lose(self, station: int) -> None:
        """Take a UAV out until there are new odometry, GPS and distances of it."""
        self._tracks.forget(station)
        self._fixes[station] = FixGroup()
        self._bad_fixes[station] = 0
        self._trust.forget(station)
        self.located[station] = self.active[station] = False
        _clear(station, self.state, self.cov)
        self._drop_distances(station)
        heard = self.located & self._present(self._tracks.newest_us.item(self.own))
        if heard[self.own] and heard.sum() == 1:
            # With what the own GPS alone has told it, the filter would differ from those of all others.
            self._trust.forget(self.own)
            self.located[self.own] = False
            self._activate(self.own)

    def _drop_distances(self, station: int) -> None:
        """Forget what is kept of a UAV's distances, whose odometry is that of before."""
        for kept in (self._held, self._fused):
            for pair in [pair for pair in kept if station in pair]:
                del kept[pair]

    def _activate(self, station: int) -> None:
        """Begin a UAV with its GPS alone."""
        self._bias_var_m2[station] = self._stated_var_m2[station]
        self._begin(station, self.state, self.cov)
        self.active[station] = True

    def _begin(self, station: int, state: Array, cov: Array) -> None:
        """Fill in a UAV by its GPS: offset = fix - bias - noise, the bias at its stationary spread."""
        base = STATES * station
        bias_var_m2 = self._stated_var_m2[station]
        _clear(station, state, cov)
        for a in range(2):
            state[base + a] = self._fix_less_odometry_m[station, a]
            cov[base + a, base + a] = bias_var_m2 + self._model.gps_white_std_m**2
            cov[base + BIAS + a, base + BIAS + a] = bias_var_m2
            cov[base + a, base + BIAS + a] = cov[base + BIAS + a, base + a] = -bias_var_m2
        cov[base + 2, base + 2] = self._model.height_std_m**2

    def _take(self, item: Range, now_us: int) -> bool:
        """Use or hold a distance; False when it must wait for odometry."""
        i, j = item.initiator, item.responder
        newest_us = self._tracks.newest_us
        if item.time_us > newest_us[i] or item.time_us > newest_us[j]:
            return bool(now_us - item.time_us > PENDING_LIMIT_US)
        if self._tracks.between(i, j, item.time_us, item.odometry_between_m) != KNOWN:
            return True
        if not (self.active[i] and self.active[j]):
            return now_us - item.time_us > PENDING_LIMIT_US
        if self.located[i] and self.located[j]:
            self._fuse(item)
        else:
            if not self._held:
                self._held_since_us = now_us
            self._held[i, j] = item
        return True

    def _fuse(self, item: Range) -> None:
        lag_s = self._advance(item.time_us)
        # Distances of a UAV that are late together share what its odometry has lost since, and are worth no
        # more than one of them.
        late_m2 = self._drift_m2_s * lag_s * (1.0 + self._distances_hz * lag_s)
        bend_m = self._bend_m.item(item.initiator, item.responder)
        trust = 0.0 if self._trust.distrusted[item.initiator] else 1.0
        weight = fuse_range(
            self.state, self.cov, self.state, self._reference_ne_m, item.initiator, item.responder,
            item.odometry_between_m, item.distance_m - bend_m,
            item.variance_m2 + 2.0 * (late_m2 + bend_m * bend_m), -1.0, trust,
        )  # fmt: skip
        self._count(item, weight)
        self._fused[item.initiator, item.responder] = item
        if trust > 0.0 and self._trust.distrusted[item.initiator]:
            # It has been pulled to where its own distances wanted it.
            for at in range(STATES * item.initiator, STATES * item.initiator + 2):
                self.cov[at, at] += PULLED_STD_M**2
        for station in (item.initiator, item.responder):
            if self._trust.elsewhere(station):
                self._restart(station)

    def _count(self, item: Range, weight: float) -> None:
        badly = weight < MISFIT_WEIGHT
        self.ranges_used += 1
        self.ranges_downweighted += badly
        self._trust.note(item.initiator, item.responder, badly=badly)
        if self.own in {item.initiator, item.responder} and not badly:
            self.own_range_us = max(item.time_us, self.own_range_us or 0)

    def _locate(self, now_us: int) -> None:
        """Bring in those whose distances have been held, once enough of them are there."""
        present = self._present(now_us)
        linked = links(self._held.values(), self.count) | np.eye(self.count, dtype=bool)
        fallen_silent = ~present & (self._tracks.newest_us >= 0)
        complete = (self.active | fallen_silent).all() and linked[present & ~self.located][:, present].all()
        if not complete and now_us - self._held_since_us < self._model.gather_s * 1e6:
            return
        held = [item for _, item in sorted(self._held.items())]
        self._held.clear()
        self._advance(max(item.time_us for item in held))
        problem = self._problem(self.state, self.cov, self.active & present, self.located & present)
        joined = problem.join(held)
        if joined is None:
            return
        self._take_in(joined, now_us)
        for item, weight in zip(joined.batch, joined.solution.weights, strict=True):
            self._count(item, weight)

    def _try_afresh(self, suspects: set[int], now_us: int) -> None:
        """Solve again for UAVs of whose distances many misfit; without a solution that fits, all stays."""
        held = [
            item
            for pair, item in sorted(self._fused.items())
            if not suspects.isdisjoint(pair) and now_us - item.time_us < self._model.gather_s * 1e6
        ]
        if not held:
            return
        present = self._present(now_us)
        self._advance(max(item.time_us for item in held))
        state, cov, rest = self.state.copy(), self.cov.copy(), self.located & present
        for station in suspects:
            self._begin(station, state, cov)
            rest[station] = False
        joined = self._problem(state, cov, self.located & present, rest).join(held)
        if joined is not None and joined.joining.sum() == len(suspects):
            self.restarts += len(suspects)
            self._take_in(joined, now_us)

    def _problem(self, state: Array, cov: Array, active: Flags, located: Flags) -> Problem:
        return Problem(
            state=state, cov=cov, time_us=self._time_us, active=active, located=located,
            places_ned_m=self._places_ned_m, odometry_ned_m=self._tracks.newest[:, :3],
            drift_m2_s=self._drift_m2_s, bias_var_m2=self._stated_var_m2,
        )  # fmt: skip

    def _take_in(self, joined: Joined, now_us: int) -> None:
        """Make a solution the filter's."""
        self.state[:], self.cov[:] = joined.solution.state, joined.solution.cov
        self.located |= joined.joining
        self._set_reference(now_us, joined.joining)
        self._keep_geometry(now_us)
        for station in np.flatnonzero(joined.joining).tolist():
            self._trust.forget(station)
            self._rate_gps(station)
        for station in joined.liars:
            self._trust.distrust(station)

    def _set_reference(self, now_us: int, joining: Flags) -> None:
        """Fix the geometry of the derivatives for those who join.

        Where the shape is known it is that of the estimates. Else, as across a line, they are as wrong as GPS
        and with them distances would seem to tell of it: the places then tell directions better.
        """
        there_m = self.positions_ned_m(now_us)[:, :2]
        reference_m = there_m
        if self.shape_std_m(now_us) > SHAPE_KNOWN_M:
            reference_m = laid_over(self._places_ned_m, there_m, self.located & self._present(now_us))
        before = self.located & self._present(now_us) & ~joining
        if before.any():
            # They keep the place and the heading of those before them.
            there, then = (m[before] @ TO_COMPLEX for m in (reference_m, self._reference_ne_m))
            turn = np.exp(1j * np.angle(np.vdot(there - there.mean(), then - then.mean())))
            turned = (reference_m @ TO_COMPLEX - there.mean()) * turn + then.mean()
            reference_m = np.column_stack((turned.real, turned.imag))
        self._reference_ne_m[joining] = reference_m[joining]

    def _keep_geometry(self, now_us: int) -> None:
        """Renew the fixed geometry when the formation has turned away from it, and what bending does."""
        members = self.located & self._present(now_us)
        if members.sum() < 2:
            return
        there = self.positions_ned_m(now_us)[members, :2] @ TO_COMPLEX
        reference = self._reference_ne_m @ TO_COMPLEX
        then = reference[members]
        turn_rad = np.angle(np.vdot(then - then.mean(), there - there.mean()))
        if abs(turn_rad) > TURN_LIMIT_RAD:
            # Who is silent is taken along, for the time when it is heard again.
            turned = (reference - then.mean()) * np.exp(1j * turn_rad) + there.mean()
            self._reference_ne_m[:] = np.column_stack((turned.real, turned.imag))
            self._set_reference(now_us, members)
        bend(self._reference_ne_m, self.cov, np.flatnonzero(members), self._bend_m)

    def _restart(self, station: int) -> None:
        """Forget where a UAV is thought to be, for it does not fit: back to its GPS."""
        self.restarts += 1
        self._trust.forget(station)
        self.located[station] = False
        self._activate(station)


def _clear(station: int, state: Array, cov: Array) -> None:
    """Take all that is known of a UAV out of state and cov."""
    own = slice(STATES * station, STATES * (station + 1))
    state[own] = 0.0
    cov[own, :] = cov[:, own] = 0.0
