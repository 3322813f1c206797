"""Arming, modes and failsafes of one vehicle, from the tables in `mode_table` and `failsafe`.

The commander decides and reports reasons; it does not control. `autopilot.navigation` turns the mode into
setpoints, `autopilot.services` carries requests and replies. A request returns None if it is granted, else
the reason.
"""

from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition, Reason, first_missing
from autopilot.commander.failsafe import (
    ARMING_CAUSES,
    MODE_OF,
    NOTHING,
    US_PER_S,
    Action,
    Cause,
    Decision,
    Failsafe,
)
from autopilot.commander.mode_table import ModeTable
from autopilot.commander.params import CommanderParams
from autopilot.mavlink.modes import FlightMode


class Notice(NamedTuple):
    """Message to the user, sent as STATUSTEXT."""

    severity: int
    """MAV_SEVERITY"""
    text: str


class Commander:
    """Mode and arming; requests are `arm`, `disarm`, `set_mode`. Call `update` several times a second."""

    def __init__(self, params: CommanderParams, modes: ModeTable) -> None:
        self.params = params
        self.modes = modes
        self.mode = FlightMode.HOLD
        """Mode in flight: the requested mode or that of the failsafe."""
        self.armed = False
        self.terminated = False
        """The flight was terminated: the motors stay off."""
        self.landed = True
        self.failsafe = False
        """The present mode was forced by a failsafe."""
        self._requested = FlightMode.HOLD
        """Requested mode; restored after a failsafe that ends with its cause."""
        self._mode_chosen = False
        self._failsafe = Failsafe(modes)
        self._decision = NOTHING
        self._conditions = 0
        self._causes = 0
        self._armed_us = 0
        self._landed_us = 0
        self._has_flown = False
        """Whether the vehicle has flown since arming."""

    def set_params(self, params: CommanderParams) -> None:
        """Change the settings, in effect from the next update."""
        self.params = params

    # ---- requests

    def arm(self, now_us: int, *, forced: bool = False) -> Reason | None:
        """Arm; ``forced`` skips the checks, like the value 21196 of MAV_CMD_COMPONENT_ARM_DISARM."""
        if self.armed:
            return None
        if self.terminated:
            return Reason.TERMINATED
        if not forced:
            reason = next(iter(self.arming_refusals()), None)
            if reason is not None:
                return reason
        self.armed = True
        self._armed_us = now_us
        self._has_flown = False
        return None

    def arming_refusals(self) -> list[Reason]:
        """Return all reasons for which arming in the present mode would be refused, the most basic first."""
        reasons = self.modes.arming_refusals(self.mode, self._conditions, armable=self.params.armable != 0)
        for cause, reason in ARMING_CAUSES:
            if self._causes & cause and reason not in reasons and self._prevents_arming(cause):
                reasons.append(reason)
        return reasons

    def disarm(self, *, forced: bool = False) -> Reason | None:
        """Disarm; in the air only if ``forced``."""
        if self.armed and not self.landed and not forced:
            return Reason.IN_AIR
        if self.armed:
            self.armed = False
            if self.failsafe or self._requested in self.modes.of_one_flight:
                self._requested = FlightMode.HOLD
            self.mode = self._requested
            self.failsafe = False
        return None

    def set_mode(self, mode: FlightMode | None) -> Reason | None:
        """Enter a mode if its needs are met; during a failsafe this is a takeover by the pilot.

        While disarmed, as in PX4, any mode may be selected, and arming is refused instead; offboard always
        needs its setpoints.
        """
        if mode is None or mode not in self.modes.offered:
            return Reason.MODE_UNAVAILABLE
        if self.terminated:
            return Reason.TERMINATED
        needs = self.modes.needs[mode]
        if not self.armed:
            needs &= int(Condition.SETPOINTS)
        missing = first_missing(needs, self._conditions)
        if missing is None:
            self.mode = self._requested = mode
            self._mode_chosen = True
            self.failsafe = False
        return missing

    def terminate(self) -> None:
        """Stop the motors permanently (MAV_CMD_DO_FLIGHTTERMINATION)."""
        self.terminated = True
        self.disarm(forced=True)

    def spooled_up(self, now_us: int) -> bool:
        """Return whether the rotors have had time to reach idle speed, so that thrust may rise."""
        return self.armed and now_us - self._armed_us >= self.params.spool_up_s * US_PER_S

    # ---- periodic update

    def update(
        self,
        now_us: int,
        *,
        conditions: int,
        landed: bool,
        causes: int = 0,
        next_mode: FlightMode | None = None,
    ) -> tuple[Notice, ...]:
        """Update arming and mode from the present `Condition` and `Cause` bits, and return the notices.

        ``next_mode`` is the mode that follows a mode that is complete. In most steps there are no notices.
        """
        self._conditions, self._causes = conditions, causes
        notices: tuple[Notice, ...] = ()
        if landed is not self.landed:
            self.landed = landed
            self._landed_us = now_us
            if self.armed:
                self._has_flown = True
                notices += (_info("Landing detected" if landed else "Takeoff detected"),)
        if next_mode is not None and self.armed and self.mode is self._requested:
            self.mode = self._requested = next_mode
        decision = self._failsafe.update(
            now_us, params=self.params, causes=causes, conditions=conditions,
            mode=self._requested, armed=self.armed, landed=landed, mode_chosen=self._mode_chosen,
        )  # fmt: skip
        self._mode_chosen = False
        if self._failsafe.warnings:
            notices += tuple(
                Notice(common.MAV_SEVERITY_WARNING, f"Warning: {text}") for text in self._failsafe.warnings
            )
        if decision is not self._decision:
            notices += self._apply(decision)
        if self.armed and landed:
            notices += self._disarm_when_idle(now_us)
        return notices

    def _apply(self, decision: Decision) -> tuple[Notice, ...]:
        before, self._decision = self._decision, decision
        if not self.armed:
            return ()
        action = decision.action
        notices: tuple[Notice, ...] = ()
        if action is Action.TERMINATE:
            self.terminate()
        elif action is Action.DISARM:
            self.disarm(forced=True)
        else:
            if self.landed and before.action in MODE_OF and action not in MODE_OF:
                # landed by the failsafe: the earlier mode must not take off again
                self._requested = FlightMode.HOLD
            self.mode = MODE_OF.get(action, self._requested)
            self.failsafe = action in MODE_OF
        if decision._replace(delay_s=0.0) != before._replace(delay_s=0.0):
            notices = self._notices(before, decision)
        return notices

    def _prevents_arming(self, cause: Cause) -> bool:
        """Return whether a cause prevents arming: some do only if a parameter assigns an action to them."""
        if cause is Cause.GCS_LOST:
            return self.params.gcs_loss_action > 0
        if cause is Cause.GEOFENCE:
            return self.params.geofence_action > 1
        return True

    def _notices(self, before: Decision, now: Decision) -> tuple[Notice, ...]:
        """Return the notices of a failsafe that begins, gets worse, is taken over or ends."""
        action, name = now.action, self.modes.name(self.mode)
        if action <= Action.WARN:  # each warning has its own notice
            if now.taken_over and not before.taken_over:
                return (_info(f"Pilot took over, {name}"),)
            return (_info(f"Failsafe over, {name}"),) if before.action > Action.WARN else ()
        what = _DONE.get(action, name)
        if now.then is not None:
            what += f", {self.modes.name(MODE_OF[now.then])} in {now.delay_s:.0f} s"
        return (Notice(common.MAV_SEVERITY_CRITICAL, f"Failsafe: {now.text}, {what}"),)

    def _disarm_when_idle(self, now_us: int) -> tuple[Notice, ...]:
        if self._has_flown:
            since_us, limit_s, text = self._landed_us, self.params.disarm_landed_s, "Disarmed by landing"
        else:
            since_us, limit_s, text = self._armed_us, self.params.disarm_preflight_s, "Disarmed: no takeoff"
        if limit_s < 0.0 or now_us - since_us < limit_s * US_PER_S:
            return ()
        self.disarm()
        return (_info(text),)


_DONE = {Action.TERMINATE: "flight terminated", Action.DISARM: "disarmed"}


def _info(text: str) -> Notice:
    return Notice(common.MAV_SEVERITY_INFO, text)
