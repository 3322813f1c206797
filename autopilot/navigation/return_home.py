"""Return mode: up, to home or a rally point, down and landing, as PX4's direct return (RTL_TYPE 0).

It climbs on the spot, flies to the nearest of home and the rally points on a straight line with the nose
towards it, comes to rest there and lands; with a delay it first waits at the waiting height. Heights count
from the place returned to. Without a home it lands where it is. As with PX4 the place is chosen at the start
of a return: a home or rally points that are set later are for the next one.
"""

import math
from collections.abc import Sequence
from enum import Enum

from msgspec.structs import replace

from autopilot.navigation.guide import Guide, HomePosition, Moment, heading_rad, is_near
from autopilot.navigation.landing import IDLE, UP, Landing
from autopilot.navigation.mission import HeightFrame
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.plan_items import RallyPoint
from foundation.geometry.geodesy import geodetic_to_ned
from foundation.types import TrajectorySetpoint

_LEAST_CONE_RAD = math.radians(1.0)
_WIDEST_CONE_RAD = math.radians(89.0)
_AT_HOME_M = 10.0
"""A rally point this near to home is none (PX4's MAX_DIST_FROM_HOME_FOR_LAND_APPROACHES)."""
_CLEARLY_NEARER_M = 2.0
"""By so much a rally point must be nearer than what was chosen before it (PX4's MIN_DIST_THRESHOLD)."""


class ReturnPhase(Enum):
    """Where on the way the vehicle is."""

    CLIMB = "climb"
    FLY_HOME = "fly home"
    GO_DOWN = "go down"
    WAIT = "wait"
    LAND = "land"
    DONE = "done"


class ReturnEvent(Enum):
    """What ends a phase."""

    THERE = "there"
    THERE_TO_WAIT = "there, and told to wait before landing"
    WAITED = "waited"
    LANDED = "landed"
    LIFTED = "off the ground again"


TRANSITIONS: dict[tuple[ReturnPhase, ReturnEvent], ReturnPhase] = {
    (ReturnPhase.CLIMB, ReturnEvent.THERE): ReturnPhase.FLY_HOME,
    (ReturnPhase.CLIMB, ReturnEvent.THERE_TO_WAIT): ReturnPhase.FLY_HOME,
    (ReturnPhase.FLY_HOME, ReturnEvent.THERE): ReturnPhase.LAND,
    (ReturnPhase.FLY_HOME, ReturnEvent.THERE_TO_WAIT): ReturnPhase.GO_DOWN,
    (ReturnPhase.GO_DOWN, ReturnEvent.THERE): ReturnPhase.LAND,
    (ReturnPhase.GO_DOWN, ReturnEvent.THERE_TO_WAIT): ReturnPhase.WAIT,
    (ReturnPhase.WAIT, ReturnEvent.WAITED): ReturnPhase.LAND,
    (ReturnPhase.DONE, ReturnEvent.LIFTED): ReturnPhase.LAND,
} | {(phase, ReturnEvent.LANDED): ReturnPhase.DONE for phase in ReturnPhase if phase is not ReturnPhase.DONE}
"""What is not in the table changes nothing."""
_ON_THE_SPOT = {ReturnPhase.CLIMB, ReturnPhase.LAND}
"""Phases that keep the place that the way led to last."""


def return_height_m(distance_m: float, params: NavigationParams) -> float:
    """Height over the goal to return at, by the horizontal distance to it (PX4's RTL::computeReturnAltitude).

    Far away it is RTL_RETURN_ALT. Within RTL_MIN_DIST the cone is enough, but twice the acceptance radius is
    kept, and within that radius twice the distance: so the ground is not touched while moving sideways.
    """
    home = params.return_home
    radius_m = params.acceptance_m
    height_m = home.height_m
    if home.cone_half_angle_rad > 0.0:
        if distance_m <= radius_m:
            height_m = min(height_m, 2.0 * distance_m)
        elif distance_m <= home.min_distance_m:
            half_angle_rad = min(max(home.cone_half_angle_rad, _LEAST_CONE_RAD), _WIDEST_CONE_RAD)
            height_m = min(height_m, max(distance_m / math.tan(half_angle_rad), 2.0 * radius_m))
    return height_m


def nearest_rally_point(points: Sequence[RallyPoint], moment: Moment) -> RallyPoint | None:
    """Give the point to return to instead of home, as PX4's RTL::findClosestSafePoint; None: home."""
    if moment.home_ned_m is None:
        return None
    pos_ned_m, home_ned_m = moment.state.pos_ned_m, moment.home_ned_m
    nearest, nearest_m = None, math.dist(pos_ned_m[:2], home_ned_m[:2])
    for point in points:
        place_ned_m = _rally_ned_m(point, moment, home_ned_m)
        away_m = math.dist(pos_ned_m[:2], place_ned_m[:2])
        from_home_m = math.dist(place_ned_m[:2], home_ned_m[:2])
        if from_home_m > _AT_HOME_M and away_m + _CLEARLY_NEARER_M < nearest_m:
            nearest, nearest_m = point, away_m
    return nearest


def _rally_ned_m(point: RallyPoint, moment: Moment, home_ned_m: HomePosition) -> HomePosition:
    """Give where a rally point is, in NED metres from the estimator's origin."""
    state = moment.state
    north_m, east_m, _ = geodetic_to_ned(
        point.lat_deg,
        point.lon_deg,
        state.origin_alt_m,
        origin_lat_deg=state.origin_lat_deg,
        origin_lon_deg=state.origin_lon_deg,
        origin_alt_m=state.origin_alt_m,
    ).tolist()
    above_m = home_ned_m[2] if point.frame is HeightFrame.ABOVE_HOME else state.origin_alt_m
    return north_m, east_m, above_m - point.height_m


