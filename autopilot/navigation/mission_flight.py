"""Flight of mission items: straight legs, corners flown without a stop, stays, take-off and landing.

At a waypoint without a stop the guide's target is beyond the waypoint on the leg's line, by the distance by
which a vehicle that turned there at the last moment may overshoot the next leg. The reference can always stop
at its target, so after the turn its distance from the next leg is at most that. Half of the acceptance is
used for this; the other half is left for the vehicle's tracking error.
"""

import math
from enum import Enum

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.mode_table import FLIES_TO_A_PLACE, ModeTraits
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import IDLE, ModeContext, ModeEntry, Moment, StopMode
from autopilot.navigation.landing import LandMode, TakeOffMode
from autopilot.navigation.mission import HeightFrame, Mission, MissionCommand, MissionItem
from autopilot.navigation.mission_runner import MissionRunner
from autopilot.navigation.site_frame import horizontal_ned_m
from foundation.geometry.rotations import quat_to_euler
from foundation.types import Array, Course, EstimatorState, TrajectorySetpoint

_STAYS = {
    MissionCommand.LOITER_UNLIMITED,
    MissionCommand.LOITER_TIME,
    MissionCommand.LOITER_TO_ALT,
    MissionCommand.DELAY,
    MissionCommand.TURN,
}
_IN_PLACE = {MissionCommand.DELAY, MissionCommand.TURN, MissionCommand.RETURN}
_CORNER_SHARE = 0.5
"""Fraction of the acceptance by which the reference may overshoot the next leg"""
_SAME_PLACE_M = 0.01
_ABEAM_M = 1e-6


class MissionStage(Enum):
    """What is done for the present item."""

    NONE = "none"
    """No item: hold, or stay on the ground."""
    TAKE_OFF = "take off"
    FLY = "fly"
    STAY = "stay"
    LAND = "land"


_COURSE_OF_STAGE = {MissionStage.TAKE_OFF: Course.TAKE_OFF, MissionStage.LAND: Course.LANDING}


