"""Failsafes: detected causes, the actions that parameters assign to them, and the action in effect.

After PX4's failsafe framework. Each cause has a row in `ROWS`: a parameter, and for each of its values an
action, when that action ends, and whether the pilot may take over. The most drastic of the active actions is
selected; an infeasible action falls through to the next more drastic one. Pure: time, conditions and
parameters are the inputs, a decision is the output.
"""

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from types import MappingProxyType
from typing import NamedTuple

from autopilot.commander.arming_checks import Condition, Reason, first_missing
from autopilot.commander.mode_table import ModeTable
from autopilot.commander.params import CommanderParams
from autopilot.mavlink.modes import FlightMode

US_PER_S = 1_000_000


class Cause(IntFlag):
    """Detected faults, as bits."""

    GPS_LOST = 1
    """No fix has arrived within the time-out of the sensor."""
    ESTIMATOR_FAILED = 2
    """The estimator contradicts its measurements, or has no attitude estimate."""
    GCS_LOST = 4
    """No message of a ground station has arrived for COM_DL_LOSS_T."""
    MANUAL_LOST = 8
    """Stick input was received once, and has stopped for COM_RC_LOSS_T."""
    BATTERY_LOW = 16
    BATTERY_CRITICAL = 32
    BATTERY_EMERGENCY = 64
    """At most one of the three is set."""
    GEOFENCE = 128
    MOTOR_FAILED = 256
    TIPPED_OVER = 512
    """Roll or pitch beyond FD_FAIL_R, FD_FAIL_P."""
    MODE_NEEDS = 1024
    """A condition that the selected mode needs is not met. Detected in this module, not an input."""


class Action(IntEnum):
    """Failsafe actions in increasing order of severity, as in PX4."""

    NONE = 0
    WARN = 1
    POSITION = 2
    ALTITUDE = 3
    STABILIZED = 4
    HOLD = 5
    RETURN = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


class Ends(IntEnum):
    """When an action ends; a greater value lasts longer."""

    WITH_CAUSE = 0
    MODE_CHANGE = 1
    """After the cause is gone and the pilot has selected a mode."""
    NEVER = 2
    """At the end of the flight."""


class FailsafeResponse(NamedTuple):
    """Response that one value of a parameter selects."""

    action: Action
    ends: Ends = Ends.MODE_CHANGE
    delayed: bool = False
    """Hold for COM_FAIL_ACT_T first, so that the pilot can take over."""


class Row(NamedTuple):
    """Responses to one cause."""

    cause: Cause
    text: str
    parameter: str | None
    """Name in PX4; None: the response is fixed."""
    field: str
    """Name of the field of `CommanderParams`."""
    responses: Mapping[int, FailsafeResponse]
    """By value of the parameter; other values have no effect."""


_WARN = FailsafeResponse(Action.WARN, Ends.WITH_CAUSE)
_HOLD = FailsafeResponse(Action.HOLD)
_TERMINATE = FailsafeResponse(Action.TERMINATE, Ends.NEVER)
_DISARM = FailsafeResponse(Action.DISARM, Ends.WITH_CAUSE)


def _delayed(action: Action, ends: Ends = Ends.MODE_CHANGE) -> FailsafeResponse:
    return FailsafeResponse(action, ends, delayed=True)


_LINK_LOSS: Mapping[int, FailsafeResponse] = MappingProxyType({
    1: _delayed(Action.HOLD), 2: _delayed(Action.RETURN), 3: _delayed(Action.LAND), 5: _TERMINATE, 6: _DISARM,
})  # fmt: skip
_WITH_CAUSE = Ends.WITH_CAUSE

