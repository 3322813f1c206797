"""Vehicles in trouble, and a machine that is too slow, found in the messages of a run.

Cores: the messages include all times.
"""

import math
from collections import deque
from typing import NamedTuple

from foundation.types import Vector
from harness.launch.run_messages import Message
from harness.simulator.messages import ApplicationLost, Progress, VehicleLost, VehicleSilent, VehicleTruth

FAR_M = 5.0
"""A vehicle on station that is farther from its place is in trouble.

The horizontal error of the consumer GPS, 1.5 m along each axis, is larger in 0.4 % of all cases, and ranging
reduces it.
"""
STUCK_S, STUCK_M = 30.0, 2.0
"""A vehicle on its way that in this simulated time neither changes its phase nor moves this far is in
trouble.

The article's formation is reached within half of it.
"""
IN_THE_AIR_M = 1.0
LAG_WINDOW_S, LAG_SHARE = 10.0, 0.1
"""A machine is too slow if in each half of the window it falls behind by more than this share of the half.

A tenth is what a watch beside the run shows: 6 s after a minute. A single stop of the machine, as when
processes load at the start, lies in one half.
"""


def error_m(vehicle: VehicleTruth) -> float | None:
    """Return the distance from its place; None for a vehicle whose application does not fly to its place."""
    return vehicle.error_m if vehicle.alive and vehicle.is_placed else None


class Trouble(NamedTuple):
    """What is wrong with a vehicle; troubles are sorted by urgency, then by vehicle."""

    urgency: int
    """0 is the most urgent."""
    instance: int
    text: str


class _Place(NamedTuple):
    phase: str
    pos_ned_m: Vector
    time_us: int


class Troubles:
    """Follows the messages of a run and returns the vehicles in trouble, each with its worst one.

    ``forms``: whether all vehicles are to fly to their places; otherwise a ground station flies them, and
    leaving the formation is no trouble.
    """

    def __init__(self, *, forms: bool) -> None:
        self._forms = forms
        self._lost: dict[int, str] = {}
        self._without_application: dict[int, str] = {}
        self._silent: dict[int, VehicleSilent] = {}
        self._places: dict[int, _Place] = {}

    def update(self, message: Message) -> None:
        """Note a message of the run."""
        match message:
            case VehicleLost():
                self._lost[message.instance] = message.reason
            case ApplicationLost():
                self._without_application[message.instance] = message.reason
            case VehicleSilent():
                self._silent[message.instance] = message
            case Progress():
                # simulated time stops at a silent vehicle: it has passed, so the vehicle has answered
                self._silent = {i: m for i, m in self._silent.items() if m.time_us >= message.time_us}
                for i, vehicle in enumerate(message.vehicles):
                    self._follow(i, vehicle, message.time_us)

    def found(self, progress: Progress) -> list[Trouble]:
        """Return the troubles in the run's newest state."""
        each = (self._of(i, vehicle, progress.time_us) for i, vehicle in enumerate(progress.vehicles))
        return sorted(trouble for trouble in each if trouble is not None)

    def _follow(self, instance: int, vehicle: VehicleTruth, time_us: int) -> None:
        place = self._places.get(instance)
        if (
            place is None
            or place.phase != vehicle.phase
            or math.dist(place.pos_ned_m, vehicle.pos_ned_m) > STUCK_M
        ):
            self._places[instance] = _Place(vehicle.phase, vehicle.pos_ned_m, time_us)

    def _of(self, instance: int, vehicle: VehicleTruth, time_us: int) -> Trouble | None:
        height_m = -vehicle.pos_ned_m[2]
        if not vehicle.alive:
            reason = self._lost.get(instance)
            return Trouble(0, instance, "lost" + (f": {reason}" if reason else ""))
        if (silent := self._silent.get(instance)) is not None:
            return Trouble(1, instance, f"silent for {silent.wall_silence_s:.1f} s of wall time")
        if not vehicle.armed and height_m > IN_THE_AIR_M:
            return Trouble(2, instance, f"disarmed at a height of {height_m:.1f} m")
        if (reason := self._without_application.get(instance)) is not None:
            return Trouble(3, instance, f"without its application: {reason}; mode {vehicle.mode}")
        if self._forms and vehicle.aim == "dropped":
            return Trouble(3, instance, f"has left the formation: mode {vehicle.mode}, {height_m:.1f} m high")
        if vehicle.aim == "reached" and vehicle.is_placed and vehicle.error_m > FAR_M:
            return Trouble(4, instance, f"{vehicle.error_m:.1f} m from its place")
        place = self._places.get(instance)
        if vehicle.aim == "ahead" and place is not None:
            since_s = (time_us - place.time_us) * 1e-6
            if since_s > STUCK_S:
                return Trouble(5, instance, f"no progress for {since_s:.0f} s: {vehicle.phase}")
        return None


class Lag:
    """Notices, once, that the machine is too slow for the requested speed."""

    def __init__(self) -> None:
        self._marks: deque[tuple[float, float]] = deque()
        self._advised = False

    def update(self, progress: Progress, factor: float | None) -> str | None:
        """Return a line of advice when the lag has grown steadily: see `LAG_WINDOW_S`.

        ``factor`` is the present speed, simulated over wall time.
        """
        now_s, half_s = progress.wall_s, LAG_WINDOW_S / 2.0
        if progress.paused:
            self._marks.clear()
        self._marks.append((now_s, progress.lag_s))
        # the first mark is the last one before the window
        while len(self._marks) > 1 and now_s - self._marks[1][0] >= LAG_WINDOW_S:
            self._marks.popleft()
        first_s, first_lag_s = self._marks[0]
        if self._advised or now_s - first_s < LAG_WINDOW_S:
            return None
        middle_lag_s = next(lag_s for wall_s, lag_s in self._marks if now_s - wall_s <= half_s)
        least_s = min(middle_lag_s - first_lag_s, progress.lag_s - middle_lag_s)
        if least_s <= LAG_SHARE * half_s:
            return None
        self._advised = True
        reached = "" if factor is None else f": it reaches {factor:.2f} x real time"
        return (
            f"this machine is too slow for the requested speed{reached}; fly fewer vehicles (--agents), "
            "choose a lower --speed, or close other programs"
        )
