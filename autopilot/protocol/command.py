"""MAVLink's command service: COMMAND_LONG, COMMAND_INT and the older SET_MODE, by a table of actions.

Every command is acknowledged once per message, so a sender that repeats a lost one gets its answer. A
refusal carries a MAV_RESULT for the program and a STATUSTEXT for the person.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander
from autopilot.commander.conditions import Reason
from autopilot.mavlink.codec import Message
from autopilot.mavlink.modes import FlightMode, mode_from_custom, mode_from_main_sub
from autopilot.protocol.service import ALL, Addressed, Listener, Partner, reply
from autopilot.protocol.status import status_text
from autopilot.protocol.streams import Streams

FORCE_MAGIC = 21196.0
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM: skip the checks."""

_STATUSTEXT = common.MAVLINK_MSG_ID_STATUSTEXT

Params = tuple[float, float, float, float, float, float, float]


class Answer(NamedTuple):
    """What came of a command."""

    result: int = common.MAV_RESULT_ACCEPTED
    messages: tuple[Message, ...] = ()


class TakeoffAltitude:
    """The altitude that the next take-off climbs to, shared by the links and whoever makes the setpoints."""

    def __init__(self) -> None:
        self.amsl_m: float | None = None
        """None: MIS_TAKEOFF_ALT above home."""


