"""The messages that cross a simulator's link in every step, packed and unpacked by `struct`.

HIL_SENSOR goes to the vehicle, HIL_ACTUATOR_CONTROLS comes back; both ends live here because either is the
other's test. Everything else on the link goes through the general codec, in its place between them. Fields
have pymavlink's names, so the values stand wherever a pymavlink message of that kind would.

Wire format: MAVLink 2 (https://mavlink.io/en/guide/serialization.html): fields sorted by size, trailing zeros
of the payload cut off, CRC-16/MCRF4XX over all but the magic byte and over one byte more that is peculiar to
the message.
"""

from collections.abc import Sequence
from struct import Struct
from typing import Final, NamedTuple, Self, TypeAlias

from fastcrc import crc16
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message, Parser

_HEADER = Struct("<BBBBBBBHB")
"""Magic, payload's length, incompatible and compatible flags, sequence, system, component, kind (24 bit)."""
_CHECKSUM = Struct("<H")
_MAGIC = 0xFD
_FIRST_CHECKED = 1


class HilSensor(NamedTuple):
    """HIL_SENSOR: body FRD, m/s^2, rad/s, gauss, hPa, m, degC; what is new is told by ``fields_updated``."""

    time_usec: int
    xacc: float
    yacc: float
    zacc: float
    xgyro: float
    ygyro: float
    zgyro: float
    xmag: float
    ymag: float
    zmag: float
    abs_pressure: float
    diff_pressure: float
    pressure_alt: float
    temperature: float
    fields_updated: int
    id: int = 0
    """Number of the sensor set; 0 is the vehicle's clock."""

    @classmethod
    def from_payload(cls, payload: bytes) -> Self:
        """Unpack a payload of full length."""
        return cls._make(_SENSOR.fields.unpack(payload))

    def payload(self) -> bytes:
        """Pack it, trailing zeros included. Raises struct.error or OverflowError for what does not fit."""
        return _SENSOR.fields.pack(*self)

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Give the kind of message."""
        return _SENSOR.kind


class HilActuatorControls(NamedTuple):
    """HIL_ACTUATOR_CONTROLS: what the motors are told, in answer to the HIL_SENSOR of ``time_usec``."""

    time_usec: int
    controls: Sequence[float]
    """(16,) in -1..1; a multicopter's motors are 0..1."""
    mode: int
    """MAV_MODE_FLAG"""
    flags: int

    @classmethod
    def from_payload(cls, payload: bytes) -> Self:
        """Unpack a payload of full length."""
        time_usec, flags, *controls, mode = _ACTUATORS.fields.unpack(payload)
        return cls(time_usec, controls, mode, flags)

    def payload(self) -> bytes:
        """Pack it, trailing zeros included. Raises struct.error or OverflowError for what does not fit."""
        return _ACTUATORS.fields.pack(self.time_usec, self.flags, *self.controls, self.mode)

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Give the kind of message."""
        return _ACTUATORS.kind


HilMessage: TypeAlias = HilSensor | HilActuatorControls


class _Format:
    """How one kind of message lies on the wire."""

    def __init__(self, kind: int, fields: str) -> None:
        self.kind: Final = kind
        self.fields: Final = Struct(fields)
        self.crc_extra: Final = bytes([common.mavlink_map[kind].crc_extra])
        self.padding: Final = [bytes(self.fields.size - length) for length in range(self.fields.size + 1)]
        """What was cut off a payload, by the length that is left."""


_SENSOR = _Format(common.MAVLINK_MSG_ID_HIL_SENSOR, "<Q13fIB")
_ACTUATORS = _Format(common.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS, "<QQ16fB")
_FORMATS: dict[type[HilMessage], _Format] = {HilSensor: _SENSOR, HilActuatorControls: _ACTUATORS}


def pack(message: HilMessage, *, sequence: int, system: int, component: int) -> bytes:
    """Whole frame of a message."""
    form = _FORMATS[type(message)]
    payload = message.payload().rstrip(b"\0") or b"\0"
    header = _HEADER.pack(_MAGIC, len(payload), 0, 0, sequence, system, component, form.kind, 0)
    frame = header + payload
    return frame + _CHECKSUM.pack(crc16.mcrf4xx(frame[_FIRST_CHECKED:] + form.crc_extra))


_ANSWER = Struct("<BBBBBBBHBQQ16fBH")
"""A frame of HIL_ACTUATOR_CONTROLS of which nothing is cut off, for its last byte, the mode, is not zero."""


def whole_answer(data: bytes) -> HilActuatorControls | None:
    """Give the answer that ``data`` is, if it is one right, unsigned frame of full length and nothing else.

    That is what nearly every answer is. None: a `HilParser` knows what to make of it.
    """
    if len(data) != _ANSWER.size:
        return None
    (
        magic, length, incompatible, _, _, _, _, kind, kind_high, time_usec, flags, *controls, mode, checksum
    ) = _ANSWER.unpack(data)  # fmt: skip
    form = _ACTUATORS
    if magic != _MAGIC or length != form.fields.size or incompatible or kind != form.kind or kind_high:
        return None
    if crc16.mcrf4xx(data[_FIRST_CHECKED : -_CHECKSUM.size] + form.crc_extra) != checksum:
        return None
    return HilActuatorControls(time_usec, controls, mode, flags)


class HilEncoder(Encoder):
    """`Encoder` for a simulator's link: hot messages by struct, the rest as ever, in one sequence."""

    def encode(self, message: Message | HilMessage) -> bytes:
        """Pack a message; see `Encoder.encode`."""
        if not isinstance(message, HilMessage):
            return super().encode(message)
        link = self._mavlink
        system, component = self._own
        frame = pack(message, sequence=link.seq, system=system, component=component)
        link.seq = (link.seq + 1) % 256
        return frame