ROWS: tuple[Row, ...] = (
    Row(Cause.TIPPED_OVER, "not upright", "CBRK_FLIGHTTERM", "termination_breaker",
        {0: _TERMINATE, 121_212: _WARN}),
    Row(Cause.ESTIMATOR_FAILED, "estimator failed", None, "",
        {0: FailsafeResponse(Action.DESCEND, _WITH_CAUSE)}),
    Row(Cause.MOTOR_FAILED, "motor failure", "COM_ACT_FAIL_ACT", "motor_failure_action",
        {0: _WARN, 1: _delayed(Action.HOLD, _WITH_CAUSE), 2: _delayed(Action.LAND),
         3: _delayed(Action.RETURN), 4: _TERMINATE}),
    Row(Cause.BATTERY_EMERGENCY, "battery empty", "COM_LOW_BAT_ACT", "low_battery_action",
        {0: _WARN, 1: _delayed(Action.RETURN), 2: _delayed(Action.LAND), 3: _delayed(Action.LAND)}),
    Row(Cause.BATTERY_CRITICAL, "battery critical", "COM_LOW_BAT_ACT", "low_battery_action",
        {0: _WARN, 1: _delayed(Action.RETURN), 2: _delayed(Action.LAND), 3: _delayed(Action.RETURN)}),
    Row(Cause.BATTERY_LOW, "battery low", "COM_LOW_BAT_ACT", "low_battery_action",
        {0: _WARN, 1: _WARN, 2: _WARN, 3: _WARN}),
    Row(Cause.GEOFENCE, "geofence", "GF_ACTION", "geofence_action",
        {1: _WARN, 2: _HOLD, 3: _delayed(Action.RETURN), 4: _TERMINATE, 5: _delayed(Action.LAND)}),
    Row(Cause.GPS_LOST, "GPS lost", "COM_GNSSLOSS_ACT", "gps_loss_action",
        {0: _WARN, 1: _delayed(Action.RETURN), 2: _delayed(Action.LAND), 3: _TERMINATE}),
    Row(Cause.GCS_LOST, "no ground station", "NAV_DLL_ACT", "gcs_loss_action", _LINK_LOSS),
    Row(Cause.MANUAL_LOST, "no manual control", "NAV_RCL_ACT", "manual_loss_action", _LINK_LOSS),
)  # fmt: skip
"""Of two causes with the same action, the text of the earlier row is reported."""

OFFBOARD_LOSS: Mapping[int, FailsafeResponse] = MappingProxyType({
    0: FailsafeResponse(Action.POSITION), 1: FailsafeResponse(Action.ALTITUDE),
    2: FailsafeResponse(Action.STABILIZED), 3: FailsafeResponse(Action.RETURN),
    4: FailsafeResponse(Action.LAND), 5: FailsafeResponse(Action.HOLD),
    6: _TERMINATE, 7: _DISARM,
})  # fmt: skip
"""Responses by value of COM_OBL_RC_ACT. A manual mode without stick input falls through to hold. New
setpoints do not restore offboard mode."""

MODE_OF: Mapping[Action, FlightMode] = MappingProxyType({
    Action.POSITION: FlightMode.POSITION, Action.ALTITUDE: FlightMode.ALTITUDE,
    Action.STABILIZED: FlightMode.STABILIZED, Action.HOLD: FlightMode.HOLD,
    Action.RETURN: FlightMode.RETURN, Action.LAND: FlightMode.LAND, Action.DESCEND: FlightMode.DESCEND,
})  # fmt: skip

_EXCEPT_MISSION, _EXCEPT_AUTO, _EXCEPT_OFFBOARD = 1, 2, 4
"""Bits of COM_RCL_EXCEPT and COM_DLL_EXCEPT."""
_SETTLING_US = 3 * US_PER_S
"""For this time after the spool-up a vehicle that tips over is disarmed; later its flight is terminated."""
_TERMINATE_AFTER_US = 500_000
"""Descent without a feasible mode before the motors stop, in case the fault is transient."""


class Decision(NamedTuple):
    """Failsafe action in effect and its cause."""

    action: Action = Action.NONE
    text: str = ""
    then: Action | None = None
    """Action that follows a delaying hold."""
    delay_s: float = 0.0
    """Remaining time of the hold."""
    taken_over: bool = False
    """The pilot flies although an active failsafe requires more than a warning."""


NOTHING = Decision()


class _Active(NamedTuple):
    response: FailsafeResponse
    text: str
    present: bool


