"""Frequent messages between a companion and its autopilot over a link, as plain values.

pymavlink takes 9 us to unpack a message; as a named tuple, by its own description of the payload, it takes
1.5 us. The values have the fields of pymavlink's messages, except arrays, so they replace them at all
consumers that do not need the source.
"""

from collections import namedtuple
from operator import itemgetter
from typing import Any, Final, cast

from fastcrc import crc16
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message, Parser
from autopilot.mavlink.frame import CHECKSUM_BYTES, HEADER_BYTES, HEADER_STRUCT, MAGIC, whole_frame
from autopilot.mavlink.local_messages import PositionTarget

FREQUENT = frozenset(
    {
        common.MAVLINK_MSG_ID_SYS_STATUS,
        common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        common.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        common.MAVLINK_MSG_ID_ALTITUDE,
        common.MAVLINK_MSG_ID_GPS_RAW_INT,
        common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    }
)
"""Messages of an autopilot that are returned as plain values: those of several hertz."""


class _Plain:
    """Packs and unpacks one message as a named tuple, by pymavlink's class."""

    def __init__(self, described: type[Any]) -> None:
        self.message_id: Final[int] = described.id
        self.crc_extra: Final = bytes([described.crc_extra])
        self._struct: Final = described.unpacker
        wire, lengths = described.ordered_fieldnames, described.array_lengths
        ends = [sum(map(_elements, lengths[: k + 1])) for k in range(len(wire))]
        scalar = {name: ends[k] - 1 for k, name in enumerate(wire) if not lengths[k]}
        names = [name for name in described.fieldnames if name in scalar]
        self._fields: Final = itemgetter(*(scalar[name] for name in names))
        """Puts the values of the payload into the order of the fields."""
        self._wire: Final = itemgetter(*(described.fieldnames.index(name) for name in wire))
        """Puts the fields into the order of the payload, for messages without arrays."""
        size = self._struct.size
        self._padding: Final = [bytes(size - length) for length in range(size + 1)]
        """Zeros that complete a payload, by its length."""
        self._type: Final = _named_tuple(described, names)

    def unpack(self, payload: bytes) -> Message | None:
        """Return the message of a payload without its trailing zeros; None if it is too long."""
        length = len(payload)
        if length >= len(self._padding):
            return None
        return tuple.__new__(self._type, self._fields(self._struct.unpack(payload + self._padding[length])))

    def pack(self, message: tuple[Any, ...]) -> bytes:
        """Return the payload of a message with all fields. Raises struct.error for values out of range."""
        return cast("bytes", self._struct.pack(*self._wire(message)))


def _elements(array_length: int) -> int:
    """Return the number of values of a field; 0 is the length of a field that is no array."""
    return array_length or 1


def _named_tuple(described: type[Any], names: list[str]) -> type[Any]:
    """Return a named tuple with the two methods of pymavlink's messages that consumers call."""
    message_id, name = described.id, described.msgname
    made = namedtuple(name, names)  # type: ignore[misc]  # noqa: PYI024  the fields are the dialect's
    return type(name, (made,), {
        "__slots__": (), "get_msgId": lambda _: message_id, "get_type": lambda _: name,
    })  # fmt: skip


_UNPACKED = {message_id: _Plain(common.mavlink_map[message_id]) for message_id in FREQUENT}
_TARGET = _Plain(common.MAVLink_set_position_target_local_ned_message)


class TelemetryParser(Parser):
    """`Parser` for a link to one autopilot: its `FREQUENT` messages are named tuples."""

    def __init__(self, *, system: int, component: int) -> None:
        super().__init__()
        self._source = (system, component)
        self._unknown: set[int] = set()

    def push_datagram(self, data: bytes, now: int = 0) -> list[Message]:
        """Messages in a datagram; see `Parser.push_datagram`."""
        message = self._plain(data)
        return super().push_datagram(data, now) if message is None else [message]

    def take_unknown(self) -> set[int]:
        """Return the ids of the autopilot's messages since the last call that the dialect does not contain.

        Their checksums cannot be verified.
        """
        unknown, self._unknown = self._unknown, set()
        return unknown

    def _plain(self, data: bytes) -> Message | None:
        """Return the message if the datagram is one valid, unsigned frame of a `FREQUENT` one, else None."""
        if len(data) < HEADER_BYTES:
            return None
        magic, length, incompatible, _, _, system, component, kind, kind_high = HEADER_STRUCT.unpack_from(
            data
        )
        end = HEADER_BYTES + length
        kind |= kind_high << 16
        found = _UNPACKED.get(kind)
        if found is None:
            if kind not in common.mavlink_map and magic == MAGIC and (system, component) == self._source:
                self._unknown.add(kind)
            return None
        if (
            magic != MAGIC
            or incompatible
            or len(data) != end + CHECKSUM_BYTES
            or (system, component) != self._source
            or data[end] | data[end + 1] << 8 != crc16.mcrf4xx(data[1:end] + found.crc_extra)
        ):
            return None
        return found.unpack(data[HEADER_BYTES:end])


class CompanionEncoder(Encoder):
    """`Encoder` of a companion: its setpoints are plain values, in one sequence with the other messages."""

    def encode(self, message: Message | PositionTarget) -> bytes:
        """Pack a message; see `Encoder.encode`."""
        if not isinstance(message, PositionTarget):
            return super().encode(message)
        link, (system, component) = self._mavlink, self._own
        frame = whole_frame(
            _TARGET.pack(message), message_id=_TARGET.message_id, crc_extra=_TARGET.crc_extra,
            sequence=link.seq, system=system, component=component,
        )  # fmt: skip
        link.seq = (link.seq + 1) % 256
        return frame
