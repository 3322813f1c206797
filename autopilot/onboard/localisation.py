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

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from autopilot.onboard.beacon import Distance
from autopilot.onboard.distances import Distances
from autopilot.onboard.fixes import FixMean
from autopilot.onboard.joining import Flags, Joined, Problem, Range, links
from autopilot.onboard.kernels import BIAS, KNOWN, STATES, Array, fuse_range, predict
from autopilot.onboard.localisation_model import LocalisationModel
from autopilot.onboard.receivers import MISFIT_WEIGHT, Receivers, clear
from autopilot.onboard.reference_geometry import ReferenceGeometry, shape_std_m
from autopilot.onboard.tracks import EXTRAPOLATED_S, Tracks
from autopilot.onboard.trust import Trust
from autopilot.onboard.uncertainty import seen_from, variance_between
from autopilot.types import Vector

__all__ = ["CLOCK_TOLERANCE_US", "CooperativeLocalisation", "LocalisationModel", "Others"]

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
JUMP_SHARE = 0.1
"""Standard deviation of a jump of odometry, by its size."""
PULLED_STD_M = 1.0
"""By how much a UAV may be misplaced that has just been found to measure wrongly."""
GEOMETRY_PERIOD_US = 1_000_000
"""How often it is looked at whether the formation has turned."""


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
        tracks: everybody's odometry.
        ranges_used, ranges_downweighted: counters.
        ranges_too_late: distances for which odometry was no longer known, or not yet for too long.
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
        self.ranges_too_late = 0
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
        self.tracks = Tracks(count)
        self._receivers = Receivers(count, model)
        self._distances = Distances(count)
        self._trust = Trust(count)
        self._geometry = ReferenceGeometry(self._places_ned_m)
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
        silent_us = time_us - self.tracks.newest_us.item(station)
        if silent_us > SILENCE_US:
            self._returned = True
            if silent_us > LOST_US and self.located[station]:
                self._lose(station)
        jump = self.tracks.push(station, time_us, odometry_ned_m, vel_ned_m_s)
        if jump is not None and self.active[station]:
            # The UAV has not jumped: its odometry has begun anew.
            self.odometry_jumps += 1
            self._receivers.drop_fixes(station)
            self._distances.drop(station)
            for a, jump_m in enumerate(jump):
                self._receivers.less_odometry_ned_m[station, a] -= jump_m
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
        receivers = self._receivers
        if time_us <= receivers.newest_us[station]:
            return
        odometry_m = self._scratch_m
        if self.tracks.at(station, time_us, odometry_m) != KNOWN:
            return
        receivers.newest_us[station] = time_us
        active = bool(self.active[station])
        if std_h_m is not None or std_v_m is not None:
            receivers.take_stated(station, std_h_m or 0.0, std_v_m or 0.0, self.cov, active=active)
        mean = receivers.add(station, time_us, pos_ned_m, odometry_m.tolist(), at_once=not active)
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
        if not self._distances.newest_us[initiator][responder] < time_us <= now_us + CLOCK_TOLERANCE_US:
            return
        self._distances.add(initiator, responder, time_us, distance_m, std_m**2 + self._floor_m2)

    def on_distances(
        self, initiator: int, distances: Sequence[Distance], rows: Sequence[int | None], *, now_us: int
    ) -> None:
        """Take all that a beacon of ``initiator`` tells, as `on_range` does one by one, in less time.

        ``rows`` are the indices here of the stations that the distances name; None: those that are not here.
        """
        newest_us, stations = self._distances.newest_us[initiator], len(rows)
        for item in distances:
            row = rows[item.peer] if item.peer < stations else None
            if row is not None and newest_us[row] < item.time_ms * 1_000:
                self.on_range(
                    initiator, row, item.time_ms * 1_000, item.distance_m, item.std_m, now_us=now_us
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
            self._geometry.keep(self._members(now_us), self.positions_ned_m(now_us), self.cov)
        distances = self._distances
        if distances.pending:
            distances.pending = [item for item in distances.pending if not self._take(item, now_us)]
        if distances.held:
            self._locate(now_us)
        if due:
            self._geometry_due_us = now_us + GEOMETRY_PERIOD_US
            self._distances_hz = 2e6 * (self.ranges_used - self._counted) / (self.count * GEOMETRY_PERIOD_US)
            self._counted = self.ranges_used
            suspects = self._trust.suspects(now_us, np.flatnonzero(self._members(now_us)))
            if suspects:
                self._try_afresh(suspects, now_us)

    def advance(self, now_us: int) -> None:
        """Propagate the covariance to now, for whoever wants to read it."""
        self._advance(now_us, decay=True)

    def offset_ne_m(self) -> tuple[float, float]:
        """Estimated true position less odometry of the own UAV, north and east."""
        base = STATES * self.own
        return self.state.item(base), self.state.item(base + 1)

    def offset_ned_m(self) -> Array:
        """(3,) the same with down: less the barometer's height; a view."""
        base = STATES * self.own
        return self.state[base : base + 3]

    def positions_ned_m(self, now_us: int) -> Array:
        """(N, 3) estimated positions, site NED; neighbours' extrapolated by their velocity, 1 s at most."""
        return self.tracks.now_ned_m(now_us) + self.state.reshape(-1, STATES)[:, :3]

    def std_ned_m(self) -> Vector:
        """One sigma of the own position, the formation's place as a whole included."""
        at = STATES * self.own
        return self._std_m(at), self._std_m(at + 1), self._std_m(at + 2)

    @property
    def offsets_ned_m(self) -> Array:
        """(N, 3) estimated true positions less odometry of all: a view."""
        return self.state.reshape(-1, STATES)[:, :3]

    def odometry_at(self, station: int, time_us: int) -> Array | None:
        """(3,) odometry of a UAV, NED, at a time of the last seconds; None where it is not known."""
        odometry_ned_m = np.empty(3)
        known = self.tracks.at(station, time_us, odometry_ned_m) == KNOWN
        return odometry_ned_m if known else None

    def gps_error(self, station: int) -> tuple[Vector, float]:
        """Estimated error of a UAV's GPS, NED, m, and one sigma of each horizontal axis of it.

        Horizontally the slow part alone; vertically that of the last fixes, against the barometer.
        """
        bias, variance, down_m = STATES * station + BIAS, self.cov.item, 0.0
        if self.active[station]:
            down_m = self._receivers.less_odometry_ned_m.item(station, 2) - self.state.item(bias - 1)
            spread_m2 = variance(bias, bias) + variance(bias + 1, bias + 1)
        else:
            spread_m2 = 2.0 * self._receivers.stated_var_m2.item(station)
        error_ned_m = (self.state.item(bias), self.state.item(bias + 1), down_m)
        return error_ned_m, math.sqrt(0.5 * spread_m2)

    def distance_variance_m2(self, peer: int, now_us: int) -> float | None:
        """Variance with which the distance to a UAV is known now; None while either end is not located."""
        if not (self.located[self.own] and self.located[peer]):
            return None
        tracks = self.tracks
        relative_m2: float = variance_between(self.cov, self.own, peer, tracks.newest, self.state)
        return relative_m2 + self._walked_m2(now_us)

    def others(self, now_us: int, *, fresh_us: int) -> Others:
        """Everybody, as avoidance wants them; fresh is who was heard within ``fresh_us``."""
        pos_ned_m, std_m, fresh = np.empty((self.count, 3)), np.empty(self.count), np.empty(self.count, bool)
        tracks = self.tracks
        seen_from(
            self.own, now_us, tracks.newest, tracks.newest_us, EXTRAPOLATED_S, self.state, self.cov,
            self.located, now_us - fresh_us, self._walked_m2(now_us), pos_ned_m, std_m, fresh,
        )  # fmt: skip
        return Others(pos_ned_m, tracks.newest[:, 3:], std_m, fresh)

    def shape_std_m(self, now_us: int) -> float:
        """Horizontal rms error to expect of the shape of those located and heard of, aligned.

        Inf with fewer than two.
        """
        return shape_std_m(self.positions_ned_m(now_us), self.cov, self._members(now_us))

    def _std_m(self, at: int) -> float:
        return math.sqrt(max(self.cov.item(at, at), 0.0))

    def _present(self, now_us: int) -> Flags:
        """(N,) who has been heard of within `SILENCE_US`."""
        return np.asarray(self.tracks.newest_us >= max(now_us - SILENCE_US, 0))

    def _members(self, now_us: int) -> Flags:
        """(N,) those of them who are located: who has a part in the geometry."""
        return self.located & self._present(now_us)

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
            self._receivers.bias_var_m2, model.gps_bias_time_constant_s,
        )  # fmt: skip
        self._time_us = max(self._time_us, time_us)
        return max(ahead_us, 0) * 1e-6

    def _fuse_fixes(self, station: int, time_us: int, mean: FixMean) -> None:
        if not self.active[station]:
            self._activate(station)
            return
        self._advance(time_us)
        self.gps_steps += self._receivers.fuse(
            station, mean, self.state, self.cov, self._time_us, located=bool(self.located[station])
        )

    def _lose(self, station: int) -> None:
        """Take a UAV out until there are new odometry, GPS and distances of it."""
        self.tracks.forget(station)
        self._receivers.forget(station)
        self._trust.forget(station)
        self.located[station] = self.active[station] = False
        clear(station, self.state, self.cov)
        self._distances.drop(station)
        heard = self._members(self.tracks.newest_us.item(self.own))
        if heard[self.own] and heard.sum() == 1:
            # With what the own GPS alone has told it, the filter would differ from those of all others.
            self._trust.forget(self.own)
            self.located[self.own] = False
            self._activate(self.own)

    def _activate(self, station: int) -> None:
        """Begin a UAV with its GPS alone."""
        self._receivers.unrate(station)
        self._receivers.begin(station, self.state, self.cov)
        self.active[station] = True

    def _take(self, item: Range, now_us: int) -> bool:
        """Use or hold a distance; False when it must wait for odometry."""
        i, j = item.initiator, item.responder
        newest_us = self.tracks.newest_us
        if item.time_us > newest_us[i] or item.time_us > newest_us[j]:
            return self._is_too_late(item, now_us)
        if self.tracks.between(i, j, item.time_us, item.odometry_between_m) != KNOWN:
            self.ranges_too_late += 1
            return True
        if not (self.active[i] and self.active[j]):
            return self._is_too_late(item, now_us)
        if self.located[i] and self.located[j]:
            self._fuse(item)
        else:
            self._distances.hold(item, now_us)
        return True

    def _is_too_late(self, item: Range, now_us: int) -> bool:
        late = bool(now_us - item.time_us > PENDING_LIMIT_US)
        self.ranges_too_late += late
        return late

    def _fuse(self, item: Range) -> None:
        lag_s = self._advance(item.time_us)
        # Distances of a UAV that are late together share what its odometry has lost since, and are worth no
        # more than one of them.
        late_m2 = self._drift_m2_s * lag_s * (1.0 + self._distances_hz * lag_s)
        pair = item.initiator, item.responder
        geometry = self._geometry
        bend_m, bend_var_m2 = geometry.bend_m.item(pair), geometry.bend_var_m2.item(pair)
        trust = 0.0 if self._trust.distrusted[item.initiator] else 1.0
        weight = fuse_range(
            self.state, self.cov, self.state, geometry.ne_m, item.initiator, item.responder,
            item.odometry_between_m, item.distance_m - bend_m,
            item.variance_m2 + 2.0 * late_m2 + bend_var_m2, -1.0, trust,
        )  # fmt: skip
        self._count(item, weight, fused=trust > 0.0)
        self._distances.fused[item.initiator, item.responder] = item
        if trust > 0.0 and self._trust.distrusted[item.initiator]:
            # It has been pulled to where its own distances wanted it.
            for at in range(STATES * item.initiator, STATES * item.initiator + 2):
                self.cov[at, at] += PULLED_STD_M**2
        for station in (item.initiator, item.responder):
            if self._trust.elsewhere(station):
                self._restart(station)

    def _count(self, item: Range, weight: float, *, fused: bool) -> None:
        badly = not weight >= MISFIT_WEIGHT
        self.ranges_used += 1
        self.ranges_downweighted += badly
        self._trust.note(item.initiator, item.responder, badly=badly)
        if fused and not badly and self.own in {item.initiator, item.responder}:
            self.own_range_us = max(item.time_us, self.own_range_us or 0)

    def _locate(self, now_us: int) -> None:
        """Bring in those whose distances have been held, once enough of them are there."""
        present = self._present(now_us)
        linked = links(self._distances.held.values(), self.count) | np.eye(self.count, dtype=bool)
        fallen_silent = ~present & (self.tracks.newest_us >= 0)
        complete = (self.active | fallen_silent).all() and linked[present & ~self.located][:, present].all()
        if not complete and now_us - self._distances.held_since_us < self._model.gather_s * 1e6:
            return
        held = self._distances.release()
        self._advance(max(item.time_us for item in held))
        problem = self._problem(self.state, self.cov, self.active & present, self.located & present)
        joined = problem.join(held)
        if joined is None:
            return
        self._take_in(joined, now_us)
        for item, weight in zip(joined.batch, joined.solution.weights, strict=True):
            self._count(item, weight, fused=True)

    def _try_afresh(self, suspects: set[int], now_us: int) -> None:
        """Solve again for UAVs of whose distances many misfit; without a solution that fits, all stays."""
        within_us = max(self._model.gather_s * 1e6, SILENCE_US)
        held = self._distances.fused_of(suspects, now_us, within_us=within_us)
        if not held:
            return
        present = self._present(now_us)
        self._advance(max(item.time_us for item in held))
        state, cov, rest = self.state.copy(), self.cov.copy(), self.located & present
        for station in suspects:
            self._receivers.begin(station, state, cov)
            rest[station] = False
        joined = self._problem(state, cov, self.located & present, rest).join(held)
        if joined is not None and joined.joining.sum() == len(suspects):
            self.restarts += len(suspects)
            self._take_in(joined, now_us)

    def _problem(self, state: Array, cov: Array, active: Flags, located: Flags) -> Problem:
        return Problem(
            state=state, cov=cov, time_us=self._time_us, active=active, located=located,
            places_ned_m=self._places_ned_m, odometry_ned_m=self.tracks.newest[:, :3],
            drift_m2_s=self._drift_m2_s, bias_var_m2=self._receivers.stated_var_m2,
        )  # fmt: skip

    def _take_in(self, joined: Joined, now_us: int) -> None:
        """Make a solution the filter's."""
        self.state[:], self.cov[:] = joined.solution.state, joined.solution.cov
        self.located |= joined.joining
        members, pos_ned_m = self._members(now_us), self.positions_ned_m(now_us)
        self._geometry.fix(joined.joining, members, pos_ned_m, self.cov)
        self._geometry.keep(members, pos_ned_m, self.cov)
        for station in np.flatnonzero(joined.joining).tolist():
            self._trust.forget(station)
            self._receivers.rate(station, self.state)
        for station in joined.liars:
            self._trust.distrust(station)

    def _restart(self, station: int) -> None:
        """Forget where a UAV is thought to be, for it does not fit: back to its GPS."""
        self.restarts += 1
        self._trust.forget(station)
        self.located[station] = False
        self._activate(station)
