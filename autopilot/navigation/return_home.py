"""Return mode: climb, flight to home or a rally point, landing; as PX4's direct return (RTL_TYPE 0).

The vehicle climbs vertically, flies in a straight line to the nearest of home and the rally points with the
nose towards it, comes to rest there and lands; with a delay it first waits at the waiting height. Heights are
relative to the destination. Without a home position it lands where it is. As in PX4 the destination is
selected at the start of a return; later changes of home or rally points apply to the next one.
"""

import math
from collections.abc import Sequence
from enum import Enum

from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.mode_table import FLIES_TO_A_PLACE, ModeTraits
from autopilot.navigation.flight_mode import (
    IDLE,
    HomePosition,
    ModeContext,
    ModeEntry,
    ModeInputs,
    Moment,
    StopMode,
)
from autopilot.navigation.landing import UP, LandMode
from autopilot.navigation.mission import HeightFrame
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.plan_store import RallyPoint
from autopilot.navigation.site_frame import horizontal_ned_m
from foundation.types import Course, TrajectorySetpoint

_LEAST_CONE_RAD = math.radians(1.0)
_WIDEST_CONE_RAD = math.radians(89.0)
_AT_HOME_M = 10.0
"""A rally point nearer to home than this is ignored (PX4's MAX_DIST_FROM_HOME_FOR_LAND_APPROACHES)."""
_CLEARLY_NEARER_M = 2.0
"""A rally point must be nearer by this than the previous choice (PX4's MIN_DIST_THRESHOLD)."""


class ReturnPhase(Enum):
    """Phases of a return."""

    CLIMB = "climb"
    FLY_HOME = "fly home"
    GO_DOWN = "go down"
    WAIT = "wait"
    LAND = "land"
    DONE = "done"


class ReturnEvent(Enum):
    """Events that end a phase."""

    THERE = "arrived"
    THERE_TO_WAIT = "arrived, with a wait before landing"
    WAITED = "waited"
    LANDED = "landed"
    LIFTED = "left the ground again"


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
"""Other combinations have no effect."""
_ON_THE_SPOT = {ReturnPhase.CLIMB, ReturnPhase.LAND}
"""Phases that keep the horizontal position of the last target."""


def return_height_m(distance_m: float, params: NavigationParams) -> float:
    """Return the height over the destination at which to return, by the horizontal distance to it.

    As PX4's RTL::computeReturnAltitude: RTL_RETURN_ALT at a distance. Within RTL_MIN_DIST the cone limits it,
    to at least twice the acceptance radius, and within that radius it is twice the distance, so that the
    vehicle does not touch the ground while it moves horizontally.
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
    """Return the rally point to return to, as PX4's RTL::findClosestSafePoint, or None for home."""
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
    """Return the position of a rally point, in NED metres from the estimator's origin."""
    state = moment.state
    north_m, east_m = horizontal_ned_m(point.lat_deg, point.lon_deg, state).tolist()
    above_m = home_ned_m[2] if point.frame is HeightFrame.ABOVE_HOME else state.origin_alt_m
    return north_m, east_m, above_m - point.height_m


class ReturnMode(StopMode):
    """Flies home or to a rally point, and lands."""

    traits = ModeTraits(
        needs=FLIES_TO_A_PLACE | Condition.HOME, of_one_flight=True,
        standard=common.MAV_STANDARD_MODE_SAFE_RECOVERY,
    )  # fmt: skip

    def __init__(self, context: ModeContext, landing: LandMode) -> None:
        super().__init__(context)
        self.phase = ReturnPhase.DONE
        self.rally_points: tuple[RallyPoint, ...] = ()
        """Alternative destinations, evaluated at the start of a return."""
        self._home_ned_m: HomePosition | None = None
        """Home position at the start."""
        self._goal_ned_m: HomePosition | None = None
        """Destination; None without a home position."""
        self._landing = landing
        self._return_down_m = 0.0
        self._waited_s = 0.0

    @property
    def course(self) -> Course:
        """Landing in the last phase."""
        return Course.LANDING if self.phase is ReturnPhase.LAND else Course.OTHER

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Change the ground speed of the legs."""
        self._context.change_speed(speed_m_s)

    def enter(self, entry: ModeEntry) -> None:
        """Start a return, or continue it."""
        self._context.apply_leg_limits()
        if entry.again:
            self._resume(entry)
        else:
            self._start(entry)

    def _start(self, moment: Moment) -> None:
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
            return_down_m = goal_ned_m[2] - return_height_m(distance_m, self._context.params)
            self._return_down_m = min(down_m, return_down_m)
            self.phase = ReturnPhase.FLY_HOME if down_m <= return_down_m else ReturnPhase.CLIMB
        self._guide.restart(state)
        self._begin(moment)

    def _resume(self, moment: Moment) -> None:
        """Restart the present phase from the present motion, after a reset of the estimate."""
        guide = self._guide
        place_ned_m = guide.target_ned_m.copy()
        guide.restart(moment.state)
        if self.phase is ReturnPhase.LAND:
            place_ned_m[2] = guide.target_ned_m[2]
            guide.go_to(place_ned_m)
        self._begin(moment)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the present phase."""
        if inputs.home_ned_m is not self._home_ned_m:
            inputs = replace(inputs, home_ned_m=self._home_ned_m)
        event = self._event(inputs)
        if event is not None and (self.phase, event) in TRANSITIONS:
            self.phase = TRANSITIONS[self.phase, event]
            self._begin(inputs)
        if self.phase is ReturnPhase.DONE:
            return IDLE
        if self.phase is ReturnPhase.LAND:
            return self._landing.update(inputs)
        guide, context = self._guide, self._context
        if self.phase is ReturnPhase.FLY_HOME and not guide.resting:
            near_m = context.params.return_home.min_distance_m
            context.turn_by_yaw_mode(guide.target_ned_m, inputs.home_ned_m, near_m=near_m)
        return guide.update(inputs.dt_s, vehicle_pos_ned_m=inputs.state.pos_ned_m)

    def _event(self, moment: Moment) -> ReturnEvent | None:
        if moment.landed:
            return ReturnEvent.LANDED
        if self.phase is ReturnPhase.DONE:
            return ReturnEvent.LIFTED
        params = self._context.params
        delay_s = params.return_home.land_delay_s
        if self.phase is ReturnPhase.WAIT:
            self._waited_s += moment.dt_s
            return ReturnEvent.WAITED if 0.0 <= delay_s <= self._waited_s else None
        guide = self._guide
        # a climb is complete while still moving; at home the vehicle must be at rest
        there = (self.phase is ReturnPhase.CLIMB or guide.resting) and self._context.is_near(
            moment.state, guide.target_ned_m, radius_m=params.acceptance_m
        )
        if not there:
            return None
        return ReturnEvent.THERE if delay_s == 0.0 else ReturnEvent.THERE_TO_WAIT

    def _begin(self, moment: Moment) -> None:
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
            wait_m = self._context.params.return_home.descend_height_m
            target_ned_m[2] = max(self._return_down_m, goal_ned_m[2] - wait_m)
        # vertical legs are exactly vertical, so that braking horizontally does not change the height
        guide.go_to(target_ned_m, along_ned=None if self.phase is ReturnPhase.FLY_HOME else UP)
