"""MAVLink's command service: COMMAND_LONG, COMMAND_INT and the older SET_MODE, by a table of actions.

Every message is acknowledged, so a sender that repeats a lost one gets its answer. A COMMAND_LONG marked as a
repetition is answered from memory and not executed again. A command that is executed elsewhere is first
acknowledged as in progress, and again when it has ended. A refusal carries a MAV_RESULT for the program and a
STATUSTEXT for the operator. The actions are in `actions_flight` and `actions_system`.
"""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeVar

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Reason
from autopilot.mavlink.codec import Message
from autopilot.services.service import ALL, Addressed, Listener, Partner, reply
from autopilot.services.status import status_text

ACCEPTED: int = common.MAV_RESULT_ACCEPTED
DENIED: int = common.MAV_RESULT_DENIED
FAILED: int = common.MAV_RESULT_FAILED
IN_PROGRESS: int = common.MAV_RESULT_IN_PROGRESS
REJECTED: int = common.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED: int = common.MAV_RESULT_UNSUPPORTED

AMSL_FRAMES = frozenset({common.MAV_FRAME_GLOBAL, common.MAV_FRAME_GLOBAL_INT})
RELATIVE_FRAMES = frozenset({common.MAV_FRAME_GLOBAL_RELATIVE_ALT, common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
"""Frames whose altitudes are above home."""
REMEMBERED_US = 2_000_000
"""How long a repetition is recognised."""
REMEMBERED_MAX = 32
"""Commands that are remembered; a new one replaces the oldest."""
_UNSET = frozenset({0x7FFF_FFFF, 0x7FF8_0000})
"""Coordinates of COMMAND_INT that are not given: MAVLink's mark, and a float's NaN, as in PX4."""
_STATUSTEXT = common.MAVLINK_MSG_ID_STATUSTEXT
_KEY = struct.Struct("<7d")

Params = tuple[float, float, float, float, float, float, float]


class Place(NamedTuple):
    """Target position of a command; None: not given. Numbers are finite but otherwise unchecked."""

    frame: int
    """MAV_FRAME: reference of the altitude."""
    lat_deg: float | None
    lon_deg: float | None
    alt_m: float | None


class CommandRequest(NamedTuple):
    """A received command."""

    params: Params
    """The fifth and sixth of COMMAND_INT are its raw integers."""
    place: Place
    now_us: int
    partner: Partner


class Answer(NamedTuple):
    """Result of a command."""

    result: int = ACCEPTED
    messages: tuple[Message, ...] = ()
    """STATUSTEXT is sent to all partners, other messages to the requesting link."""


Action = Callable[[CommandRequest], Answer]


class TakeoffAltitude:
    """The altitude of the next take-off, shared by the links and the setpoint generator."""

    def __init__(self) -> None:
        self.amsl_m: float | None = None
        """Altitude above mean sea level in metres; None: MIS_TAKEOFF_ALT above home."""


class _Done(NamedTuple):
    at_us: int
    result: int


_Value = TypeVar("_Value")
_Key = tuple[Partner, int, int, int, bytes]
"""Partner, its system and component id, the command, the parameters' bytes."""


class CommandService(Listener):
    """Commands of all links, each executed by its action in a table."""

    takes = frozenset(
        {
            common.MAVLINK_MSG_ID_COMMAND_LONG,
            common.MAVLINK_MSG_ID_COMMAND_INT,
            common.MAVLINK_MSG_ID_SET_MODE,
        }
    )

    def __init__(self, actions: Mapping[int, Action]) -> None:
        self._actions = actions
        self._done: dict[_Key, _Done] = {}
        self._in_progress: dict[_Key, None] = {}
        """Requests without a final result; at most REMEMBERED_MAX."""

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Execute a command message and acknowledge it."""
        kind = message.get_msgId()
        if kind == common.MAVLINK_MSG_ID_SET_MODE:
            command: int = common.MAV_CMD_DO_SET_MODE
            custom = message.custom_mode
            params: Params = (
                float(message.base_mode), float(custom >> 16 & 0xFF), float(custom >> 24), 0.0, 0.0, 0.0, 0.0
            )  # fmt: skip
            place, repeats = _NOWHERE, False
        elif kind == common.MAVLINK_MSG_ID_COMMAND_LONG:
            command = message.command
            params = (
                message.param1, message.param2, message.param3, message.param4,
                message.param5, message.param6, message.param7,
            )  # fmt: skip
            place = Place(common.MAV_FRAME_GLOBAL, *map(given, params[4:]))
            repeats = message.confirmation > 0
        else:
            command, place, repeats = message.command, _place_of_int(message), False
            params = (
                message.param1, message.param2, message.param3, message.param4,
                float(message.x), float(message.y), message.z,
            )  # fmt: skip
        source = (message.get_srcSystem(), message.get_srcComponent())
        key = (partner, *source, command, _KEY.pack(*params))
        if repeats and (done := self._done.get(key)) is not None and now_us - done.at_us <= REMEMBERED_US:
            return reply(partner, _acknowledgement(command, done.result, source))
        action = self._actions.get(command)
        answer = (
            Answer(UNSUPPORTED) if action is None else action(CommandRequest(params, place, now_us, partner))
        )
        if answer.result == IN_PROGRESS:
            _put(self._in_progress, key, None)
        if kind == common.MAVLINK_MSG_ID_COMMAND_LONG:
            _put(self._done, key, _Done(now_us, answer.result))
        # the acknowledgement is for the sender alone; STATUSTEXT is for all, requested messages for the link
        return [
            *reply(partner, _acknowledgement(command, answer.result, source)),
            *(
                Addressed(ALL if sent.get_msgId() == _STATUSTEXT else Partner(partner.link), sent)
                for sent in answer.messages
            ),
        ]

    def finish(self, command: int, result: int, now_us: int) -> list[Addressed]:
        """Acknowledge the end of a command that is in progress, to each partner that requested it."""
        ended = [key for key in self._in_progress if key[3] == command]
        answers: list[Addressed] = []
        for key in ended:
            del self._in_progress[key]
            _put(self._done, key, _Done(now_us, result))
            answers += reply(key[0], _acknowledgement(command, result, (key[1], key[2])))
        return answers


def _put(memory: dict[_Key, _Value], key: _Key, value: _Value) -> None:
    """Store a value as the newest entry and drop the oldest beyond REMEMBERED_MAX."""
    memory.pop(key, None)
    memory[key] = value
    if len(memory) > REMEMBERED_MAX:
        del memory[next(iter(memory))]


def given(value: float) -> float | None:
    """Read a parameter; None if it is NaN or infinite, that is, not given."""
    return value if math.isfinite(value) else None


def whole(value: float) -> int:
    """Read an integer parameter; -1 if it is not an integer. No command uses -1."""
    return int(value) if math.isfinite(value) and value == math.floor(value) else -1


def answer_for(what: str, refusal: Reason | None) -> Answer:
    """Accept, or refuse with the reason."""
    return Answer() if refusal is None else Answer(refusal.result, (refusal_text(what, refusal),))


def refusal_text(what: str, refusal: Reason) -> Message:
    """STATUSTEXT with the reason of a refusal."""
    return status_text(common.MAV_SEVERITY_CRITICAL, f"{what} denied: {refusal.text}")


_NOWHERE = Place(common.MAV_FRAME_GLOBAL, None, None, None)


def _place_of_int(message: Message) -> Place:
    """Decode COMMAND_INT's position, whose coordinates are integers in 1e-7 degrees."""
    lat_deg, lon_deg = (None if n in _UNSET else n * 1e-7 for n in (message.x, message.y))
    return Place(message.frame, lat_deg, lon_deg, given(message.z))


def _acknowledgement(command: int, result: int, source: tuple[int, int]) -> Message:
    return common.MAVLink_command_ack_message(
        command, result, target_system=source[0], target_component=source[1]
    )
