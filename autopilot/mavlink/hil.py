"""The high-rate messages of the simulator link as named tuples, packed and unpacked by `struct`.

`hil_schema` has their layouts. HIL_SENSOR, HIL_GPS and ESC_STATUS are sent to the vehicle,
HIL_ACTUATOR_CONTROLS is its answer. Both directions are defined here, so that each can test the other. All
other messages pass through the general codec, in their order. Fields have pymavlink's names and order, so
these classes can replace pymavlink's messages.

Wire format: MAVLink 2 (https://mavlink.io/en/guide/serialization.html): fields sorted by size, trailing zeros
of the payload cut off, CRC-16/MCRF4XX over all but the magic byte and over the message's CRC_EXTRA byte.
"""

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

from autopilot.mavlink.codec import Encoder, Message, Parser
from autopilot.mavlink.frame import CHECKSUM_BYTES, HEADER_BYTES, HEADER_STRUCT, MAGIC, whole_frame
from autopilot.mavlink.hil_schema import ESC_STATUS, HIL_ACTUATOR_CONTROLS, HIL_GPS, HIL_SENSOR, MessageSchema

Values = tuple[Any, ...]
_FIRST_CHECKED = 1
"""Offset of the first byte in the checksum: all but the magic byte."""
_made = tuple.__new__
"""Makes a named tuple from a tuple of its fields without a call of a Python function."""


class HilSensor(NamedTuple):
    """HIL_SENSOR: body FRD, m/s^2, rad/s, gauss, hPa, m, degC; ``fields_updated`` marks the new values."""

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
    """Number of the sensor set; set 0 drives the vehicle's clock."""

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return HIL_SENSOR.message_id


class HilGps(NamedTuple):
    """HIL_GPS: degrees * 1e7, mm above sea level, cm, cm/s NED, centidegrees."""

    time_usec: int
    fix_type: int
    lat: int
    lon: int
    alt: int
    eph: int
    epv: int
    vel: int
    vn: int
    ve: int
    vd: int
    cog: int
    satellites_visible: int
    id: int = 0
    yaw: int = 0

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return HIL_GPS.message_id


class EscReport(NamedTuple):
    """ESC_STATUS: rpm, V and A of four motors, from motor ``index`` on."""

    index: int  # type: ignore[assignment]  # ESC_STATUS's name, which shadows a tuple's method
    time_usec: int
    rpm: Sequence[int]
    voltage: Sequence[float]
    current: Sequence[float]

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return ESC_STATUS.message_id


class HilActuatorControls(NamedTuple):
    """HIL_ACTUATOR_CONTROLS: motor commands, in answer to the HIL_SENSOR of ``time_usec``."""

    time_usec: int
    controls: Sequence[float]
    """(16,) in -1..1; a multicopter's motors are 0..1."""
    mode: int
    """MAV_MODE_FLAG"""
    flags: int

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return HIL_ACTUATOR_CONTROLS.message_id


HilMessage: TypeAlias = HilSensor | HilGps | EscReport | HilActuatorControls
TO_VEHICLE: tuple[type[HilMessage], ...] = (HilSensor, HilGps, EscReport)


class _Codec:
    """Packs and unpacks one type of message by its schema, in which the fields have another order."""

    def __init__(self, kind: type[HilMessage], schema: MessageSchema) -> None:
        self.message_id: Final = schema.message_id
        self.crc_extra: Final = bytes([schema.crc_extra])
        self.padding: Final = [bytes(schema.payload_bytes - n) for n in range(schema.payload_bytes + 1)]
        """Zeros that complete a payload, by its length."""
        self._struct: Final = schema.struct
        self._kind: Final = kind
        names, at, elements = schema.dtype.names or (), 0, dict[str, int | slice]()
        for name in names:
            count = int(np.prod(schema.dtype[name].shape))
            elements[name] = slice(at, at + count) if schema.dtype[name].shape else at
            at += count
        picked = itemgetter(*(elements[name] for name in kind._fields))
        self._fields: Final[Callable[[Values], Values]] = tuple if kind._fields == names else picked
        """Reorders the values of the schema."""
        self._wire: Final = [(kind._fields.index(name), isinstance(elements[name], slice)) for name in names]
        """Index of each field of the schema in the type, and whether it is an array."""

    def unpack(self, payload: bytes) -> HilMessage:
        """Return the message of a payload without its trailing zeros; not longer than the schema."""
        values = self._struct.unpack(payload + self.padding[len(payload)])
        message: HilMessage = _made(self._kind, self._fields(values))
        return message

    def pack(self, message: HilMessage) -> bytes:
        """Return the whole payload. Raises struct.error or OverflowError for values out of range."""
        fields: Values = message
        values: list[Any] = []
        for index, is_array in self._wire:
            if is_array:
                values += fields[index]
            else:
                values.append(fields[index])
        return self._struct.pack(*values)