class Failsafe:
    """Active failsafes of one flight; call `update` at every decision."""

    def __init__(self, modes: ModeTable) -> None:
        self._modes = modes
        self.decision = NOTHING
        self._active: dict[Cause, _Active] = {}
        self._taken_over = False
        self._act_us: int | None = None
        """End of the hold before a delayed action."""
        self.warnings: tuple[str, ...] = ()
        """Texts of the causes that became active in the last call and only require a warning."""
        self._ignored = 0
        """Causes that were present at arming and are ignored: a low battery, manual control lost."""
        self._armed_us: int | None = None
        self._infeasible_us: int | None = None
        """Since when no mode is feasible."""
        self._configured: tuple[CommanderParams, FlightMode, int] | None = None

    def update(
        self, now_us: int, *, params: CommanderParams, causes: int, conditions: int,
        mode: FlightMode, armed: bool, landed: bool, mode_chosen: bool,
    ) -> Decision:  # fmt: skip
        """Return the decision for the present `Cause` and `Condition` bits.

        ``mode`` is the mode that the pilot has selected, ``mode_chosen`` whether it was requested since the
        last call: during a failsafe the pilot takes over by a request.
        """
        self.warnings = ()
        if self.decision.action is Action.TERMINATE:
            return self.decision
        if not armed:
            if self._armed_us is not None:
                self._reset()
            return NOTHING
        if self._armed_us is None:
            self._armed_us = now_us
            self._ignored = causes & _IGNORED_AT_ARMING
        self._ignored &= causes  # a cause that disappeared once is no longer ignored
        causes &= self._configured_causes(params, mode)
        missing = self._modes.needs[mode] & ~conditions
        if not causes and not missing and not self._active:
            self._taken_over = False
            self.decision = NOTHING
            return NOTHING
        present = self._responses(now_us, params, causes & ~self._ignored, conditions, mode, missing)
        self._update_active(present, now_us, params, mode_chosen=mode_chosen)
        self.decision = self._decide(now_us, conditions, mode, missing, landed=landed)
        return self.decision

    def _reset(self) -> None:
        self.decision = NOTHING
        self._active.clear()
        self._taken_over = False
        self._act_us = self._armed_us = self._infeasible_us = None

    # ---- responses to the causes

    def _configured_causes(self, params: CommanderParams, mode: FlightMode) -> int:
        """Return the bits of the causes that the parameters assign a response to in this mode."""
        known = self._configured
        if known is None or known[0] is not params or known[1] is not mode:
            bits = 0
            for row in ROWS:
                if _value(row, params) in row.responses and not self._is_excepted(row.cause, mode, params):
                    bits |= int(row.cause)
            self._configured = known = (params, mode, bits)
        return known[2]

    def _responses(
        self, now_us: int, params: CommanderParams, causes: int, conditions: int, mode: FlightMode,
        missing: int,
    ) -> dict[Cause, tuple[FailsafeResponse, str]]:  # fmt: skip
        present: dict[Cause, tuple[FailsafeResponse, str]] = {}
        for row in ROWS:
            if causes & row.cause:
                response = row.responses[_value(row, params)]
                if row.cause is Cause.TIPPED_OVER and self._has_just_started(now_us, params):
                    response = _DISARM
                present[row.cause] = (response, row.text)
        if missing:
            reason = first_missing(missing, 0)
            assert reason is not None  # noqa: S101  # something is missing
            present[Cause.MODE_NEEDS] = (
                self._mode_response(mode, missing, conditions, params),
                reason.text,
            )
        return present

    def _has_just_started(self, now_us: int, params: CommanderParams) -> bool:
        armed_us = now_us if self._armed_us is None else self._armed_us
        return now_us - armed_us < params.spool_up_s * US_PER_S + _SETTLING_US

    def _update_active(
        self, present: Mapping[Cause, tuple[FailsafeResponse, str]], now_us: int, params: CommanderParams,
        *, mode_chosen: bool,
    ) -> None:  # fmt: skip
        """Update the active failsafes and the takeover by the pilot."""
        active = self._active
        if mode_chosen and Action.HOLD <= self.decision.action <= Action.DESCEND:
            self._taken_over = True
            self._act_us = None
        for cause in list(active):
            ends = active[cause].response.ends
            if cause in present:
                continue
            if ends is Ends.WITH_CAUSE or (ends is Ends.MODE_CHANGE and mode_chosen):
                del active[cause]
            else:
                active[cause] = active[cause]._replace(present=False)
        for cause, (response, text) in present.items():
            known = active.get(cause)
            if known is None or not known.present:
                if response.action is Action.WARN:
                    self.warnings += (text,)
                if response.action >= Action.HOLD:
                    self._taken_over = False  # the takeover was from another failsafe
                if response.delayed and params.action_delay_s > 0.0 and self._act_us is None:
                    self._act_us = now_us + round(params.action_delay_s * US_PER_S)
                active[cause] = _Active(response, text, present=True)
            else:  # parameter changed, or another need of the mode; the end condition only gets stricter
                ends = max(known.response.ends, response.ends)
                active[cause] = _Active(response._replace(ends=ends), text, present=True)

    # ---- decision

    def _decide(
        self, now_us: int, conditions: int, mode: FlightMode, missing: int, *, landed: bool
    ) -> Decision:
        if not self._active:
            self._act_us = self._infeasible_us = None
            self._taken_over = False
            return NOTHING
        worst = max(self._active.values(), key=lambda active: active.response.action)
        action, then, delay_s = worst.response.action, None, 0.0
        if self._taken_over and action <= Action.DESCEND:
            fallback = self._active.get(Cause.MODE_NEEDS)
            if fallback is None or not missing:
                return Decision(Action.WARN, worst.text, taken_over=action > Action.WARN)
            action, worst = fallback.response.action, fallback
        if self._act_us is not None:
            holdable = not self._modes.needs[FlightMode.HOLD] & ~conditions
            if now_us >= self._act_us or not holdable or self.decision.action > Action.HOLD:
                self._act_us = now_us  # the hold is over for the rest of this failsafe
            elif worst.response.delayed and action > Action.HOLD:
                then, delay_s, action = action, (self._act_us - now_us) / US_PER_S, Action.HOLD
        action = self._possible(now_us, feasible(action, conditions, self._modes), action, landed=landed)
        if mode is FlightMode.LAND and Action.RETURN in {action, then} and not missing:
            return Decision(Action.WARN, worst.text)  # already descending
        return Decision(action, worst.text, then, delay_s)

    def _possible(self, now_us: int, feasible_action: Action, requested: Action, *, landed: bool) -> Action:
        """Delay termination, which is irreversible: the lack of a feasible mode may be transient."""
        if feasible_action is not Action.TERMINATE or requested is Action.TERMINATE:
            self._infeasible_us = None
            return feasible_action
        if landed:
            return Action.DISARM
        if self._infeasible_us is None:
            self._infeasible_us = now_us
        infeasible_us = now_us - self._infeasible_us
        return Action.TERMINATE if infeasible_us >= _TERMINATE_AFTER_US else Action.DESCEND

    def _mode_response(
        self, mode: FlightMode, missing: int, conditions: int, params: CommanderParams
    ) -> FailsafeResponse:
        if missing & Condition.SETPOINTS:
            return OFFBOARD_LOSS[params.offboard_loss_action]
        by_sticks = mode in self._modes.by_sticks
        if by_sticks and conditions & Condition.MANUAL:
            return FailsafeResponse(
                Action.ALTITUDE if mode is FlightMode.POSITION else Action.STABILIZED, _WITH_CAUSE
            )
        return FailsafeResponse(Action.HOLD if by_sticks else Action.RETURN, _WITH_CAUSE)

    def _is_excepted(self, cause: Cause, mode: FlightMode, params: CommanderParams) -> bool:
        """Return whether this mode ignores the loss of a link."""
        if cause is Cause.GCS_LOST:
            mask = params.gcs_loss_except
            if mode is FlightMode.LAND:
                return True
        elif cause is Cause.MANUAL_LOST:
            mask = params.manual_loss_except
        else:
            return False
        bit = _EXCEPT_AUTO if mode in self._modes.automatic else 0
        bit = {FlightMode.MISSION: _EXCEPT_MISSION, FlightMode.OFFBOARD: _EXCEPT_OFFBOARD}.get(mode, bit)
        return bool(mask & bit)