class HilParser(Parser):
    """`Parser` for a simulator's link: frames of one hot kind come out as ``hot``, whatever else as ever."""

    def __init__(self, hot: type[HilMessage]) -> None:
        super().__init__()
        self._hot = hot
        self._form = _FORMATS[hot]

    @property
    def is_between_frames(self) -> bool:
        """Whether nothing of an unfinished frame is kept."""
        return not self._buffer

    def push(self, data: bytes) -> list[Message | HilMessage]:
        """Messages that are complete after the next ``data`` of a byte stream."""
        messages: list[Message | HilMessage] = []
        at = 0
        if not self._buffer:
            while (end := self._whole_hot_frame(data, at)) is not None:
                payload = data[at + _HEADER.size : end - _CHECKSUM.size]
                messages.append(self._hot.from_payload(payload + self._form.padding[len(payload)]))
                at = end
            if at == len(data):
                return messages
        messages += map(self._as_hot, super().push(data[at:]))
        return messages

    def _whole_hot_frame(self, data: bytes, at: int) -> int | None:
        """Where the frame that begins at ``at`` ends, if it is whole, right, unsigned and of the hot kind."""
        if len(data) - at <= _HEADER.size:
            return None
        magic, length, incompatible, _, _, _, _, kind, kind_high = _HEADER.unpack_from(data, at)
        form = self._form
        if magic != _MAGIC or incompatible or kind != form.kind or kind_high or length > form.fields.size:
            return None
        end: int = at + _HEADER.size + length
        if len(data) < end + _CHECKSUM.size:
            return None
        checksum = crc16.mcrf4xx(data[at + _FIRST_CHECKED : end] + form.crc_extra)
        return end + _CHECKSUM.size if _CHECKSUM.unpack_from(data, end) == (checksum,) else None

    def _as_hot(self, message: Message) -> Message | HilMessage:
        """Turn what the general parser took for good, say of MAVLink 1, into the same kind of value."""
        if message.get_msgId() != self._form.kind:
            return message
        return self._hot(*(getattr(message, field) for field in self._hot._fields))