class CommandService(Listener):
    """The commands of all links, whose streams are given by the links' numbers."""

    takes = frozenset(
        {
            common.MAVLINK_MSG_ID_COMMAND_LONG,
            common.MAVLINK_MSG_ID_COMMAND_INT,
            common.MAVLINK_MSG_ID_SET_MODE,
        }
    )

    def __init__(
        self,
        commander: Commander,
        takeoff_altitude: TakeoffAltitude,
        streams: Mapping[int, Streams],
        *,
        save_parameters: Callable[[], bool] = lambda: False,
    ) -> None:
        self._commander = commander
        self._takeoff_altitude = takeoff_altitude
        self._streams = streams
        self._save_parameters = save_parameters
        self._actions: dict[int, Callable[[Params, int, Partner], Answer]] = {
            common.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_or_disarm,
            common.MAV_CMD_DO_SET_MODE: self._set_mode,
            common.MAV_CMD_NAV_TAKEOFF: self._take_off,
            common.MAV_CMD_NAV_LAND: self._land,
            common.MAV_CMD_NAV_RETURN_TO_LAUNCH: self._return,
            common.MAV_CMD_MISSION_START: self._start_mission,
            common.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            common.MAV_CMD_RUN_PREARM_CHECKS: self._check,
            common.MAV_CMD_PREFLIGHT_STORAGE: self._store,
            common.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
            common.MAV_CMD_REQUEST_MESSAGE: self._request_message,
        }

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Do what a command message asks and acknowledge it."""
        kind = message.get_msgId()
        if kind == common.MAVLINK_MSG_ID_COMMAND_LONG:
            params: Params = (
                message.param1, message.param2, message.param3, message.param4,
                message.param5, message.param6, message.param7,
            )  # fmt: skip
        elif kind == common.MAVLINK_MSG_ID_COMMAND_INT:
            # x and y are scaled by the frame; no command here takes a place, so they pass as they are
            params = (
                message.param1, message.param2, message.param3, message.param4,
                float(message.x), float(message.y), message.z,
            )  # fmt: skip
        else:
            return reply(ALL, *self._enter(mode_from_custom(message.custom_mode), "Mode").messages)
        action = self._actions.get(message.command)
        answer = Answer(common.MAV_RESULT_UNSUPPORTED) if action is None else action(params, now_us, partner)
        ack = common.MAVLink_command_ack_message(
            message.command,
            answer.result,
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
        )
        # an answer is the asker's alone; what is said in words, and what was asked to be sent, is for all
        texts = (message.get_msgId() == _STATUSTEXT for message in answer.messages)
        return [
            *reply(partner, ack),
            *(
                Addressed(ALL if is_text else Partner(partner.link), message)
                for is_text, message in zip(texts, answer.messages, strict=True)
            ),
        ]

    def _arm_or_disarm(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        forced = params[1] == FORCE_MAGIC
        if params[0] == 1.0:
            return _answer("Arming", self._commander.arm(now_us, forced=forced))
        if params[0] == 0.0:
            return _answer("Disarming", self._commander.disarm(forced=forced))
        return _answer("Arming", Reason.BAD_ARGUMENT)

    def _set_mode(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        base_mode = params[0]
        if not (0.0 <= base_mode < 256.0 and int(base_mode) & common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
            return _answer("Mode", Reason.BAD_ARGUMENT)
        return self._enter(mode_from_main_sub(params[1], params[2]), "Mode")

    def _take_off(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        altitude_m = params[6]
        return self._enter(
            FlightMode.TAKEOFF, "Takeoff", amsl_m=altitude_m if math.isfinite(altitude_m) else None
        )

    def _land(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        return self._enter(FlightMode.LAND, "Landing")

    def _return(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        return self._enter(FlightMode.RETURN, "Return")

    def _start_mission(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        """Enter mission mode and arm, as PX4 does; the items of the parameters are not looked at."""
        answer = self._enter(FlightMode.MISSION, "Mission")
        if answer.result != common.MAV_RESULT_ACCEPTED:
            return answer
        return _answer("Arming", self._commander.arm(now_us))

    def _terminate(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        if params[0] < 0.5:
            return Answer(common.MAV_RESULT_UNSUPPORTED)  # a terminated flight is not taken up again
        if not params[0] >= 0.5:
            return _answer("Termination", Reason.BAD_ARGUMENT)
        self._commander.terminate()
        text = status_text(common.MAV_SEVERITY_EMERGENCY, "Flight terminated by command")
        return Answer(messages=(text,))

    def _check(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        """Say everything for which arming would be refused."""
        if self._commander.armed:
            return Answer(common.MAV_RESULT_TEMPORARILY_REJECTED)
        refusals = self._commander.arming_refusals()
        return Answer(messages=tuple(_refusal_text("Arming", refusal) for refusal in refusals))

    def _store(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        """Write the parameters to their file; reading and resetting are done by a new start."""
        if params[0] != 1.0 or not self._save_parameters():
            return Answer(common.MAV_RESULT_UNSUPPORTED)
        return Answer()

    def _enter(self, mode: FlightMode | None, what: str, *, amsl_m: float | None = None) -> Answer:
        refusal = self._commander.set_mode(mode)
        if refusal is None:
            self._takeoff_altitude.amsl_m = amsl_m
        return _answer(what, refusal)

    def _set_message_interval(self, params: Params, now_us: int, partner: Partner) -> Answer:
        if not all(map(math.isfinite, params[:2])):
            return Answer(common.MAV_RESULT_DENIED)
        known = self._streams[partner.link].set_interval(int(params[0]), int(params[1]), now_us)
        return Answer(common.MAV_RESULT_ACCEPTED if known else common.MAV_RESULT_UNSUPPORTED)

    def _request_message(self, params: Params, now_us: int, partner: Partner) -> Answer:  # noqa: ARG002
        message_id = int(params[0]) if math.isfinite(params[0]) else -1
        streams = self._streams[partner.link]
        if not streams.knows(message_id):
            return Answer(common.MAV_RESULT_UNSUPPORTED)
        message = streams.form(message_id)
        return (
            Answer(common.MAV_RESULT_TEMPORARILY_REJECTED) if message is None else Answer(messages=(message,))
        )


def _answer(what: str, refusal: Reason | None) -> Answer:
    return Answer() if refusal is None else Answer(refusal.result, (_refusal_text(what, refusal),))


def _refusal_text(what: str, refusal: Reason) -> Message:
    return status_text(common.MAV_SEVERITY_CRITICAL, f"{what} denied: {refusal.text}")
