"""Flight of mission items: straight legs, corners flown without a stop, stays, take-off and landing.

At a waypoint without a stop the guide's target is beyond the waypoint on the leg's line, by the distance by
which a vehicle that turned there at the last moment may overshoot the next leg. The reference can always stop
at its target, so after the turn its distance from the next leg is at most that. Half of the acceptance is
used for this; the other half is left for the vehicle's tracking error.
"""

import math
from enum import Enum

import numpy as np
from msgspec.structs import replace

from autopilot.control.params import PositionParams, TrajectoryParams
from autopilot.navigation.guide import Guide, Moment, heading_rad, is_near
from autopilot.navigation.landing import IDLE, Landing, TakeOff
from autopilot.navigation.mission import HeightFrame, Mission, MissionCommand, MissionItem
from autopilot.navigation.mission_runner import MissionRunner
from autopilot.navigation.params import NavigationParams
from foundation.geometry.geodesy import geodetic_to_ned
from foundation.types import Array, EstimatorState, TrajectorySetpoint

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


class MissionFlight:
    """Flies the runner's items; call `resume` when the mode is entered, then `update` at every step."""

    def __init__(
        self, guide: Guide, take_off: TakeOff, landing: Landing, *, limits: TrajectoryParams,
        position: PositionParams,
    ) -> None:  # fmt: skip
        self.runner = MissionRunner()
        self.stage = MissionStage.NONE
        self.return_requested = False
        """The mission requests Return mode, and holds until the mode changes."""
        self.place_ned_m: Array = np.zeros(3)
        """Position (3,) of the present item."""
        self._guide = guide
        self._take_off = take_off
        self._landing = landing
        self._limits = limits
        self._position = position
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

    def load(self, mission: Mission | None, *, start: int = 0) -> None:
        """Replace or remove the mission; in Mission mode it starts with item ``start`` at the next step."""
        self.return_requested = False
        self.runner.load(mission, start=start)

    def set_limits(self, limits: TrajectoryParams, position: PositionParams) -> None:
        """Change the limits of later legs; `apply_limits` applies them to the present one."""
        self._limits, self._position = limits, position

    def apply_limits(self) -> None:
        """Continue the present leg, or take-off, with the present limits."""
        if self.stage is MissionStage.TAKE_OFF:
            self._take_off.set_limits(self._limits, speed_m_s=self._position.tko_speed_m_s)
        else:
            self._guide.set_limits(self._leg_limits())

    def resume(self, moment: Moment, params: NavigationParams) -> None:
        """Continue the present item from the present motion; a finished mission holds where it stops."""
        self.return_requested = False
        self.runner.settle()
        self._guide.set_limits(self._leg_limits())
        self._guide.restart(moment.state)
        self._begin(moment, params)

    def restart(self) -> None:
        """Reset the progress: the next `resume` starts with the first item."""
        self.runner.restart()

    def update(self, moment: Moment, params: NavigationParams) -> TrajectorySetpoint:
        """Return the next setpoint."""
        if self.runner.version != self._version:
            self._begin(moment, params)
        if self._is_done(moment, params):
            self._advance(moment, params)
        if self.stage is MissionStage.TAKE_OFF:
            return self._take_off.update(moment)
        if moment.landed:
            self._was_landed = True
            return IDLE
        if self._was_landed:
            self._lift_off(moment, params)
        if self.stage is MissionStage.LAND:
            return self._landing.update(moment, params)
        guide = self._guide
        if not guide.resting:
            self._turn(moment, params)
        elif self._passes:
            self._passes = False
            guide.go_to(self.place_ned_m)  # at rest beyond a position that the vehicle has not reached
        return guide.follow(moment.dt_s, vehicle_pos_ned_m=moment.state.pos_ned_m)

    def _lift_off(self, moment: Moment, params: NavigationParams) -> None:
        """Handle an unexpected lift-off: continue a leg, otherwise stay here instead of climbing back."""
        self._was_landed = False
        if self.stage is MissionStage.FLY:
            self.resume(moment, params)
        elif self.stage is not MissionStage.LAND:
            self._guide.restart(moment.state)

    def _advance(self, moment: Moment, params: NavigationParams) -> None:
        item = self.runner.item
        if item is not None and item.command is MissionCommand.RETURN:
            self.return_requested = True
        self.runner.advance()
        self._begin(moment, params, from_place=True)

    def _is_done(self, moment: Moment, params: NavigationParams) -> bool:
        """Return whether the present item is complete; a take-off or leg to a landing changes its stage."""
        item = self.runner.item
        if item is None:
            return False
        if self.stage is MissionStage.TAKE_OFF:
            if self._take_off.airborne and self._is_high_enough(moment.state, params):
                self._fly(item, moment, params)
            return False
        if item.command is MissionCommand.LAND and moment.landed:
            return True
        if item.command is MissionCommand.RETURN:
            return True
        if self.stage is MissionStage.FLY and self._is_there(item, moment.state, params):
            if item.command is MissionCommand.LAND:
                self._land(moment.state)
                return False
            if self._level:
                self._level = False
                self._fly(item, moment, params)
                return False
            self.stage = MissionStage.STAY
            self._stayed_s = 0.0
        elif self.stage is MissionStage.STAY:
            self._stayed_s += moment.dt_s
        if item.command is MissionCommand.TURN:
            error_rad = _heading_error_rad(moment.state, self._heading_rad)
            return moment.landed or (self._guide.resting and error_rad <= params.yaw_acceptance_rad)
        return (
            self.stage is MissionStage.STAY
            and item.command is not MissionCommand.LOITER_UNLIMITED
            and self._stayed_s >= item.hold_s
        )

    # ---- stages

    def _begin(self, moment: Moment, params: NavigationParams, *, from_place: bool = False) -> None:
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
        guide.set_limits(self._leg_limits())
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
            self._leave_ground(item, moment, params)
        else:
            self._fly(item, moment, params, from_place=from_place)

    def _leave_ground(self, item: MissionItem, moment: Moment, params: NavigationParams) -> None:
        """Climb to the item's height, as PX4 does for any first position; a landing needs no climb."""
        if item.command is MissionCommand.LAND:
            self.stage = MissionStage.LAND
            return
        home_down_m = moment.home_ned_m[2] if moment.home_ned_m is not None else 0.0
        down_m = self._down_m(item, moment.state, home_down_m)
        if item.command is not MissionCommand.TAKEOFF:
            down_m = min(down_m, home_down_m - params.takeoff_height_m)
        self._take_off.start(moment, down_m=down_m, speed_m_s=self._position.tko_speed_m_s)
        self.place_ned_m = self._guide.target_ned_m
        self.stage = MissionStage.TAKE_OFF

    def _fly(
        self, item: MissionItem, moment: Moment, params: NavigationParams, *, from_place: bool = False
    ) -> None:
        """Fly to the item's position, with a target beyond it if the vehicle need not stop there."""
        guide = self._guide
        guide.set_limits(self._leg_limits())
        self.stage = MissionStage.FLY
        start_ned_m = self.place_ned_m if from_place else guide.pos_ned_m
        here_ned_m = self.place_ned_m if from_place else guide.target_ned_m
        self.place_ned_m = self._item_place_ned_m(item, moment, here_ned_m)
        if self._level:
            self.place_ned_m[2] = here_ned_m[2]
        target_ned_m = self.place_ned_m
        upcoming = self.runner.next_item()
        if self._is_passed(item) and upcoming is not None and upcoming.has_place:
            target_ned_m = self.place_ned_m + overshoot_ned_m(
                start_ned_m, self.place_ned_m, self._item_place_ned_m(upcoming, moment, self.place_ned_m),
                radius_m=item.acceptance_m or params.acceptance_m, height_m=params.altitude_acceptance_m,
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
        """Return whether the vehicle need not stop at the item's position."""
        return item.command not in _STAYS and item.hold_s == 0.0 and item.command is not MissionCommand.LAND

    def _is_high_enough(self, state: EstimatorState, params: NavigationParams) -> bool:
        missing_m = float(state.pos_ned_m[2] - self._guide.target_ned_m[2])
        return missing_m < params.altitude_acceptance_m

    def _is_there(self, item: MissionItem, state: EstimatorState, params: NavigationParams) -> bool:
        if item.command is MissionCommand.LAND and not self._guide.resting:
            return False  # a landing descends vertically at the position itself
        heading_rad = math.radians(item.yaw_deg) if item.yaw_deg is not None else None
        if heading_rad is not None and _heading_error_rad(state, heading_rad) > params.yaw_acceptance_rad:
            return False
        return is_near(
            state.pos_ned_m,
            self.place_ned_m,
            radius_m=item.acceptance_m or params.acceptance_m,
            height_m=params.altitude_acceptance_m,
        )

    def _turn(self, moment: Moment, params: NavigationParams) -> None:
        """Set the heading: that of the item, else towards the region of interest, else by MPC_YAW_MODE."""
        item, look_at, guide = self.runner.item, self.runner.look_at, self._guide
        if self.stage is not MissionStage.FLY or item is None or item.yaw_deg is not None:
            return
        if look_at is not None:
            north_m, east_m, _ = self._item_place_ned_m(look_at, moment, guide.pos_ned_m) - guide.pos_ned_m
            if math.hypot(north_m, east_m) >= params.acceptance_m:
                guide.turn_to(math.atan2(east_m, north_m))
            return
        yaw_rad = heading_rad(
            params.yaw_mode, self._guide, self.place_ned_m, moment.home_ned_m, near_m=params.acceptance_m
        )
        if yaw_rad is not None:
            self._guide.turn_to(yaw_rad)

    def _leg_limits(self) -> TrajectoryParams:
        speed_m_s = self.runner.speed_m_s
        if speed_m_s is None:
            return self._limits
        return replace(self._limits, xy_cruise_m_s=min(speed_m_s, self._position.xy_vel_max_m_s))

    def _item_place_ned_m(self, item: MissionItem, moment: Moment, here_ned_m: Array) -> Array:
        """Return the position (3,) of an item; ``here_ned_m`` replaces components that it does not have."""
        state, home_ned_m = moment.state, moment.home_ned_m
        place_ned_m = here_ned_m.copy()
        if item.lat_deg is not None and item.lon_deg is not None:
            place_ned_m[:2] = geodetic_to_ned(
                item.lat_deg,
                item.lon_deg,
                state.origin_alt_m,
                origin_lat_deg=state.origin_lat_deg,
                origin_lon_deg=state.origin_lon_deg,
                origin_alt_m=state.origin_alt_m,
            )[:2]
        if item.command is not MissionCommand.LAND:
            place_ned_m[2] = self._down_m(item, state, home_ned_m[2] if home_ned_m is not None else 0.0)
            if item.command is MissionCommand.TAKEOFF and not item.has_place:
                place_ned_m[2] = min(place_ned_m[2], here_ned_m[2])  # in the air it never descends
        return place_ned_m

    def _down_m(self, item: MissionItem, state: EstimatorState, home_down_m: float) -> float:
        above = home_down_m if item.frame is HeightFrame.ABOVE_HOME else state.origin_alt_m
        return above - item.height_m


def _yaw_rad(state: EstimatorState) -> float:
    w, x, y, z = state.q_ned_frd.tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _heading_error_rad(state: EstimatorState, heading_rad: float) -> float:
    return abs(math.remainder(_yaw_rad(state) - heading_rad, math.tau))


def _heading_to_turn_to_rad(item: MissionItem, state: EstimatorState) -> float:
    """Return the final heading of a TURN."""
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
