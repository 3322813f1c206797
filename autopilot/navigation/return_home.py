"""Return mode: up, home, down and landing, as PX4's direct return to home.

It climbs on the spot, flies to home on a straight line with the nose towards it, comes to rest there and
lands; with a delay it first waits at the waiting height. Without a home it lands where it is.
"""

import math
from enum import Enum

from autopilot.navigation.guide import Guide, Moment, heading_rad, is_near
from autopilot.navigation.landing import IDLE, UP, Landing
from autopilot.navigation.params import NavigationParams
from autopilot.types import TrajectorySetpoint

_LEAST_CONE_RAD = math.radians(1.0)
_WIDEST_CONE_RAD = math.radians(89.0)


class Phase(Enum):
    """Where on the way the vehicle is."""

    CLIMB = "climb"
    FLY_HOME = "fly home"
    GO_DOWN = "go down"
    WAIT = "wait"
    LAND = "land"
    DONE = "done"


class Event(Enum):
    """What ends a phase."""

    THERE = "there"
    THERE_TO_WAIT = "there, and told to wait before landing"
    WAITED = "waited"
    LANDED = "landed"
    LIFTED = "off the ground again"


TRANSITIONS: dict[tuple[Phase, Event], Phase] = {
    (Phase.CLIMB, Event.THERE): Phase.FLY_HOME,
    (Phase.CLIMB, Event.THERE_TO_WAIT): Phase.FLY_HOME,
    (Phase.FLY_HOME, Event.THERE): Phase.LAND,
    (Phase.FLY_HOME, Event.THERE_TO_WAIT): Phase.GO_DOWN,
    (Phase.GO_DOWN, Event.THERE): Phase.LAND,
    (Phase.GO_DOWN, Event.THERE_TO_WAIT): Phase.WAIT,
    (Phase.WAIT, Event.WAITED): Phase.LAND,
    (Phase.DONE, Event.LIFTED): Phase.LAND,
} | {(phase, Event.LANDED): Phase.DONE for phase in Phase if phase is not Phase.DONE}
"""What is not in the table changes nothing."""


def return_height_m(distance_m: float, params: NavigationParams) -> float:
    """Height over home to return at, from a horizontal distance to it (PX4's RTL::computeReturnAltitude).

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


class ReturnHome:
    """One vehicle's way home; `start` it, then `update` at every step."""

    def __init__(self, guide: Guide, landing: Landing) -> None:
        self.phase = Phase.DONE
        self._guide = guide
        self._landing = landing
        self._return_down_m = 0.0
        self._waited_s = 0.0

    def start(self, moment: Moment, params: NavigationParams) -> None:
        """Set out from where the vehicle is."""
        state, home_ned_m = moment.state, moment.home_ned_m
        self._waited_s = 0.0
        if moment.landed:
            self.phase = Phase.DONE
        elif home_ned_m is None:
            self.phase = Phase.LAND
        else:
            down_m = float(state.pos_ned_m[2])
            wanted_m = home_ned_m[2] - return_height_m(self.distance_m(moment), params)
            self._return_down_m = min(down_m, wanted_m)
            self.phase = Phase.FLY_HOME if down_m <= wanted_m else Phase.CLIMB
        self.resume(moment, params)

    def resume(self, moment: Moment, params: NavigationParams) -> None:
        """Begin the present phase again from the present motion, for the estimate jumped."""
        self._guide.restart(moment.state)
        self._begin(moment, params)

    def distance_m(self, moment: Moment) -> float:
        """Horizontal distance to home; 0 without one."""
        home = moment.home_ned_m
        pos = moment.state.pos_ned_m
        return 0.0 if home is None else math.hypot(pos[0] - home[0], pos[1] - home[1])

    def update(self, moment: Moment, params: NavigationParams) -> TrajectorySetpoint:
        """Give the next setpoint."""
        event = self._event(moment, params)
        if event is not None and (self.phase, event) in TRANSITIONS:
            self.phase = TRANSITIONS[self.phase, event]
            self._begin(moment, params)
        if self.phase is Phase.DONE:
            return IDLE
        if self.phase is Phase.LAND:
            return self._landing.update(moment, params)
        guide = self._guide
        if self.phase is Phase.FLY_HOME and not guide.resting:
            yaw_rad = heading_rad(
                params.yaw_mode, guide, guide.target_ned_m, moment.home_ned_m,
                near_m=params.return_home.min_distance_m,
            )  # fmt: skip
            if yaw_rad is not None:
                guide.turn_to(yaw_rad)
        return guide.follow(moment.dt_s, vehicle_pos_ned_m=moment.state.pos_ned_m)

    def _event(self, moment: Moment, params: NavigationParams) -> Event | None:
        """Say what happened since the last step."""
        if moment.landed:
            return Event.LANDED
        if self.phase is Phase.DONE:
            return Event.LIFTED
        delay_s = params.return_home.land_delay_s
        if self.phase is Phase.WAIT:
            self._waited_s += moment.dt_s
            return Event.WAITED if 0.0 <= delay_s <= self._waited_s else None
        guide = self._guide
        # up in the air it passes on while still moving; at home it has to have come to rest
        there = (self.phase is Phase.CLIMB or guide.resting) and is_near(
            moment.state.pos_ned_m,
            guide.target_ned_m,
            radius_m=params.acceptance_m,
            height_m=params.altitude_acceptance_m,
        )
        if not there:
            return None
        return Event.THERE if delay_s == 0.0 else Event.THERE_TO_WAIT

    def _begin(self, moment: Moment, params: NavigationParams) -> None:
        """Set the guide on the present phase's way."""
        guide, home_ned_m = self._guide, moment.home_ned_m
        if self.phase is Phase.DONE:
            return
        if self.phase is Phase.LAND:
            self._landing.start(moment.state)
        target_ned_m = guide.target_ned_m.copy()
        if home_ned_m is not None and self.phase is not Phase.CLIMB:
            target_ned_m[:2] = home_ned_m[:2]
        if self.phase in {Phase.CLIMB, Phase.FLY_HOME}:
            target_ned_m[2] = self._return_down_m
        elif self.phase in {Phase.GO_DOWN, Phase.WAIT} and home_ned_m is not None:
            target_ned_m[2] = max(self._return_down_m, home_ned_m[2] - params.return_home.descend_height_m)
        # up and down lines are plumb, so that stopping on the way costs no height
        guide.go_to(target_ned_m, along_ned=None if self.phase is Phase.FLY_HOME else UP)
