"""MAVLink's parameter service: list, read by name or index, set. Integers are sent as raw bytes, as in PX4.

An accepted PARAM_SET is reported to all partners on all links. A refused read or set is answered by
PARAM_ERROR, a set also by a STATUSTEXT with the reason. A list begins with _HASH_CHECK, PX4's checksum over
names and values: a station whose cached values match sends it back, which ends the list.
"""

import abc
import struct
from collections.abc import Sequence

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.crc import crc32
from autopilot.parameters.table import ROW_INDEX_OF, ROWS, ParameterError, ParameterProblem, ParameterSet
from autopilot.services.service import ALL, NEVER_US, Addressed, Handler, Newest, Partner, Service, reply
from autopilot.services.shaper import Room, always
from autopilot.services.status import status_text

LIST_PERIOD_US = 20_000
LIST_BATCH = 16
"""Values per batch: a list takes a third of a second instead of one burst."""
MOST_LISTS = 16
"""Concurrent lists; a new one replaces the oldest."""
MOST_TYPELESS = 16
"""Partners that may send integers as floats; a new one replaces the oldest."""
TEXT_PERIOD_US = 1_000_000
"""Least time between two STATUSTEXTs: some stations repeat a refused set at once."""
HASH_NAME = "_HASH_CHECK"
_HASH_INDEX = 65_535
_HASH = -1
"""Index of the checksum in a list."""
_NAME_BYTES = 16


class _HashValue(common.MAVLink_param_value_message):  # type: ignore[misc]  # pymavlink has no types
    """PARAM_VALUE whose value is a uint32, since some of its bit patterns do not survive as a float."""

    unpacker = struct.Struct("<IHH16sB")


