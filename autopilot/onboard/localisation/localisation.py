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

import numpy as np

from autopilot.onboard.localisation.batch_initialisation import Flags, InitialisationProblem, Joined, links
from autopilot.onboard.localisation.distances import Distances
from autopilot.onboard.localisation.kernels import BIAS, STATES, Array
from autopilot.onboard.localisation.measurement_update import (
    DONE,
    ELSEWHERE,
    FIRST_MEAN,
    GPS_STEPPED,
    LOST,
    NOT_LOCATED,
    ODOMETRY_JUMPED,
    SENDER_RESTARTED,
    advance,
    count_distance,
    read_beacons,
    take_fix,
    take_odometry,
    use_pending,
)
from autopilot.onboard.localisation.members import new_filter, new_members
from autopilot.onboard.localisation.model import CLOCK_TOLERANCE_US, SILENCE_US, LocalisationModel
from autopilot.onboard.localisation.receivers import Receivers, clear
from autopilot.onboard.localisation.reference_geometry import ReferenceGeometry, shape_std_m
from autopilot.onboard.localisation.tracks import EXTRAPOLATED_S, KNOWN, Tracks, odometry_at
from autopilot.onboard.localisation.trust import Trust
from autopilot.onboard.localisation.uncertainty import SEEN, Others, seen_from, variance_between
from autopilot.onboard.radio.neighbour_table import NeighbourTable
from foundation.types import Vector

__all__ = ["CLOCK_TOLERANCE_US", "SILENCE_US", "CooperativeLocalisation", "LocalisationModel", "Others"]

JUMP_SHARE = 0.1
"""Standard deviation of a jump of odometry, by its size."""
GEOMETRY_PERIOD_US = 1_000_000
"""How often it is looked at whether the formation has turned."""


