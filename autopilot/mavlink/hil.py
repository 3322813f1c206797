"""The high-rate messages of the simulator link, packed and unpacked by `struct`.

HIL_SENSOR, HIL_GPS and ESC_STATUS are sent to the vehicle, HIL_ACTUATOR_CONTROLS is its answer. Both
directions are defined here, so that each can test the other. All other messages pass through the general
codec, in their order. Fields have pymavlink's names, so these classes can replace pymavlink's messages.

Wire format: MAVLink 2 (https://mavlink.io/en/guide/serialization.html): fields sorted by size, trailing zeros
of the payload cut off, CRC-16/MCRF4XX over all but the magic byte and over the message's CRC_EXTRA byte.
"""

from collections.abc import Sequence
from struct import Struct
from typing import Final, NamedTuple, Self, TypeAlias

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message, Parser
from autopilot.mavlink.dialect import ESC_STATUS
from autopilot.mavlink.frame import CHECKSUM_BYTES, HEADER_BYTES, MAGIC

_BEGINNING = Struct("<BBB4xHB")
"""Start of the header: magic, payload length, incompatibility flags, message id (24 bit)."""
_CHECKED = Struct("<BBBBBBHB")
"""Header without magic: length, incompatible and compatible flags, sequence, system, component, id."""
_MAGIC_BYTE = bytes([MAGIC])
_FIRST_CHECKED = 1
_made = tuple.__new__
"""Makes a named tuple from a tuple of its fields without a call of a Python function."""
HIL_SENSOR: Final[int] = common.MAVLINK_MSG_ID_HIL_SENSOR
HIL_GPS: Final[int] = common.MAVLINK_MSG_ID_HIL_GPS
HIL_ACTUATOR_CONTROLS: Final[int] = common.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS


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

    @classmethod
    def from_payload(cls, payload: bytes) -> Self:
        """Unpack a payload of full length."""
        return _made(cls, _SENSOR.fields.unpack(payload))

    def payload(self) -> bytes:
        """Pack with trailing zeros. Raises struct.error or OverflowError for values out of range."""
        return _SENSOR.fields.pack(*self)

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return HIL_SENSOR


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

    @classmethod
    def from_payload(cls, payload: bytes) -> Self:
        """Unpack a payload of full length."""
        time_usec, *fields, fix_type, satellites, id_, yaw = _GPS.fields.unpack(payload)
        return _made(cls, (time_usec, fix_type, *fields, satellites, id_, yaw))

    def payload(self) -> bytes:
        """Pack with trailing zeros. Raises struct.error for values out of range."""
        time_usec, fix_type, *fields, satellites, id_, yaw = self
        return _GPS.fields.pack(time_usec, *fields, fix_type, satellites, id_, yaw)

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return HIL_GPS


class EscReport(NamedTuple):
    """ESC_STATUS: rpm, V and A of four motors, from motor ``index`` on."""

    index: int  # type: ignore[assignment]  # ESC_STATUS's name, which shadows a tuple's method
    time_usec: int
    rpm: Sequence[int]
    voltage: Sequence[float]
    current: Sequence[float]

    @classmethod
    def from_payload(cls, payload: bytes) -> Self:
        """Unpack a payload of full length."""
        values = _ESCS.fields.unpack(payload)
        return _made(cls, (values[13], values[0], values[1:5], values[5:9], values[9:13]))

    def payload(self) -> bytes:
        """Pack with trailing zeros. Raises struct.error or OverflowError for values out of range."""
        return _ESCS.fields.pack(self.time_usec, *self.rpm, *self.voltage, *self.current, self.index)

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return ESC_STATUS