_CODECS: dict[type[HilMessage], _Codec] = {
    kind: _Codec(kind, schema)
    for kind, schema in (
        (HilSensor, HIL_SENSOR),
        (HilGps, HIL_GPS),
        (EscReport, ESC_STATUS),
        (HilActuatorControls, HIL_ACTUATOR_CONTROLS),
    )
}


def pack(message: HilMessage, *, sequence: int, system: int, component: int) -> bytes:
    """Return the whole frame. Raises struct.error or OverflowError for values out of range."""
    codec = _CODECS[type(message)]
    return whole_frame(
        codec.pack(message), message_id=codec.message_id, crc_extra=codec.crc_extra,
        sequence=sequence, system=system, component=component,
    )  # fmt: skip


def unpack(kind: type[HilMessage], payload: bytes) -> HilMessage:
    """Return the message of a payload without its trailing zeros."""
    return _CODECS[kind].unpack(payload)


class HilEncoder(Encoder):
    """`Encoder` for a simulator link: high-rate messages by struct, others by pymavlink, in one sequence."""

    def __init__(self, *, system: int, component: int, sequence: NDArray[np.int64] | None = None) -> None:
        """``sequence`` (1,) is the memory of the number of the next frame, if other code uses it too."""
        super().__init__(system=system, component=component)
        self._sequence = (np.zeros(1, np.int64) if sequence is None else sequence).data

    def encode(self, message: Message | HilMessage) -> bytes:
        """Pack a message; see `Encoder.encode`."""
        sequence: int = self._sequence[0]
        if type(message) in _CODECS:
            system, component = self._own
            frame = pack(message, sequence=sequence, system=system, component=component)
        else:
            self._mavlink.seq = sequence
            frame = super().encode(message)
        self._sequence[0] = (sequence + 1) % 256
        return frame


class HilParser(Parser):
    """`Parser` for a simulator link: returns these types for ``hot`` messages, pymavlink's for the others."""

    def __init__(self, *hot: type[HilMessage]) -> None:
        super().__init__()
        self._hot = {_CODECS[kind].message_id: (kind, _CODECS[kind]) for kind in hot}
        self.unfinished = self._buffer
        """Bytes of an incomplete frame."""

    def push(self, data: bytes) -> list[Message | HilMessage]:
        """Messages that are complete after the next ``data`` of a byte stream."""
        messages: list[Message | HilMessage] = []
        at, size = 0, len(data)
        if not self.unfinished:
            # as long as complete, valid and unsigned frames of ``hot`` messages follow each other
            while size - at > HEADER_BYTES:
                magic, length, incompatible, _, _, _, _, kind, kind_high = HEADER_STRUCT.unpack_from(data, at)
                if magic != MAGIC or incompatible or kind_high or kind not in self._hot:
                    break
                _, codec = self._hot[kind]
                begin = at + HEADER_BYTES
                end = begin + length
                if length >= len(codec.padding) or size < end + CHECKSUM_BYTES:
                    break
                checksum = crc16.mcrf4xx(data[at + _FIRST_CHECKED : end] + codec.crc_extra)
                if data[end] | data[end + 1] << 8 != checksum:
                    break
                messages.append(codec.unpack(data[begin:end]))
                at = end + CHECKSUM_BYTES
            if at == size:
                return messages
        messages += map(self._as_hot, super().push(data[at:]))
        return messages

    def _as_hot(self, message: Message) -> Message | HilMessage:
        """Convert a ``hot`` message that the general parser accepted, such as one of MAVLink 1."""
        found = self._hot.get(message.get_msgId())
        if found is None:
            return message
        hot, _ = found
        return hot(*(getattr(message, field) for field in hot._fields))
