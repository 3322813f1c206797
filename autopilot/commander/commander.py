"""Arming, modes and failsafes of one vehicle: requests and conditions over the tables in `conditions`.

It decides and says why; it moves nothing. `navigation` turns the mode into setpoints, `protocol` carries
requests and answers. A request returns None when it was granted, else the reason.
"""

from typing import Annotated, NamedTuple

from msgspec import Meta, Struct
from pymavlink.dialects.v20 import common

from autopilot.commander.conditions import (
    AFTER_DISARMING,
    ARMING_NEEDS,
    FALLBACKS,
    MODE_NEEDS,
    MODES_TO_ARM_IN,
    Condition,
    Reason,
    first_missing,
)
from autopilot.mavlink.modes import FlightMode

US_PER_S = 1_000_000


class CommanderParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Time limits; the parameter table states them by PX4's names."""

    offboard_loss_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 1.0
    """COM_OF_LOSS_T: age of the last offboard setpoint from which the stream counts as lost"""
    disarm_landed_s: Annotated[float, Meta(ge=-1.0, le=60.0)] = 2.0
    """COM_DISARM_LAND: from landing to disarming; negative never"""
    disarm_preflight_s: Annotated[float, Meta(ge=-1.0, le=60.0)] = 10.0
    """COM_DISARM_PRFLT: from arming to disarming without take-off; negative never"""
    spool_up_s: Annotated[float, Meta(ge=0.0, le=30.0)] = 1.0
    """COM_SPOOLUP_TIME: from arming until thrust may rise"""


class Notice(NamedTuple):
    """Something to tell people, as STATUSTEXT does."""

    severity: int
    """MAV_SEVERITY"""
    text: str


class Commander:
    """Holds mode and arming; ask with `arm`, `disarm`, `set_mode`, and call `update` at every step."""

    def __init__(self, params: CommanderParams) -> None:
        self.params = params
        self.mode = FlightMode.HOLD
        self.armed = False
        self.failsafe = False
        """The present mode was forced by a failsafe."""
        self.landed = True
        self._conditions = 0
        self._armed_us = 0
        self._landed_us = 0
        self._has_flown = False
        """Since arming."""

    def arm(self, now_us: int, *, forced: bool = False) -> Reason | None:
        """Arm; ``forced`` skips the checks, as MAV_CMD_COMPONENT_ARM_DISARM's 21196 does."""
        if self.armed:
            return None
        if not forced:
            if self.mode not in MODES_TO_ARM_IN:
                return Reason.MODE_CANNOT_ARM
            missing = first_missing(ARMING_NEEDS | MODE_NEEDS[self.mode], self._conditions)
            if missing is not None:
                return missing
        self.armed = True
        self.failsafe = False
        self._armed_us = now_us
        self._has_flown = False
        return None

    def disarm(self, *, forced: bool = False) -> Reason | None:
        """Disarm; only ``forced`` does so in the air."""
        if self.armed and not self.landed and not forced:
            return Reason.IN_AIR
        self.armed = False
        self.failsafe = False
        self.mode = AFTER_DISARMING.get(self.mode, self.mode)
        return None

    def set_mode(self, mode: FlightMode | None) -> Reason | None:
        """Enter a mode if what it needs is there.

        Disarmed, as in PX4, any mode may be chosen and arming is what is refused; but offboard always needs
        its setpoints.
        """
        if mode not in MODE_NEEDS or mode is FlightMode.DESCEND:
            return Reason.MODE_UNAVAILABLE
        needs = MODE_NEEDS[mode] if self.armed else MODE_NEEDS[mode] & Condition.SETPOINTS
        missing = first_missing(needs, self._conditions)
        if missing is None:
            self.mode = mode
            self.failsafe = False
        return missing

    def spooled_up(self, now_us: int) -> bool:
        """Whether the rotors have had the time to reach idle speed, so that thrust may rise."""
        return self.armed and now_us - self._armed_us >= self.params.spool_up_s * US_PER_S

    def update(
        self, now_us: int, *, conditions: int, landed: bool, mode_completed: bool
    ) -> tuple[Notice, ...]:
        """Take what holds now (`Condition` bits) and whether the mode is done; returns what happened.

        In most steps nothing does.
        """
        self._conditions = conditions
        notices: tuple[Notice, ...] = ()
        if landed is not self.landed:
            self.landed = landed
            self._landed_us = now_us
            if self.armed:
                self._has_flown = True
                notices += (_info("Landing detected" if landed else "Takeoff detected"),)
        if self.armed:
            if mode_completed and self.mode is FlightMode.TAKEOFF:
                self.mode = FlightMode.HOLD
            if _MODE_NEED_BITS[self.mode] & ~conditions:
                notices += self._fall_back(conditions)
            if landed:
                notices += self._disarm_when_idle(now_us)
        return notices

    def _fall_back(self, conditions: int) -> tuple[Notice, ...]:
        reason = first_missing(_MODE_NEED_BITS[self.mode], conditions)
        options = FALLBACKS[self.mode]
        if reason is None or not options:
            return ()
        self.mode = next((mode for mode in options if not _MODE_NEED_BITS[mode] & ~conditions), options[-1])
        self.failsafe = True
        return (Notice(common.MAV_SEVERITY_CRITICAL, f"Failsafe: {reason.text}, {self.mode.label}"),)

    def _disarm_when_idle(self, now_us: int) -> tuple[Notice, ...]:
        if self._has_flown:
            since_us, limit_s, text = self._landed_us, self.params.disarm_landed_s, "Disarmed by landing"
        else:
            since_us, limit_s, text = self._armed_us, self.params.disarm_preflight_s, "Disarmed: no takeoff"
        if limit_s < 0.0 or now_us - since_us < limit_s * US_PER_S:
            return ()
        self.disarm()
        return (_info(text),)


_MODE_NEED_BITS = {mode: int(needs) for mode, needs in MODE_NEEDS.items()}
"""Plain integers: the test at every step costs a tenth of the flag type's."""


def _info(text: str) -> Notice:
    return Notice(common.MAV_SEVERITY_INFO, text)