class HilActuatorControls(NamedTuple):
    """HIL_ACTUATOR_CONTROLS: motor commands, in answer to the HIL_SENSOR of ``time_usec``."""

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
        """Pack with trailing zeros. Raises struct.error or OverflowError for values out of range."""
        return _ACTUATORS.fields.pack(self.time_usec, self.flags, *self.controls, self.mode)

    def get_msgId(self) -> int:  # noqa: N802  as pymavlink's messages have it
        """Return the message id."""
        return HIL_ACTUATOR_CONTROLS


HilMessage: TypeAlias = HilSensor | HilGps | EscReport | HilActuatorControls
TO_VEHICLE: tuple[type[HilMessage], ...] = (HilSensor, HilGps, EscReport)


class _Format:
    """Wire format of one message."""

    def __init__(self, kind: int, fields: str) -> None:
        self.kind: Final = kind
        self.fields: Final = Struct(fields)
        self.crc_extra: Final = bytes([common.mavlink_map[kind].crc_extra])
        self.padding: Final = [bytes(self.fields.size - length) for length in range(self.fields.size + 1)]
        """Zeros that complete a payload, by its length."""


_SENSOR = _Format(HIL_SENSOR, "<Q13fIB")
_GPS = _Format(HIL_GPS, "<Q3i3H3hH2BBH")
_ESCS = _Format(ESC_STATUS, "<Q4i4f4fB")
_ACTUATORS = _Format(HIL_ACTUATOR_CONTROLS, "<QQ16fB")
_FORMATS: dict[type[HilMessage], _Format] = {
    HilSensor: _SENSOR, HilGps: _GPS, EscReport: _ESCS, HilActuatorControls: _ACTUATORS,
}  # fmt: skip


def pack(message: HilMessage, *, sequence: int, system: int, component: int) -> bytes:
    """Return the whole frame of a message."""
    form = _FORMATS[type(message)]
    payload = message.payload()
    if not payload[-1]:
        payload = payload.rstrip(b"\0") or b"\0"
    checked = _CHECKED.pack(len(payload), 0, 0, sequence, system, component, form.kind, 0) + payload
    checksum: int = crc16.mcrf4xx(checked + form.crc_extra)
    return _MAGIC_BYTE + checked + checksum.to_bytes(2, "little")


class HilEncoder(Encoder):
    """`Encoder` for a simulator link: high-rate messages by struct, others by pymavlink, in one sequence."""

    def __init__(self, *, system: int, component: int, sequence: NDArray[np.int64] | None = None) -> None:
        """``sequence`` (1,) is the memory of the number of the next frame, if other code uses it too."""
        super().__init__(system=system, component=component)
        self._sequence = (np.zeros(1, np.int64) if sequence is None else sequence).data

    def encode(self, message: Message | HilMessage) -> bytes:
        """Pack a message; see `Encoder.encode`."""
        sequence: int = self._sequence[0]
        if type(message) in _FORMATS:
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
        self._hot = {_FORMATS[kind].kind: (kind, _FORMATS[kind]) for kind in hot}
        self.unfinished = self._buffer
        """Bytes of an incomplete frame."""

    def push(self, data: bytes) -> list[Message | HilMessage]:
        """Messages that are complete after the next ``data`` of a byte stream."""
        messages: list[Message | HilMessage] = []
        at, size = 0, len(data)
        if not self.unfinished:
            # as long as complete, valid and unsigned frames of ``hot`` messages follow each other
            while size - at > HEADER_BYTES:
                magic, length, incompatible, kind, kind_high = _BEGINNING.unpack_from(data, at)
                if magic != MAGIC or incompatible or kind_high or kind not in self._hot:
                    break
                hot, form = self._hot[kind]
                begin = at + HEADER_BYTES
                end = begin + length
                if length >= len(form.padding) or size < end + CHECKSUM_BYTES:
                    break
                checksum = crc16.mcrf4xx(data[at + _FIRST_CHECKED : end] + form.crc_extra)
                if data[end] | data[end + 1] << 8 != checksum:
                    break
                messages.append(hot.from_payload(data[begin:end] + form.padding[length]))
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
