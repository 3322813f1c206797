"""Cooperative localisation at one UAV: estimates the positions of all UAVs of the neighbourhood.

A Kalman filter (`kernels`) estimates the offset between each UAV's odometry and its true position, and each
UAV's GPS bias. The GPS of all UAVs determines the position and heading of the formation, the distances its
shape. Measurements may arrive late and in any order; each is compared with the odometry of its own time,
waits until the odometry of both ends covers that time, and is used once. UAVs join the filter in a batch
(`batch_initialisation`), because the filter must start near the truth.

Robustness: the weight of every measurement falls with its misfit. A UAV is initialised again if all its
distances misfit, and tentatively if some of them do for long; the measurements of a UAV that measures wrongly
are excluded (`trust`). If the estimated GPS error of a UAV exceeds the accuracy that its receiver states, its
bias variance is raised; after a step the bias is reset (`receivers`).
"""

import math
from collections.abc import Sequence

import numpy as np

from autopilot.onboard.localisation import measurement_update as fusion
from autopilot.onboard.localisation.batch_initialisation import Flags, InitialisationProblem, Joined, links
from autopilot.onboard.localisation.distances import Distances, add_distance
from autopilot.onboard.localisation.kernels import BIAS, STATES, Array
from autopilot.onboard.localisation.members import new_filter, new_members
from autopilot.onboard.localisation.model import SILENCE_US, LocalisationModel
from autopilot.onboard.localisation.receivers import Receivers, clear, rate
from autopilot.onboard.localisation.reference_geometry import ReferenceGeometry, shape_std_m
from autopilot.onboard.localisation.shortfall import shortfall
from autopilot.onboard.localisation.tracks import EXTRAPOLATED_S, Tracks, odometry_at
from autopilot.onboard.localisation.trust import ELSEWHERE_LIMIT, Trust, distrust
from autopilot.onboard.localisation.uncertainty import SEEN, Others, seen_from, variance_between
from autopilot.onboard.radio.neighbour_table import NeighbourTable
from foundation.types import Vector

JUMP_SHARE = 0.1
"""Standard deviation of an odometry jump, as a share of its size."""
GEOMETRY_PERIOD_US = 1_000_000
"""Period at which the reference geometry is checked for a turn of the formation."""