_IGNORED_AT_ARMING = int(
    Cause.MANUAL_LOST | Cause.BATTERY_LOW | Cause.BATTERY_CRITICAL | Cause.BATTERY_EMERGENCY
)


def feasible(action: Action, conditions: int, modes: ModeTable) -> Action:
    """Return the first action, in order of severity from this one, whose mode has its needs met."""
    if not Action.POSITION <= action <= Action.DESCEND:
        return action
    able = (
        candidate
        for candidate, mode in MODE_OF.items()
        if candidate >= action and not modes.needs[mode] & ~conditions
    )
    return next(able, Action.TERMINATE)


def _value(row: Row, params: CommanderParams) -> int:
    value: int = getattr(params, row.field) if row.field else 0
    return value


ARMING_CAUSES: tuple[tuple[Cause, Reason], ...] = (
    (Cause.ESTIMATOR_FAILED, Reason.ESTIMATOR_FAILED),
    (Cause.TIPPED_OVER, Reason.TIPPED_OVER),
    (Cause.BATTERY_CRITICAL, Reason.BATTERY_LOW),
    (Cause.BATTERY_EMERGENCY, Reason.BATTERY_LOW),
    (Cause.GEOFENCE, Reason.OUTSIDE_GEOFENCE),
    (Cause.GCS_LOST, Reason.NO_GROUND_STATION),
)
"""Causes that prevent arming, in addition to missing conditions; a lost ground station and a geofence breach
only if a parameter assigns an action to them."""
