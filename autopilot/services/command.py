"""MAVLink's command service: COMMAND_LONG, COMMAND_INT and the older SET_MODE, by a table of actions.

Every message is acknowledged, so a sender that repeats a lost one gets its answer. A COMMAND_LONG marked as a
repetition is answered from memory and not executed again. A command that is executed elsewhere is first
acknowledged as in progress, and again when it has ended. A refusal carries a MAV_RESULT for the program and a
STATUSTEXT for the operator. The actions are in `actions_flight` and `actions_system`.
"""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Reason
from autopilot.mavlink.codec import Message
from autopilot.services.service import ALL, Addressed, Newest, Partner, Service, reply
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


class _Key(NamedTuple):
    """Identity of a command: its source, its number, and the bytes of its parameters."""

    partner: Partner
    system: int
    component: int
    command: int
    params: bytes

    def acknowledge(self, result: int) -> list[Addressed]:
        """COMMAND_ACK to the source."""
        message = common.MAVLink_command_ack_message(
            self.command, result, target_system=self.system, target_component=self.component
        )
        return reply(self.partner, message)


class CommandService(Service):
    """Commands of all links, each executed by its action in a table."""

    def __init__(self, actions: Mapping[int, Action]) -> None:
        super().__init__(COMMAND_LONG=self._on_long, COMMAND_INT=self._on_int, SET_MODE=self._on_mode)
        self._actions = actions
        self._done: Newest[_Key, _Done] = Newest(REMEMBERED_MAX)
        self._in_progress: Newest[_Key, None] = Newest(REMEMBERED_MAX)
        """Requests without a final result."""

    def _on_mode(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24
        params = (float(message.base_mode), float(main), float(sub), 0.0, 0.0, 0.0, 0.0)
        request = CommandRequest(params, Place(common.MAV_FRAME_GLOBAL, None, None, None), now_us, partner)
        return self._execute(_key(message, common.MAV_CMD_DO_SET_MODE, request), request)

    def _on_int(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Execute a command whose coordinates are integers in 1e-7 degrees."""
        m = message
        params = (m.param1, m.param2, m.param3, m.param4, float(m.x), float(m.y), m.z)
        lat_deg, lon_deg = (None if n in _UNSET else n * 1e-7 for n in (m.x, m.y))
        request = CommandRequest(params, Place(m.frame, lat_deg, lon_deg, given(m.z)), now_us, partner)
        return self._execute(_key(m, m.command, request), request)

    def _on_long(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Execute a command, or answer a repetition from memory."""
        m = message
        params = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        place = Place(common.MAV_FRAME_GLOBAL, *map(given, params[4:]))
        request = CommandRequest(params, place, now_us, partner)
        key = _key(m, m.command, request)
        done = self._done.get(key) if m.confirmation > 0 else None
        if done is not None and now_us - done.at_us <= REMEMBERED_US:
            return key.acknowledge(done.result)
        return self._execute(key, request, is_remembered=True)

    def _execute(
        self, key: _Key, request: CommandRequest, *, is_remembered: bool = False
    ) -> Sequence[Addressed]:
        action = self._actions.get(key.command)
        answer = Answer(UNSUPPORTED) if action is None else action(request)
        if answer.result == IN_PROGRESS:
            self._in_progress[key] = None
        if is_remembered:
            self._done[key] = _Done(request.now_us, answer.result)
        # the acknowledgement is for the sender alone; STATUSTEXT is for all, requested messages for the link
        link = Partner(request.partner.link)
        return [
            *key.acknowledge(answer.result),
            *(Addressed(ALL if sent.get_msgId() == _STATUSTEXT else link, sent) for sent in answer.messages),
        ]

    def finish(self, command: int, result: int, now_us: int) -> list[Addressed]:
        """Acknowledge the end of a command that is in progress, to each partner that requested it."""
        answers: list[Addressed] = []
        for key in [key for key in self._in_progress if key.command == command]:
            del self._in_progress[key]
            self._done[key] = _Done(now_us, result)
            answers += key.acknowledge(result)
        return answers


def _key(message: Message, command: int, request: CommandRequest) -> _Key:
    source = (message.get_srcSystem(), message.get_srcComponent())
    return _Key(request.partner, *source, command, _KEY.pack(*request.params))


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