class MissionMode(StopMode):
    """Flies the runner's items, then changes to hold, or to return by an item."""

    traits = ModeTraits(
        needs=FLIES_TO_A_PLACE | Condition.HOME | Condition.MISSION, arms=True, of_one_flight=True,
        standard=common.MAV_STANDARD_MODE_MISSION,
    )  # fmt: skip

    def __init__(self, context: ModeContext, take_off: TakeOffMode, landing: LandMode) -> None:
        super().__init__(context)
        self.runner = MissionRunner()
        self.stage = MissionStage.NONE
        self.return_requested = False
        """The mission requests Return mode, and holds until the mode changes."""
        self.place_ned_m: Array = np.zeros(3)
        """Position (3,) of the present item."""
        self._take_off = take_off
        self._landing = landing
        self._version: int | None = None
        """Version of the runner when the present item was started."""
        self._stayed_s = 0.0
        self._passes = False
        """The guide's target is beyond the present position."""
        self._level = False
        """The vehicle flies level to the position at which LOITER_TO_ALT changes its height."""
        self._heading_rad = 0.0
        """Final heading of a TURN."""
        self._was_landed = False
        """Whether it was on the ground at the last step."""

    @property
    def done(self) -> bool:
        """Whether all items are flown or there is no mission; it then holds the last position."""
        return (self.runner.finished or self.runner.mission is None) and not self.return_requested

    def next_mode(self, _state: EstimatorState, /) -> FlightMode | None:
        """Return hold at the end, return if an item requests it."""
        if self.done:
            return FlightMode.HOLD
        return FlightMode.RETURN if self.return_requested else None

    @property
    def course(self) -> Course:
        """As by the present item."""
        return _COURSE_OF_STAGE.get(self.stage, Course.OTHER)

    def load(self, mission: Mission | None, *, start: int = 0) -> None:
        """Replace or remove the mission; in Mission mode it starts with item ``start`` at the next step."""
        self.return_requested = False
        self.runner.load(mission, start=start)

    def apply_limits(self) -> None:
        """Continue the present leg, or take-off, with the present limits."""
        if self.stage is MissionStage.TAKE_OFF:
            self._take_off.apply_limits()
        else:
            self._apply_leg_limits()

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Change the ground speed until an item changes it."""
        self.runner.speed_m_s = speed_m_s
        self.apply_limits()

    def enter(self, entry: ModeEntry) -> None:
        """Continue the mission; a finished one starts with its first item."""
        if self.runner.finished and not entry.again:
            self.runner.restart()
        self._resume(entry)

    def _resume(self, moment: Moment) -> None:
        """Continue the present item from the present motion; a finished mission holds where it stops."""
        self.return_requested = False
        self.runner.settle()
        self._apply_leg_limits()
        self._guide.restart(moment.state)
        self._begin(moment)

    def update(self, moment: Moment) -> TrajectorySetpoint:
        """Return the setpoint of the present item."""
        if self.runner.version != self._version:
            self._begin(moment)
        if self._is_done(moment):
            self._advance(moment)
        if self.stage is MissionStage.TAKE_OFF:
            return self._take_off.update(moment)
        if moment.landed:
            self._was_landed = True
            return IDLE
        if self._was_landed:
            self._lift_off(moment)
        if self.stage is MissionStage.LAND:
            return self._landing.update(moment)
        guide = self._guide
        if not guide.resting:
            self._turn(moment)
        elif self._passes:
            self._passes = False
            guide.go_to(self.place_ned_m)  # at rest beyond a position that the vehicle has not reached
        return guide.update(moment.dt_s, vehicle_pos_ned_m=moment.state.pos_ned_m)

    def _lift_off(self, moment: Moment) -> None:
        """Handle an unexpected lift-off: continue a leg, otherwise stay here instead of climbing back."""
        self._was_landed = False
        if self.stage is MissionStage.FLY:
            self._resume(moment)
        elif self.stage is not MissionStage.LAND:
            self._guide.restart(moment.state)

    def _advance(self, moment: Moment) -> None:
        item = self.runner.item
        if item is not None and item.command is MissionCommand.RETURN:
            self.return_requested = True
        self.runner.advance()
        self._begin(moment, from_place=True)

    def _is_done(self, moment: Moment) -> bool:
        """Return whether the present item is complete; a take-off or leg to a landing changes its stage."""
        item = self.runner.item
        if item is None:
            return False
        if self.stage is MissionStage.TAKE_OFF:
            if self._take_off.airborne and self._is_high_enough(moment.state):
                self._fly(item, moment)
            return False
        if item.command is MissionCommand.LAND and moment.landed:
            return True
        if item.command is MissionCommand.RETURN:
            return True
        if self.stage is MissionStage.FLY and self._is_there(item, moment.state):
            if item.command is MissionCommand.LAND:
                self._land(moment.state)
                return False
            if self._level:
                self._level = False
                self._fly(item, moment)
                return False
            self.stage = MissionStage.STAY
            self._stayed_s = 0.0
        elif self.stage is MissionStage.STAY:
            self._stayed_s += moment.dt_s
        if item.command is MissionCommand.TURN:
            error_rad = _heading_error_rad(moment.state, self._heading_rad)
            is_turned = error_rad <= self._context.params.yaw_acceptance_rad
            return moment.landed or (self._guide.resting and is_turned)
        return (
            self.stage is MissionStage.STAY
            and item.command is not MissionCommand.LOITER_UNLIMITED
            and self._stayed_s >= item.hold_s
        )

    # ---- stages

    def _begin(self, moment: Moment, *, from_place: bool = False) -> None:
        """Start the runner's item; ``from_place``: the leg begins at the last item's position."""
        again = self._version == self.runner.version
        self.runner.settle()
        self._version = self.runner.version
        self._passes = self._was_landed = False
        item, guide = self.runner.item, self._guide
        if item is None:
            self.stage = MissionStage.NONE
            if self.runner.mission is None:
                guide.restart(moment.state)  # the mission was removed in flight
            return
        self._apply_leg_limits()
        self._level = item.command is MissionCommand.LOITER_TO_ALT
        if item.command in _IN_PLACE:
            self.place_ned_m = guide.target_ned_m
            self.stage = MissionStage.STAY
            self._stayed_s = 0.0
            if item.command is MissionCommand.TURN:
                if not again:
                    self._heading_rad = _heading_to_turn_to_rad(item, moment.state)
                guide.turn_to(self._heading_rad)
        elif moment.landed:
            self._leave_ground(item, moment)
        else:
            self._fly(item, moment, from_place=from_place)

    def _leave_ground(self, item: MissionItem, moment: Moment) -> None:
        """Climb to the item's height, as PX4 does for any first position; a landing needs no climb."""
        if item.command is MissionCommand.LAND:
            self.stage = MissionStage.LAND
            return
        down_m = _down_m(item, moment)
        if item.command is not MissionCommand.TAKEOFF:
            down_m = min(down_m, moment.home_down_m - self._context.params.takeoff_height_m)
        self._take_off.start(moment, down_m=down_m)
        self.place_ned_m = self._guide.target_ned_m
        self.stage = MissionStage.TAKE_OFF

    def _fly(self, item: MissionItem, moment: Moment, *, from_place: bool = False) -> None:
        """Fly to the item's position, with a target beyond it if the vehicle need not stop there."""
        guide = self._guide
        self._apply_leg_limits()
        self.stage = MissionStage.FLY
        start_ned_m = self.place_ned_m if from_place else guide.pos_ned_m
        here_ned_m = self.place_ned_m if from_place else guide.target_ned_m
        self.place_ned_m = _item_place_ned_m(item, moment, here_ned_m)
        if self._level:
            self.place_ned_m[2] = here_ned_m[2]
        target_ned_m = self.place_ned_m
        upcoming = self.runner.next_item()
        if self._is_passed(item) and upcoming is not None and upcoming.has_place:
            target_ned_m = self.place_ned_m + overshoot_ned_m(
                start_ned_m, self.place_ned_m, _item_place_ned_m(upcoming, moment, self.place_ned_m),
                radius_m=self._acceptance_m(item),
                height_m=self._context.params.altitude_acceptance_m,
                enough_m=guide.stopping_distance_m(),
            )  # fmt: skip
        self._passes = target_ned_m is not self.place_ned_m
        yaw_rad = math.radians(item.yaw_deg) if item.yaw_deg is not None else None
        guide.go_to(target_ned_m, yaw_rad=yaw_rad, along_ned=target_ned_m - start_ned_m)

    def _land(self, state: EstimatorState) -> None:
        self.stage = MissionStage.LAND
        self._landing.start(state)

    # ---- parts

    def _is_passed(self, item: MissionItem) -> bool:
        return item.command not in _STAYS and item.hold_s == 0.0 and item.command is not MissionCommand.LAND

    def _is_high_enough(self, state: EstimatorState) -> bool:
        missing_m = float(state.pos_ned_m[2] - self._guide.target_ned_m[2])
        return missing_m < self._context.params.altitude_acceptance_m

    def _is_there(self, item: MissionItem, state: EstimatorState) -> bool:
        if item.command is MissionCommand.LAND and not self._guide.resting:
            return False  # a landing descends vertically at the position itself
        if item.yaw_deg is not None:
            error_rad = _heading_error_rad(state, math.radians(item.yaw_deg))
            if error_rad > self._context.params.yaw_acceptance_rad:
                return False
        return self._context.is_near(state, self.place_ned_m, radius_m=self._acceptance_m(item))

    def _acceptance_m(self, item: MissionItem) -> float:
        return item.acceptance_m or self._context.params.acceptance_m

    def _turn(self, moment: Moment) -> None:
        """Set the heading: that of the item, else towards the region of interest, else by MPC_YAW_MODE."""
        item, look_at, guide = self.runner.item, self.runner.look_at, self._guide
        if self.stage is not MissionStage.FLY or item is None or item.yaw_deg is not None:
            return
        near_m = self._context.params.acceptance_m
        if look_at is not None:
            north_m, east_m, _ = _item_place_ned_m(look_at, moment, guide.pos_ned_m) - guide.pos_ned_m
            if math.hypot(north_m, east_m) >= near_m:
                guide.turn_to(math.atan2(east_m, north_m))
        else:
            self._context.turn_by_yaw_mode(self.place_ned_m, moment.home_ned_m, near_m=near_m)

    def _apply_leg_limits(self) -> None:
        """Set the guide's limits for a leg at the mission's speed."""
        self._guide.set_limits(self._context.leg_limits(self.runner.speed_m_s))


