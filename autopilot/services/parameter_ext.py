"""MAVLink's extended parameter protocol: the same parameters, with values as bytes in text fields.

Stations use it for cameras; requests to the autopilot are answered, too.
"""

import struct
from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.parameters.table import ROW_INDEX_OF, ROWS, ParameterError, ParameterProblem, ParameterSet
from autopilot.services.parameter import ListingService, shortest, value_bytes
from autopilot.services.service import Addressed, Partner, reply
from autopilot.services.shaper import Room, always

_VALUE_BYTES = 128
_KINDS = {True: common.MAV_PARAM_EXT_TYPE_INT32, False: common.MAV_PARAM_EXT_TYPE_REAL32}
"""MAV_PARAM_EXT_TYPE by whether a parameter is an integer"""


class ParameterExtService(ListingService):
    """The parameters in PARAM_EXT messages; changes are reported to the links by `ParameterService`."""

    def __init__(self, parameters: ParameterSet, has_room: Room = always) -> None:
        super().__init__(
            parameters, has_room, PARAM_EXT_REQUEST_LIST=self._list,
            PARAM_EXT_REQUEST_READ=self._read, PARAM_EXT_SET=self._set,
        )  # fmt: skip

    def _list(self, _message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        self._begin_list(partner, now_us, first=0)
        return ()

    def _value(self, index: int) -> Message:
        row = ROWS[index]
        return common.MAVLink_param_ext_value_message(
            row.name.encode(), self._bytes_of(index), _KINDS[row.is_integer], len(ROWS), index
        )

    def _bytes_of(self, index: int) -> bytes:
        row = ROWS[index]
        return value_bytes(row.is_integer, self._parameters.get(row.name)).ljust(_VALUE_BYTES, b"\0")

    def _set(self, message: Message, _now_us: int, partner: Partner) -> Sequence[Addressed]:
        """PARAM_EXT_ACK with the value after the request; zeros for an unknown parameter."""
        index = ROW_INDEX_OF.get(message.param_id)
        name = message.param_id.encode("ascii", "replace")[:16]
        if index is None:
            value, kind, result = bytes(_VALUE_BYTES), message.param_type, common.PARAM_ACK_FAILED
        else:
            kind, result = _KINDS[ROWS[index].is_integer], common.PARAM_ACK_ACCEPTED
            try:
                if message.param_type != kind:
                    raise ParameterError(f"{message.param_id}: wrong type", ParameterProblem.TYPE)  # noqa: TRY301  # one handler answers refusals
                self._parameters.set(message.param_id, _number(message, is_integer=ROWS[index].is_integer))
            except ParameterError:
                result = common.PARAM_ACK_VALUE_UNSUPPORTED
            value = self._bytes_of(index)
        return reply(partner, common.MAVLink_param_ext_ack_message(name, value, kind, result))


def _number(message: Message, *, is_integer: bool) -> float:
    """Value of a PARAM_EXT_SET: its first four bytes, which pymavlink keeps beside the decoded text."""
    data = message._param_value_raw[:4].ljust(4, b"\0")
    number: float = struct.unpack("<i" if is_integer else "<f", data)[0]
    return number if is_integer else shortest(number)