class ReturnHome:
    """One vehicle's way home; `start` it, then `update` at every step."""

    def __init__(self, guide: Guide, landing: Landing) -> None:
        self.phase = ReturnPhase.DONE
        self.rally_points: tuple[RallyPoint, ...] = ()
        """Where to return to as well; chosen among at the start of a return."""
        self._home_ned_m: HomePosition | None = None
        """Home as it was at the start."""
        self._goal_ned_m: HomePosition | None = None
        """What is returned to; None without a home."""
        self._guide = guide
        self._landing = landing
        self._return_down_m = 0.0
        self._waited_s = 0.0

    def start(self, moment: Moment, params: NavigationParams) -> None:
        """Set out from where the vehicle is."""
        state = moment.state
        self._waited_s = 0.0
        home_ned_m = goal_ned_m = self._home_ned_m = moment.home_ned_m
        point = nearest_rally_point(self.rally_points, moment)
        if point is not None and home_ned_m is not None:
            goal_ned_m = _rally_ned_m(point, moment, home_ned_m)
        self._goal_ned_m = goal_ned_m
        if moment.landed:
            self.phase = ReturnPhase.DONE
        elif goal_ned_m is None:
            self.phase = ReturnPhase.LAND
        else:
            down_m = float(state.pos_ned_m[2])
            distance_m = math.dist(state.pos_ned_m[:2], goal_ned_m[:2])
            wanted_m = goal_ned_m[2] - return_height_m(distance_m, params)
            self._return_down_m = min(down_m, wanted_m)
            self.phase = ReturnPhase.FLY_HOME if down_m <= wanted_m else ReturnPhase.CLIMB
        self._guide.restart(state)
        self._begin(moment, params)

    def resume(self, moment: Moment, params: NavigationParams) -> None:
        """Begin the present phase again from the present motion, for the estimate jumped."""
        guide = self._guide
        place_ned_m = guide.target_ned_m.copy()
        guide.restart(moment.state)
        if self.phase is ReturnPhase.LAND:
            place_ned_m[2] = guide.target_ned_m[2]
            guide.go_to(place_ned_m)
        self._begin(moment, params)

    def update(self, moment: Moment, params: NavigationParams) -> TrajectorySetpoint:
        """Give the next setpoint."""
        if moment.home_ned_m is not self._home_ned_m:
            moment = replace(moment, home_ned_m=self._home_ned_m)
        event = self._event(moment, params)
        if event is not None and (self.phase, event) in TRANSITIONS:
            self.phase = TRANSITIONS[self.phase, event]
            self._begin(moment, params)
        if self.phase is ReturnPhase.DONE:
            return IDLE
        if self.phase is ReturnPhase.LAND:
            return self._landing.update(moment, params)
        guide = self._guide
        if self.phase is ReturnPhase.FLY_HOME and not guide.resting:
            yaw_rad = heading_rad(
                params.yaw_mode, guide, guide.target_ned_m, moment.home_ned_m,
                near_m=params.return_home.min_distance_m,
            )  # fmt: skip
            if yaw_rad is not None:
                guide.turn_to(yaw_rad)
        return guide.follow(moment.dt_s, vehicle_pos_ned_m=moment.state.pos_ned_m)

    def _event(self, moment: Moment, params: NavigationParams) -> ReturnEvent | None:
        """Say what happened since the last step."""
        if moment.landed:
            return ReturnEvent.LANDED
        if self.phase is ReturnPhase.DONE:
            return ReturnEvent.LIFTED
        delay_s = params.return_home.land_delay_s
        if self.phase is ReturnPhase.WAIT:
            self._waited_s += moment.dt_s
            return ReturnEvent.WAITED if 0.0 <= delay_s <= self._waited_s else None
        guide = self._guide
        # up in the air it passes on while still moving; at home it has to have come to rest
        there = (self.phase is ReturnPhase.CLIMB or guide.resting) and is_near(
            moment.state.pos_ned_m,
            guide.target_ned_m,
            radius_m=params.acceptance_m,
            height_m=params.altitude_acceptance_m,
        )
        if not there:
            return None
        return ReturnEvent.THERE if delay_s == 0.0 else ReturnEvent.THERE_TO_WAIT

    def _begin(self, moment: Moment, params: NavigationParams) -> None:
        """Set the guide on the present phase's way."""
        guide, goal_ned_m = self._guide, self._goal_ned_m
        if self.phase is ReturnPhase.DONE:
            return
        if self.phase is ReturnPhase.LAND:
            self._landing.start(moment.state)
        target_ned_m = guide.target_ned_m.copy()
        if goal_ned_m is not None and self.phase not in _ON_THE_SPOT:
            target_ned_m[:2] = goal_ned_m[:2]
        if self.phase in {ReturnPhase.CLIMB, ReturnPhase.FLY_HOME}:
            target_ned_m[2] = self._return_down_m
        elif self.phase in {ReturnPhase.GO_DOWN, ReturnPhase.WAIT} and goal_ned_m is not None:
            target_ned_m[2] = max(self._return_down_m, goal_ned_m[2] - params.return_home.descend_height_m)
        # up and down lines are plumb, so that stopping on the way costs no height
        guide.go_to(target_ned_m, along_ned=None if self.phase is ReturnPhase.FLY_HOME else UP)