def _item_place_ned_m(item: MissionItem, moment: Moment, here_ned_m: Array) -> Array:
    """Return the position (3,) of an item; ``here_ned_m`` replaces components that it does not have."""
    place_ned_m = here_ned_m.copy()
    if item.lat_deg is not None and item.lon_deg is not None:
        place_ned_m[:2] = horizontal_ned_m(item.lat_deg, item.lon_deg, moment.state)
    if item.command is not MissionCommand.LAND:
        place_ned_m[2] = _down_m(item, moment)
        if item.command is MissionCommand.TAKEOFF and not item.has_place:
            place_ned_m[2] = min(place_ned_m[2], here_ned_m[2])  # in the air it never descends
    return place_ned_m


def _down_m(item: MissionItem, moment: Moment) -> float:
    above = item.frame is HeightFrame.ABOVE_HOME
    return (moment.home_down_m if above else moment.state.origin_alt_m) - item.height_m


def _yaw_rad(state: EstimatorState) -> float:
    return float(quat_to_euler(state.q_ned_frd)[2])


def _heading_error_rad(state: EstimatorState, heading_rad: float) -> float:
    return abs(math.remainder(_yaw_rad(state) - heading_rad, math.tau))


def _heading_to_turn_to_rad(item: MissionItem, state: EstimatorState) -> float:
    turn_rad = math.radians(item.yaw_deg or 0.0)
    return math.remainder(_yaw_rad(state) + turn_rad if item.yaw_relative else turn_rad, math.tau)


