"""MAVLink's parameter service: list, read by name or index, set. Integers travel as raw bytes, as PX4's do.

A set is answered with the value that holds afterwards, so a refused one comes back unchanged, with a
STATUSTEXT that says why.
"""

import struct
from collections.abc import Callable, Sequence

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.params import INDEX_OF, TABLE, ParameterError
from autopilot.protocol.service import ALL, NEVER_US, Addressed, Partner, reply
from autopilot.protocol.status import status_text

LIST_PERIOD_US = 20_000
LIST_BATCH = 8
"""Values of a list go out in batches, so that it takes a quarter of a second and not one burst."""

Getter = Callable[[str], float]
Setter = Callable[[str, float], None]
"""Both raise ParameterError."""


class ParameterService:
    """The parameters as the links see them; each partner may be sent its list."""

    takes = frozenset(
        {
            common.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
            common.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
            common.MAVLINK_MSG_ID_PARAM_SET,
        }
    )

    def __init__(self, get: Getter, put: Setter) -> None:
        self._get = get
        self._put = put
        self._next_index: dict[Partner, int] = {}
        self._list_due_us = NEVER_US

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Answer a request; a list is sent by `on_timer`, and asking for it again starts it anew."""
        kind = message.get_msgId()
        if kind == common.MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
            self._next_index[partner] = 0
            self._list_due_us = min(self._list_due_us, now_us)
        elif kind == common.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
            index = message.param_index if message.param_index >= 0 else INDEX_OF.get(message.param_id, -1)
            if 0 <= index < len(TABLE):
                return reply(partner, self._value(index))
        elif kind == common.MAVLINK_MSG_ID_PARAM_SET and message.param_id in INDEX_OF:
            return self._set(INDEX_OF[message.param_id], message)
        return ()

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Send the next batch of each list."""
        if now_us < self._list_due_us:
            return ()
        messages: list[Addressed] = []
        for partner, begin in list(self._next_index.items()):
            until = min(begin + LIST_BATCH, len(TABLE))
            messages += reply(partner, *(self._value(index) for index in range(begin, until)))
            self._next_index[partner] = until
            if until == len(TABLE):
                del self._next_index[partner]
        self._list_due_us = now_us + LIST_PERIOD_US if self._next_index else NEVER_US
        return messages

    def next_deadline_us(self) -> int:
        """When the next batch is due."""
        return self._list_due_us

    def _set(self, index: int, message: Message) -> Sequence[Addressed]:
        parameter = TABLE[index]
        try:
            if message.param_type != _wire_type(index):
                raise ParameterError(f"{parameter.name}: wrong type")  # noqa: TRY301  # one place that answers a refusal
            self._put(parameter.name, _from_wire(index, message.param_value))
        except ParameterError as error:
            return reply(ALL, self._value(index), status_text(common.MAV_SEVERITY_WARNING, str(error)))
        return reply(ALL, self._value(index))

    def _value(self, index: int) -> Message:
        name = TABLE[index].name
        return common.MAVLink_param_value_message(
            name.encode(), _to_wire(index, self._get(name)), _wire_type(index), len(TABLE), index
        )


def _wire_type(index: int) -> int:
    wire_type: int = common.MAV_PARAM_TYPE_INT32 if TABLE[index].is_integer else common.MAV_PARAM_TYPE_REAL32
    return wire_type


def _to_wire(index: int, value: float) -> float:
    if not TABLE[index].is_integer:
        return value
    as_float: float = struct.unpack("<f", struct.pack("<i", round(value)))[0]
    return as_float


def _from_wire(index: int, value: float) -> float:
    if not TABLE[index].is_integer:
        return _shortest(value)
    try:
        as_int: int = struct.unpack("<i", struct.pack("<f", value))[0]
    except OverflowError:
        raise ParameterError(f"{TABLE[index].name}: not a 32-bit value") from None
    return as_int


def _shortest(value: float) -> float:
    """Read a float32 as its shortest decimal: 0.95 on the wire is 0.95 here, and a limit within its range."""
    return float(str(np.float32(value)))