class CooperativeLocalisation:
    """Filter over N UAVs that runs at one of them.

    Args:
        own: index of the UAV that runs it.
        places_ned_m: (N, 3) the formation's places, site NED.
        model: noise model.

    Attributes:
        state: (5N,) and ``cov`` (5N, 5N), with the layout of `kernels`.
        members: (N,) of `MEMBER`, a row per UAV; ``located`` and ``active`` are its columns.
        restarts: number of times that a UAV's estimate was found to be wrong.
        odometry_jumps: number of odometry restarts, detected by a step or reported by `restart`.
        gps_steps: number of detected steps of a GPS error.

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
        # Views of the fields read in every loop: making a view takes longer than reading it.
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

    def read(self, table: NeighbourTable, now_us: int) -> None:
        """Process all received beacons; those of localised UAVs update the filter."""
        pages, distances = table.pages, self._distances
        while True:
            action = fusion.read_beacons(
                pages.count, now_us, pages.rows, table.listener, table.stations, table.rows,
                self._filter, self.members, self.tracks.rings, self.state, self.cov,
                distances.pairs, distances.pending,
            )  # fmt: skip
            if action == fusion.DONE:
                pages.count = 0
                return
            self._do(action, table.sender_row)

    def on_odometry(
        self, station: int, time_us: int, odometry_ned_m: Sequence[float], vel_ned_m_s: Sequence[float]
    ) -> None:
        """Process odometry of a UAV (integrated velocity, barometric height); old odometry is ignored."""
        while True:
            action = fusion.take_odometry(
                self._filter, self.members, self.tracks.rings, station, time_us, *odometry_ned_m, *vel_ned_m_s
            )
            if action == fusion.DONE:
                return
            self._do(action, station)

    def on_fix(
        self, station: int, time_us: int, pos_ned_m: Sequence[float], std_h_m: float | None = None,
        std_v_m: float | None = None,
    ) -> bool:  # fmt: skip
        """Process a GPS position (site NED) and the accuracies that the receiver states; None: not stated.

        Returns whether the fix has been used; otherwise it may be passed again when there is odometry of its
        time.
        """
        north_m, east_m, down_m = pos_ned_m
        action = fusion.take_fix(
            self._filter, self.members, self.tracks.rings, self.state, self.cov, station,
            time_us, north_m, east_m, down_m, std_h_m or 0.0, std_v_m or 0.0,
        )  # fmt: skip
        if action != fusion.DONE:
            self._do(action, station)
        return bool(self._receivers.newest_us.item(station) >= time_us)

    def on_range(
        self, initiator: int, responder: int, time_us: int, distance_m: float, std_m: float, *, now_us: int
    ) -> None:
        """Add a distance measured by ``initiator``, as `add_distance`, if the responder is in the filter."""
        if responder < self.count:
            distances, variance_m2 = self._distances, std_m**2 + self._model.range_floor_std_m**2
            distances.make_room()
            add_distance(
                distances.pairs, distances.pending, self._filter, initiator, responder, time_us, distance_m,
                variance_m2, now_us,
            )  # fmt: skip

    def _do(self, action: int, row: int) -> None:
        """Perform an action that a kernel of `measurement_update` requires for a UAV."""
        if action == fusion.SENDER_RESTARTED:
            self.restart(row)
        elif action == fusion.LOST:
            self._lose(row)
        elif action == fusion.ODOMETRY_JUMPED:
            self._compensate_jump(row)
        elif action == fusion.FIRST_MEAN:
            self._activate(row)
        elif action == fusion.GPS_STEPPED:
            self.gps_steps += 1
            self._receivers.reset_bias(row, self.state, self.cov, self._filter["gps_var_m2"].item())
        else:
            self._distances.make_room()

    def _compensate_jump(self, row: int) -> None:
        """Compensate a jump of a UAV's odometry in its offset, so that its position estimate stays."""
        self.odometry_jumps += 1
        self.members["fixes"][row] = 0
        self._distances.drop(row)
        for a, jump_m in enumerate(self._filter["step_ne_m"][0].tolist()):
            self._receivers.less_odometry_ned_m[row, a] -= jump_m
            self.state[STATES * row + a] -= jump_m
            self.cov[STATES * row + a, STATES * row + a] += (JUMP_SHARE * jump_m) ** 2

    def restart(self, station: int) -> None:
        """Remove a UAV, before odometry with a new origin is processed, until it has GPS and distances."""
        self.odometry_jumps += 1
        self._lose(station)

    def update(self, now_us: int) -> None:
        """Fuse the distances that odometry covers by now, let UAVs join, and check for faults."""
        due = now_us >= self._geometry_due_us
        if due or self._returned.item():
            self._returned[0] = 0
            self._geometry.keep(self._members(now_us), self.positions_ned_m(now_us), self.cov)
        self._use_pending(now_us)
        if self._distances.held:
            self._locate(now_us)
        if due:
            self._geometry_due_us = now_us + GEOMETRY_PERIOD_US
            used = self.count_of("ranges_used")
            self._filter["distances_hz"] = 2e6 * (used - self._counted) / (self.count * GEOMETRY_PERIOD_US)
            self._counted = used
            suspects = self._trust.suspects(now_us, np.flatnonzero(self._members(now_us)))
            if suspects:
                self._try_afresh(suspects, now_us)

    def advance(self, time_us: int, *, decay: bool = True) -> None:
        """Propagate the filter, slow errors only with ``decay`` or if a stride of theirs has passed."""
        stride_us = 0 if decay else int(self._filter["decay_stride_us"].item())
        fusion.advance(self._filter, self.members, self.state, self.cov, time_us, stride_us)

    def count_of(self, name: str) -> int:
        """Return the number of distances compared with the estimate (ranges_used), or of other ones.

        ranges_downweighted: those of them that misfitted; ranges_too_late: those dropped because odometry of
        their time was not available.
        """
        return int(self._filter[name].item())

    @property
    def own_range_us(self) -> int:
        """Measurement time of the own UAV's newest fused distance, as either end; -1: none."""
        return int(self._own_range.item())

    def offset_ne_m(self) -> tuple[float, float]:
        """Return the estimated true position minus odometry of the own UAV, north and east, m."""
        north_m, east_m = self._own_offset_ne_m.tolist()
        return north_m, east_m

    def positions_ned_m(self, now_us: int) -> Array:
        """Return (N, 3) estimated positions, site NED, extrapolated by velocity for 1 s at most."""
        return self.tracks.now_ned_m(now_us) + self.state.reshape(-1, STATES)[:, :3]

    def std_ned_m(self) -> Vector:
        """Return one sigma of the own position, NED, including the error of the formation as a whole."""
        variances_m2 = self._own_variances_m2.tolist()
        north_m, east_m, down_m = (math.sqrt(max(m2, 0.0)) for m2 in variances_m2)  # below 0 by rounding
        return north_m, east_m, down_m

    def odometry_at(self, station: int, time_us: int) -> Array | None:
        """Return (3,) odometry of a UAV, NED, at a time of the last seconds; None if not available."""
        odometry_ned_m = np.empty(3)
        return odometry_ned_m if odometry_at(self.tracks.rings, station, time_us, odometry_ned_m) else None

    def gps_error(self, station: int) -> tuple[Vector, float]:
        """Return the estimated GPS error of a UAV, NED, m, and its standard deviation per horizontal axis.

        The horizontal error is the bias; the vertical one is that of the last fixes against the barometer.
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
        """Return the variance, m^2, of the distance to a UAV now; None while either end is not located."""
        if not (self.located[self.own] and self.located[peer]):
            return None
        relative_m2: float = variance_between(self.cov, self.own, peer, self.members, self.state)
        return relative_m2 + self._walked_m2(now_us)

    def others(self, now_us: int, *, fresh_us: int, shift_ne_m: tuple[float, float] = (0.0, 0.0)) -> Others:
        """Return the estimates of all UAVs, shifted; the next call overwrites the array.

        A UAV is fresh if it is located and its newest odometry is at most ``fresh_us`` old.
        """
        others = self._others
        seen_from(
            self.own, now_us, self.members, EXTRAPOLATED_S, self.state, self.cov, now_us - fresh_us,
            self._walked_m2(now_us), *shift_ne_m, others,
        )  # fmt: skip
        return others

    def shape_std_m(self, now_us: int) -> float:
        """Return the expected rms shape error, m, of the located UAVs present; see `reference_geometry`."""
        return shape_std_m(self.positions_ned_m(now_us), self.cov, self._members(now_us))

    def shortfall(self, now_us: int, limit_m: float) -> str:
        """Return why the shape is not known to ``limit_m``; see `shortfall`."""
        measured = self._distances.pairs["newest_us"] >= 0
        return shortfall(
            own=self.own, present=self._present(now_us), measured=measured | measured.T, located=self.located,
            places_ned_m=self._places_ned_m, shape_std_m=self.shape_std_m(now_us), limit_m=limit_m,
            gps_std_m=self._model.gps_bias_std_m,
        )  # fmt: skip

    def _present(self, now_us: int) -> Flags:
        """Return (N,) whether a UAV's newest odometry is at most `SILENCE_US` old."""
        return np.asarray(self.tracks.newest_us >= max(now_us - SILENCE_US, 0))

    def _members(self, now_us: int) -> Flags:
        """Return (N,) whether a UAV is present and located, and thus part of the geometry."""
        return self.located & self._present(now_us)

    def _walked_m2(self, now_us: int) -> float:
        """Return the variance, per axis, of two UAVs' odometry difference since the filter's time."""
        return 2.0e-6 * self._drift_m2_s * max(now_us - self._time_us, 0)

    @property
    def _time_us(self) -> int:
        return int(self._time.item())

    def _lose(self, station: int) -> None:
        """Remove a UAV until it has new odometry, GPS and distances."""
        self.tracks.forget(station)
        self.members["fixes"][station] = self.members["misfits"][station] = 0
        self._trust.forget(station)
        self.located[station] = self.active[station] = False
        clear(station, self.state, self.cov)
        self._distances.drop(station)
        remaining = self._members(self.tracks.newest_us.item(self.own))
        if remaining[self.own] and remaining.sum() == 1:
            # Going on with the own GPS alone, this filter would diverge from those of the other UAVs.
            self._trust.forget(self.own)
            self.located[self.own] = False
            self._activate(self.own)

    def _activate(self, station: int) -> None:
        """Initialise a UAV with its GPS alone, of the stated accuracy, regardless of its estimated bias."""
        self.members["bias_var_m2"][station] = self.members["stated_var_m2"][station]
        self._receivers.begin(station, self.state, self.cov)
        self.active[station] = True

    def _use_pending(self, now_us: int) -> None:
        """Fuse or hold the distances that odometry covers by now."""
        distances, geometry = self._distances, self._geometry
        while True:
            action = fusion.use_pending(
                now_us, self._filter, self.members, self.tracks.rings, self.state, self.cov,
                distances.pairs, distances.pending, geometry.ne_m, geometry.bend_m,
                geometry.bend_var_m2,
            )  # fmt: skip
            if action == fusion.DONE:
                return
            item = distances.last_pending(self._filter["between_ned_m"][0].copy())
            if action == fusion.NOT_LOCATED:
                distances.hold(item, now_us)
            elif action == fusion.ELSEWHERE:
                for row in (item.initiator, item.responder):
                    if self.members["as_end"].item(row) > ELSEWHERE_LIMIT:
                        self._restart(row)

    def _locate(self, now_us: int) -> None:
        """Let the UAVs with held distances join, once the distances are complete or gathered long enough."""
        present = self._present(now_us)
        linked = links(self._distances.held.values(), self.count) | np.eye(self.count, dtype=bool)
        fallen_silent = ~present & (self.tracks.newest_us >= 0)
        complete = (self.active | fallen_silent).all() and linked[present & ~self.located][:, present].all()
        if not complete and now_us - self._distances.held_since_us < self._model.gather_s * 1e6:
            return
        held = self._distances.release()
        self.advance(max(item.time_us for item in held), decay=False)
        problem = self._problem(self.state, self.cov, self.active & present, self.located & present)
        joined = problem.join(held)
        if joined is None:
            return
        self._take_in(joined, now_us)
        for item, weight in zip(joined.batch, joined.solution.weights, strict=True):
            ends = item.initiator, item.responder
            fusion.count_distance(self._filter, self.members, *ends, item.time_us, weight, fused=True)

    def _try_afresh(self, suspects: set[int], now_us: int) -> None:
        """Initialise suspected UAVs again; without a solution that fits all of them, nothing changes."""
        within_us = max(self._model.gather_s * 1e6, SILENCE_US)
        held = self._distances.fused_of(suspects, now_us, within_us=within_us)
        if not held:
            return
        present = self._present(now_us)
        self.advance(max(item.time_us for item in held), decay=False)
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
        """Copy a solution into the filter and update the geometry and the statistics."""
        self.state[:], self.cov[:] = joined.solution.state, joined.solution.cov
        self.located |= joined.joining
        members, pos_ned_m = self._members(now_us), self.positions_ned_m(now_us)
        self._geometry.fix(joined.joining, members, pos_ned_m, self.cov)
        self._geometry.keep(members, pos_ned_m, self.cov)
        for station in np.flatnonzero(joined.joining).tolist():
            self._trust.forget(station)
            rate(self.members, station, self.state)
        for station in joined.faulty:
            distrust(self.members, station)

    def _restart(self, station: int) -> None:
        """Reset a UAV, whose estimate is wrong, to its GPS."""
        self.restarts += 1
        self._trust.forget(station)
        self.located[station] = False
        self._activate(station)