class CooperativeLocalisation:
    """Filter over N UAVs at one of them.

    Args:
        own: index of the UAV that runs it.
        places_ned_m: (N, 3) the formation's places, site NED.
        model: noise model.

    Attributes:
        state: (5N,) and ``cov`` (5N, 5N), laid out as `kernels` says.
        located: (N,) bool, whose distances are fused.
        members: (N,) of `MEMBER`, what is kept of each.
        tracks: everybody's odometry.
        restarts: times that a UAV was found to be elsewhere than thought.
        odometry_jumps: times that a UAV's odometry has begun anew, by its own step or as told by `restart`.
        gps_steps: times that a GPS error was found to have changed at once.

    """

    def __init__(self, *, own: int, places_ned_m: Array, model: LocalisationModel) -> None:
        count = len(places_ned_m)
        self.own = own
        self.count = count
        self.state = np.zeros(STATES * count)
        self.cov = np.zeros((STATES * count, STATES * count))
        at = STATES * own
        self._own_offset_ne_m = self.state[at : at + 2]
        self._own_variances_m2 = self.cov.diagonal()[at : at + 3]
        self.members = members = new_members(count)
        self.active: Flags = members["active"].view(bool)
        self.located: Flags = members["located"].view(bool)
        self.restarts = 0
        self.odometry_jumps = 0
        self.gps_steps = 0
        self._places_ned_m = np.array(places_ned_m, float)
        self._model = model
        self._drift_m2_s = model.odometry_drift_m_sqrt_s**2
        self._filter = new_filter(own, model)
        # Of what is asked for in every loop, for making a view of a field takes longer than reading it.
        self._time, self._own_range = self._filter["time_us"], self._filter["own_range_us"]
        self._returned = self._filter["returned"]
        self.tracks = Tracks(members)
        self._receivers = Receivers(members, model)
        self._distances = Distances(count, self._filter)
        self._trust = Trust(members)
        self._geometry = ReferenceGeometry(self._places_ned_m)
        self._geometry_due_us = 0
        self._counted = 0
        self._others: Others = np.zeros(count, SEEN)

    def read(self, hearing: NeighbourTable, now_us: int) -> None:
        """Hear all that has come, and take what it says of those who are localised and of distances."""
        pages, distances = hearing.pages, self._distances
        while True:
            asked = read_beacons(
                pages.count, now_us, pages.rows, hearing.listener, hearing.stations, hearing.rows,
                self._filter, self.members, self.tracks.rings, self.state, self.cov,
                distances.pairs, distances.pending,
            )  # fmt: skip
            if asked == DONE:
                pages.count = 0
                return
            self._do(asked, hearing.sender_row)

    def on_odometry(
        self, station: int, time_us: int, odometry_ned_m: Sequence[float], vel_ned_m_s: Sequence[float]
    ) -> None:
        """Take odometry of a UAV (north, east integrated velocity, down the barometer's); old is ignored."""
        while True:
            asked = take_odometry(
                self._filter, self.members, self.tracks.rings, station, time_us, *odometry_ned_m, *vel_ned_m_s
            )
            if asked == DONE:
                return
            self._do(asked, station)

    def on_fix(
        self,
        station: int,
        time_us: int,
        pos_ned_m: Sequence[float],
        std_h_m: float | None = None,
        std_v_m: float | None = None,
    ) -> bool:
        """Take a GPS position (site NED) at ``time_us``; used once, and only with odometry of that time.

        ``std_h_m`` (per axis) and ``std_v_m`` are what the receiver states; None: nothing. Returns whether it
        has been used by now: one that is not may be, once there is odometry.
        """
        north_m, east_m, down_m = pos_ned_m
        asked = take_fix(
            self._filter, self.members, self.tracks.rings, self.state, self.cov, station,
            time_us, north_m, east_m, down_m, std_h_m or 0.0, std_v_m or 0.0,
        )  # fmt: skip
        if asked != DONE:
            self._do(asked, station)
        return bool(self._receivers.newest_us.item(station) >= time_us)

    def on_range(
        self, initiator: int, responder: int, time_us: int, distance_m: float, std_m: float, *, now_us: int
    ) -> None:
        """Take a distance that ``initiator`` measured; told by (initiator, responder, time), and used once.

        One that is not newer than what is known of the two is ignored, as is one from the future, which would
        hide the right ones that follow, and one of which an end is no UAV of the formation.
        """
        if responder < self.count:
            variance_m2 = std_m**2 + self._model.range_floor_std_m**2
            self._distances.add(initiator, responder, time_us, distance_m, variance_m2, now_us=now_us)

    def _do(self, asked: int, row: int) -> None:
        """Do what a UAV's news ask for; see `intake`."""
        if asked == SENDER_RESTARTED:
            self.restart(row)
        elif asked == LOST:
            self._lose(row)
        elif asked == ODOMETRY_JUMPED:
            self._begin_odometry_anew(row)
        elif asked == FIRST_MEAN:
            self._activate(row)
        elif asked == GPS_STEPPED:
            self.gps_steps += 1
            self._receivers.learn_anew(row, self.state, self.cov, self._filter["gps_var_m2"].item())
        else:
            self._distances.make_room()

    def _begin_odometry_anew(self, row: int) -> None:
        """Make good a step that a UAV has not made: its odometry has begun anew."""
        self.odometry_jumps += 1
        self._receivers.drop_fixes(row)
        self._distances.drop(row)
        for a, jump_m in enumerate(self._filter["step_ne_m"][0].tolist()):
            self._receivers.less_odometry_ned_m[row, a] -= jump_m
            self.state[STATES * row + a] -= jump_m
            self.cov[STATES * row + a, STATES * row + a] += (JUMP_SHARE * jump_m) ** 2

    def restart(self, station: int) -> None:
        """Forget a UAV whose application has begun anew: its odometry counts from elsewhere since.

        To be told before that odometry. It is brought in again once there are GPS and distances of it.
        """
        self.odometry_jumps += 1
        self._lose(station)

    def update(self, now_us: int) -> None:
        """Use what has become usable by now."""
        due = now_us >= self._geometry_due_us
        if due or self._returned.item():
            self._returned[0] = 0
            self._geometry.keep(self._members(now_us), self.positions_ned_m(now_us), self.cov)
        self._use_pending(now_us)
        if self._distances.held:
            self._locate(now_us)
        if due:
            self._geometry_due_us = now_us + GEOMETRY_PERIOD_US
            used = self.ranges_used
            self._filter["distances_hz"] = 2e6 * (used - self._counted) / (self.count * GEOMETRY_PERIOD_US)
            self._counted = used
            suspects = self._trust.suspects(now_us, np.flatnonzero(self._members(now_us)))
            if suspects:
                self._try_afresh(suspects, now_us)

    def advance(self, now_us: int) -> None:
        """Propagate the covariance to now, for whoever wants to read it."""
        self._advance(now_us, decay=True)

    @property
    def ranges_used(self) -> int:
        """Distances that were compared with the estimate."""
        return int(self._filter["ranges_used"].item())

    @property
    def ranges_downweighted(self) -> int:
        """Those of them that fitted badly."""
        return int(self._filter["ranges_downweighted"].item())

    @property
    def ranges_too_late(self) -> int:
        """Distances for which odometry was no longer known, or not yet for too long."""
        return int(self._filter["ranges_too_late"].item())

    @property
    def own_range_us(self) -> int:
        """When the newest fused distance that involves the own UAV was measured; -1: there is none."""
        return int(self._own_range.item())

    def offset_ne_m(self) -> tuple[float, float]:
        """Estimated true position less odometry of the own UAV, north and east."""
        north_m, east_m = self._own_offset_ne_m.tolist()
        return north_m, east_m

    def offset_ned_m(self) -> Array:
        """(3,) the same with down: less the barometer's height; a view."""
        base = STATES * self.own
        return self.state[base : base + 3]

    def positions_ned_m(self, now_us: int) -> Array:
        """(N, 3) estimated positions, site NED; neighbours' extrapolated by their velocity, 1 s at most."""
        return self.tracks.now_ned_m(now_us) + self.state.reshape(-1, STATES)[:, :3]

    def std_ned_m(self) -> Vector:
        """One sigma of the own position, the formation's place as a whole included."""
        north_m2, east_m2, down_m2 = self._own_variances_m2.tolist()
        if north_m2 < 0.0 or east_m2 < 0.0 or down_m2 < 0.0:  # by rounding
            north_m2, east_m2, down_m2 = max(north_m2, 0.0), max(east_m2, 0.0), max(down_m2, 0.0)
        return math.sqrt(north_m2), math.sqrt(east_m2), math.sqrt(down_m2)

    @property
    def offsets_ned_m(self) -> Array:
        """(N, 3) estimated true positions less odometry of all: a view."""
        return self.state.reshape(-1, STATES)[:, :3]

    def odometry_at(self, station: int, time_us: int) -> Array | None:
        """(3,) odometry of a UAV, NED, at a time of the last seconds; None where it is not known."""
        odometry_ned_m = np.empty(3)
        known = odometry_at(self.tracks.rings, station, time_us, odometry_ned_m) == KNOWN
        return odometry_ned_m if known else None

    def gps_error(self, station: int) -> tuple[Vector, float]:
        """Estimated error of a UAV's GPS, NED, m, and one sigma of each horizontal axis of it.

        Horizontally the slow part alone; vertically that of the last fixes, against the barometer.
        """
        bias, variance, down_m = STATES * station + BIAS, self.cov.item, 0.0
        if self.active.item(station):
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
        relative_m2: float = variance_between(self.cov, self.own, peer, self.members, self.state)
        return relative_m2 + self._walked_m2(now_us)

    def others(self, now_us: int, *, fresh_us: int, shift_ne_m: tuple[float, float] = (0.0, 0.0)) -> Others:
        """Everybody, as avoidance wants them, shifted; fresh is who was heard within ``fresh_us``.

        Memory that is written over when somebody asks again.
        """
        others = self._others
        seen_from(
            self.own, now_us, self.members, EXTRAPOLATED_S, self.state, self.cov, now_us - fresh_us,
            self._walked_m2(now_us), *shift_ne_m, others,
        )  # fmt: skip
        return others

    def shape_std_m(self, now_us: int) -> float:
        """Horizontal rms error to expect of the shape of those located and heard of, aligned.

        Inf with fewer than two.
        """
        return shape_std_m(self.positions_ned_m(now_us), self.cov, self._members(now_us))

    def _present(self, now_us: int) -> Flags:
        """(N,) who has been heard of within `SILENCE_US`."""
        return np.asarray(self.tracks.newest_us >= max(now_us - SILENCE_US, 0))

    def _members(self, now_us: int) -> Flags:
        """(N,) those of them who are located: who has a part in the geometry."""
        return self.located & self._present(now_us)

    def _walked_m2(self, now_us: int) -> float:
        """What the odometry of two has lost since the filter's time, per axis of their difference."""
        return 2.0e-6 * self._drift_m2_s * max(now_us - self._time_us, 0)

    def _advance(self, time_us: int, *, decay: bool = False) -> None:
        """Propagate to ``time_us`` if that is news; see `intake.advance`."""
        advance(self._filter, self.members, self.state, self.cov, time_us, decay)

    @property
    def _time_us(self) -> int:
        return int(self._time.item())

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

    def _use_pending(self, now_us: int) -> None:
        """Use or hold the distances that odometry covers by now."""
        distances, geometry = self._distances, self._geometry
        while True:
            asked = use_pending(
                now_us, self._filter, self.members, self.tracks.rings, self.state, self.cov,
                distances.pairs, distances.pending, geometry.ne_m, geometry.bend_m,
                geometry.bend_var_m2,
            )  # fmt: skip
            if asked == DONE:
                return
            item = distances.last_pending(self._filter["between_ned_m"][0].copy())
            if asked == NOT_LOCATED:
                distances.hold(item, now_us)
            elif asked == ELSEWHERE:
                for row in (item.initiator, item.responder):
                    if self._trust.elsewhere(row):
                        self._restart(row)

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
            ends = item.initiator, item.responder
            count_distance(self._filter, self.members, *ends, item.time_us, weight, fused=True)

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

    def _problem(self, state: Array, cov: Array, active: Flags, located: Flags) -> InitialisationProblem:
        return InitialisationProblem(
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