def overshoot_ned_m(
    start_ned_m: Array, place_ned_m: Array, next_ned_m: Array, *, radius_m: float, height_m: float,
    enough_m: float,
) -> Array:  # fmt: skip
    """Return how far beyond a position, (3,), the reference may aim on a leg from ``start`` before ``next``.

    The target is within half of the acceptance (``radius_m`` horizontally, ``height_m`` vertically) of the
    next leg, measured across it, or of the position itself if the path turns back; and the component of the
    motion along the next leg can stop before that leg's end. At most ``enough_m``.
    """
    way, onward = place_ned_m - start_ned_m, next_ned_m - place_ned_m
    way_m, onward_m = float(np.linalg.norm(way)), float(np.linalg.norm(onward))
    if way_m < _SAME_PLACE_M or onward_m < _SAME_PLACE_M:
        return np.zeros(3)
    way, onward = way / way_m, onward / onward_m
    cosine = float(way @ onward)
    beyond_m = enough_m
    if cosine > 0.0:
        beyond_m = min(beyond_m, onward_m / cosine)
    off = way - max(cosine, 0.0) * onward
    # fraction of the acceptance per metre of overshoot
    used_1_m = math.hypot(off[0] / radius_m, off[1] / radius_m, off[2] / height_m)
    if used_1_m > _ABEAM_M:
        beyond_m = min(beyond_m, _CORNER_SHARE / used_1_m)
    past: Array = beyond_m * way
    return past
