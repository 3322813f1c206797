"""MAVLink's extended parameter protocol: the same parameters, with values as bytes in text fields.

Stations use it for cameras; requests to the autopilot are answered, too.
"""

import struct
from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.parameters.table import ROW_INDEX_OF, ROWS, ParameterError, ParameterProblem, ParameterSet
from autopilot.services.parameter import Setter, refusal, shortest, value_bytes
from autopilot.services.parameter_lists import ParameterLists
from autopilot.services.service import Addressed, Partner, reply
from autopilot.services.shaper import Room, always

_VALUE_BYTES = 128
_KINDS = {True: common.MAV_PARAM_EXT_TYPE_INT32, False: common.MAV_PARAM_EXT_TYPE_REAL32}
"""MAV_PARAM_EXT_TYPE by whether a parameter is an integer"""


class ParameterExtService:
    """The parameters in PARAM_EXT messages; changes are reported to the links by `ParameterService`."""

    takes = frozenset(
        {
            common.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_LIST,
            common.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_READ,
            common.MAVLINK_MSG_ID_PARAM_EXT_SET,
        }
    )

    def __init__(self, parameters: ParameterSet, put: Setter, has_room: Room = always) -> None:
        """``put`` changes a parameter and reports the change."""
        self._lists = ParameterLists(has_room)
        self._parameters = parameters
        self._put = put

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Answer a request; a list is sent by `on_timer`."""
        kind = message.get_msgId()
        if kind == common.MAVLINK_MSG_ID_PARAM_EXT_SET:
            return reply(partner, self._set(message))
        if kind == common.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_READ:
            index = message.param_index
            if index < 0:
                index = ROW_INDEX_OF.get(message.param_id, len(ROWS))
            if index < len(ROWS):
                return reply(partner, self._value(index))
            return reply(partner, refusal(message, ParameterProblem.UNKNOWN, index=message.param_index))
        self._lists.begin(partner, now_us)
        return ()

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Send the next batch of each list."""
        messages: list[Addressed] = []
        for partner, rows in self._lists.next_batch(now_us):
            messages += reply(partner, *map(self._value, rows))
        return messages

    def next_deadline_us(self) -> int:
        """Time of the next batch."""
        return self._lists.due_us

    def _value(self, index: int) -> Message:
        row = ROWS[index]
        return common.MAVLink_param_ext_value_message(
            row.name.encode(), self._bytes_of(index), _KINDS[row.is_integer], len(ROWS), index
        )

    def _bytes_of(self, index: int) -> bytes:
        row = ROWS[index]
        return value_bytes(row.is_integer, self._parameters.get(row.name)).ljust(_VALUE_BYTES, b"\0")

    def _set(self, message: Message) -> Message:
        """PARAM_EXT_ACK with the value after the request; zeros for an unknown parameter."""
        index = ROW_INDEX_OF.get(message.param_id)
        name = message.param_id.encode("ascii", "replace")[:16]
        if index is None:
            value, kind = b"".ljust(_VALUE_BYTES, b"\0"), message.param_type
            return common.MAVLink_param_ext_ack_message(name, value, kind, common.PARAM_ACK_FAILED)
        result = common.PARAM_ACK_ACCEPTED
        kind = _KINDS[ROWS[index].is_integer]
        try:
            if message.param_type != kind:
                raise ParameterError(f"{message.param_id}: wrong type", ParameterProblem.TYPE)  # noqa: TRY301  # one handler answers refusals
            self._put(message.param_id, _number(message, is_integer=ROWS[index].is_integer))
        except ParameterError:
            result = common.PARAM_ACK_VALUE_UNSUPPORTED
        return common.MAVLink_param_ext_ack_message(name, self._bytes_of(index), kind, result)


def _number(message: Message, *, is_integer: bool) -> float:
    """Value of a PARAM_EXT_SET: its first four bytes, which pymavlink keeps beside the decoded text."""
    data = message._param_value_raw[:4].ljust(4, b"\0")
    number: float = struct.unpack("<i" if is_integer else "<f", data)[0]
    return number if is_integer else shortest(number)