class ListingService(Service, abc.ABC):
    """Base of the parameter protocols: reads one value, and sends lists in batches to several partners."""

    def __init__(self, parameters: ParameterSet, has_room: Room, **handlers: Handler) -> None:
        super().__init__(**handlers)
        self._parameters = parameters
        self._has_room = has_room
        self._next_index: dict[Partner, int] = {}
        """Index that is sent next, by partner."""

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Send the next batch of each list to partners whose links have room."""
        messages: list[Addressed] = []
        if now_us < self.due_us:
            return messages
        for partner, begin in list(self._next_index.items()):
            if self._has_room(partner):
                until = min(begin + LIST_BATCH, len(ROWS))
                messages += reply(partner, *map(self._value, range(begin, until)))
                if until == len(ROWS):
                    del self._next_index[partner]
                else:
                    self._next_index[partner] = until
        self.due_us = now_us + LIST_PERIOD_US if self._next_index else NEVER_US
        return messages

    def _begin_list(self, partner: Partner, now_us: int, *, first: int) -> None:
        """Begin a partner's list at index ``first``; one in progress restarts at index 0."""
        restarts = self._next_index.pop(partner, None) is not None
        if len(self._next_index) >= MOST_LISTS:
            del self._next_index[next(iter(self._next_index))]
        self._next_index[partner] = 0 if restarts else first
        self.due_us = min(self.due_us, now_us)

    def _read(self, message: Message, _now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Answer a request by index, or by name if the index is negative."""
        index = message.param_index
        if index < 0:
            index = ROW_INDEX_OF.get(message.param_id, len(ROWS))
        if index < len(ROWS):
            return reply(partner, self._value(index))
        return reply(partner, _refusal(message, ParameterProblem.UNKNOWN, index=message.param_index))

    @abc.abstractmethod
    def _value(self, index: int) -> Message:
        """Return the message with the value at an index."""


class ParameterService(ListingService):
    """The parameters for the partners of all links; each partner may have a list in progress."""

    def __init__(self, parameters: ParameterSet, has_room: Room = always) -> None:
        super().__init__(
            parameters, has_room,
            PARAM_REQUEST_LIST=self._list, PARAM_REQUEST_READ=self._read, PARAM_SET=self._set,
        )  # fmt: skip
        self._changed: dict[str, None] = {}
        self._news_due_us = 0
        self._text_us = -TEXT_PERIOD_US
        self._hash: tuple[int, int] | None = None
        self._typeless: Newest[Partner, None] = Newest(MOST_TYPELESS)
        parameters.report_to(self._on_change)

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Report changes that were not made by PARAM_SET, and send the next batch of each list."""
        messages: list[Addressed] = []
        if self._changed and now_us >= self._news_due_us:
            for name in list(self._changed)[:LIST_BATCH]:
                del self._changed[name]
                messages += reply(ALL, self._value(ROW_INDEX_OF[name]))
            self._news_due_us = now_us + LIST_PERIOD_US if self._changed else 0
        return [*messages, *super().on_timer(now_us)]

    def next_deadline_us(self) -> int:
        """Time of the next batch of a list or of change reports."""
        return min(self._news_due_us, self.due_us) if self._changed else self.due_us

    def _on_change(self, name: str) -> None:
        """Report a changed parameter to all partners; `_set` does so itself."""
        self._changed[name] = None

    def take_by_value(self, partner: Partner) -> None:
        """Accept integers as floats from a reader of param.pck: MAVProxy then sends all values as floats."""
        self._typeless[partner] = None

    def _list(self, _message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Begin a list, which is sent by `on_timer`; a repeated request restarts it."""
        self._begin_list(partner, now_us, first=_HASH)
        self._typeless.pop(partner, None)
        return ()

    def _read(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        if message.param_index < 0 and message.param_id == HASH_NAME:
            return reply(partner, self._value(_HASH))
        return super()._read(message, now_us, partner)

    def _set(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        name = message.param_id
        if name == HASH_NAME:
            self._next_index.pop(partner, None)
            return ()
        try:
            index = ROW_INDEX_OF.get(name)
            if index is None:
                raise ParameterError(f"there is no parameter {name!r}", ParameterProblem.UNKNOWN)  # noqa: TRY301  # one handler answers refusals
            self._parameters.set(name, self._from_wire(index, message, partner))
        except ParameterError as error:
            answers = reply(partner, _refusal(message, error.problem))
            if now_us - self._text_us >= TEXT_PERIOD_US:
                self._text_us = now_us
                answers += reply(ALL, status_text(common.MAV_SEVERITY_WARNING, str(error)))
            return answers
        self._changed.pop(name, None)
        return reply(ALL, self._value(index))

    def _value(self, index: int) -> Message:
        if index == _HASH:
            checksum, kind = self._hash_value(), common.MAV_PARAM_TYPE_UINT32
            return _HashValue(HASH_NAME.encode(), checksum, kind, len(ROWS), _HASH_INDEX)
        name = ROWS[index].name
        value: float = self._parameters.get(name)
        if ROWS[index].is_integer:
            value = struct.unpack("<f", struct.pack("<i", round(value)))[0]
        return common.MAVLink_param_value_message(name.encode(), value, _wire_type(index), len(ROWS), index)

    def _hash_value(self) -> int:
        """CRC over each parameter's name and the four bytes of its value, in the order of the indices."""
        version = self._parameters.version
        if self._hash is None or self._hash[0] != version:
            checksum = 0
            for row in ROWS:
                checksum = crc32(row.name.encode(), checksum)
                checksum = crc32(value_bytes(row.is_integer, self._parameters.get(row.name)), checksum)
            self._hash = version, checksum
        return self._hash[1]

    def _from_wire(self, index: int, message: Message, partner: Partner) -> float:
        value: float = message.param_value
        name = ROWS[index].name
        if message.param_type == _wire_type(index):
            if not ROWS[index].is_integer:
                return shortest(value)
            try:
                as_int: int = struct.unpack("<i", struct.pack("<f", value))[0]
            except OverflowError:
                raise ParameterError(f"{name}: not a 32-bit value", ParameterProblem.TYPE) from None
            return as_int
        if message.param_type == common.MAV_PARAM_TYPE_REAL32 and partner in self._typeless:
            return value
        raise ParameterError(f"{name}: wrong type", ParameterProblem.TYPE)


def _refusal(message: Message, problem: ParameterProblem, *, index: int = -1) -> Message:
    """PARAM_ERROR in answer to a message that names a parameter by ``param_id``."""
    name = message.param_id.encode("ascii", "replace")[:_NAME_BYTES]
    return common.MAVLink_param_error_message(
        message.get_srcSystem(), message.get_srcComponent(), name, index, int(problem)
    )


def value_bytes(is_integer: bool, value: float) -> bytes:  # noqa: FBT001  # which of two formats
    """Four bytes of a value, as PX4 stores it."""
    return struct.pack("<i", round(value)) if is_integer else struct.pack("<f", value)


def shortest(value: float) -> float:
    """Shortest decimal of a float32: 0.95 as float32 becomes 0.95 as double, and stays within its range."""
    return float(str(np.float32(value)))


def _wire_type(index: int) -> int:
    wire_type: int = common.MAV_PARAM_TYPE_INT32 if ROWS[index].is_integer else common.MAV_PARAM_TYPE_REAL32
    return wire_type
