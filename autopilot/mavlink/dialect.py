"""Messages of MAVLink's common set that the installed dialect lacks, or has without their extensions.

Importing this module, as `autopilot.mavlink.codec` does, adds them to the dialect, so that they are packed
and parsed like any other. A message is declared by its fields in wire order, extensions last.
"""

import struct
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar

from pymavlink.dialects.v20 import common

_CODES = {
    "char": "c", "uint8_t": "B", "int8_t": "b", "uint16_t": "H", "int16_t": "h", "uint32_t": "I",
    "int32_t": "i", "uint64_t": "Q", "int64_t": "q", "float": "f", "double": "d",
}  # fmt: skip


class Field(NamedTuple):
    """A field of a message: its name, C type and, for an array, length."""

    name: str
    kind: str
    length: int = 0

    def code(self) -> str:
        """Return its format for `struct`."""
        if self.kind == "char":
            return f"{self.length}s"
        return f"{self.length or ''}{_CODES[self.kind]}"

    def zero(self) -> Any:  # noqa: ANN401  # a number, a text or a list
        """Return its default value."""
        if self.kind == "char":
            return ""
        return [0] * self.length if self.length else 0


class _Declared(common.MAVLink_message):  # type: ignore[misc]  # pymavlink has no types
    """Base of the classes that `declare` makes; their attributes are those of generated classes."""

    fields: ClassVar[tuple[Field, ...]]
    instance_field: ClassVar[str | None] = None
    instance_offset: ClassVar[int] = -1
    fielddisplays_by_name: ClassVar[dict[str, str]] = {}
    fieldenums_by_name: ClassVar[dict[str, str]] = {}
    fieldunits_by_name: ClassVar[dict[str, str]] = {}

    def __init__(self, *values: Any, **named: Any) -> None:  # noqa: ANN401  # numbers, bytes and lists
        """Set the fields in the order of ``fieldnames`` or by name; the default is zero."""
        common.MAVLink_message.__init__(self, self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self._instance_field, self._instance_offset = self.instance_field, self.instance_offset
        given = dict(zip(self.fieldnames, values, strict=False)) | named
        if len(values) > len(self.fieldnames) or not given.keys() <= set(self.fieldnames):
            raise TypeError(f"{self.msgname} has the fields {', '.join(self.fieldnames)}")
        for field in self.fields:
            value = given.get(field.name, field.zero())
            if field.kind == "char" and isinstance(value, bytes):
                value = value.split(b"\0", 1)[0].decode("ascii", "replace")
            setattr(self, field.name, value)

    def pack(self, mav: common.MAVLink, force_mavlink1: bool = False) -> bytes:  # noqa: FBT001, FBT002  as generated
        """Return the whole frame, with the source of ``mav``."""
        values: list[Any] = []
        for field in self.fields:
            value = getattr(self, field.name)
            if field.kind == "char":
                values.append(value.encode("ascii", "replace"))
            elif field.length:
                values += value
            else:
                values.append(value)
        payload = self.unpacker.pack(*values)
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return frame


def declare(
    name: str, message_id: int, crc_extra: int, *fields: Field, order: Sequence[str] = ()
) -> type[Any]:
    """Make a message class like pymavlink's generator, and add it to the dialect.

    ``fields`` are in wire order; ``order`` has their names in the order of the class's arguments, if it
    differs. Extensions are not part of ``crc_extra``, so a class with more of them may replace the dialect's
    own.
    """
    wire = [field.name for field in fields]
    arguments = list(order) or wire
    made = type(
        f"MAVLink_{name.lower()}_message",
        (_Declared,),
        {
            "fields": fields,
            "id": message_id,
            "msgname": name,
            "fieldnames": arguments,
            "ordered_fieldnames": wire,
            "fieldtypes": [fields[wire.index(argument)].kind for argument in arguments],
            "native_format": bytearray(b"<" + "".join(_CODES[field.kind] for field in fields).encode()),
            "orders": [wire.index(argument) for argument in arguments],
            "lengths": [1 if field.kind == "char" else field.length or 1 for field in fields],
            "array_lengths": [field.length for field in fields],
            "crc_extra": crc_extra,
            "unpacker": struct.Struct("<" + "".join(field.code() for field in fields)),
        },
    )
    common.mavlink_map[message_id] = made
    return made


ESC_STATUS = 291
_TARGET = (Field("target_system", "uint8_t"), Field("target_component", "uint8_t"))

EscStatus = declare(
    "ESC_STATUS", ESC_STATUS, 10,
    Field("time_usec", "uint64_t"), Field("rpm", "int32_t", 4), Field("voltage", "float", 4),
    Field("current", "float", 4), Field("index", "uint8_t"),
    order=("index", "time_usec", "rpm", "voltage", "current"),
)  # fmt: skip
"""Speed in rpm, voltage in V and current in A of four motors, from motor ``index`` on."""

ProtocolVersion = declare(
    "PROTOCOL_VERSION", 300, 217,
    Field("version", "uint16_t"), Field("min_version", "uint16_t"), Field("max_version", "uint16_t"),
    Field("spec_version_hash", "uint8_t", 8), Field("library_version_hash", "uint8_t", 8),
)  # fmt: skip
ComponentMetadata = declare(
    "COMPONENT_METADATA", 397, 182,
    Field("time_boot_ms", "uint32_t"), Field("file_crc", "uint32_t"), Field("uri", "char", 100),
)  # fmt: skip
AvailableModes = declare(
    "AVAILABLE_MODES", 435, 134,
    Field("custom_mode", "uint32_t"), Field("properties", "uint32_t"), Field("number_modes", "uint8_t"),
    Field("mode_index", "uint8_t"), Field("standard_mode", "uint8_t"), Field("mode_name", "char", 35),
    order=("number_modes", "mode_index", "standard_mode", "custom_mode", "properties", "mode_name"),
)  # fmt: skip
CurrentMode = declare(
    "CURRENT_MODE", 436, 193,
    Field("custom_mode", "uint32_t"), Field("intended_custom_mode", "uint32_t"),
    Field("standard_mode", "uint8_t"),
    order=("standard_mode", "custom_mode", "intended_custom_mode"),
)  # fmt: skip
AvailableModesMonitor = declare("AVAILABLE_MODES_MONITOR", 437, 30, Field("seq", "uint8_t"))

MissionCount = declare(
    "MISSION_COUNT", common.MAVLINK_MSG_ID_MISSION_COUNT, 221,
    Field("count", "uint16_t"), *_TARGET, Field("mission_type", "uint8_t"), Field("opaque_id", "uint32_t"),
    order=("target_system", "target_component", "count", "mission_type", "opaque_id"),
)  # fmt: skip
MissionAck = declare(
    "MISSION_ACK", common.MAVLINK_MSG_ID_MISSION_ACK, 153,
    *_TARGET, Field("type", "uint8_t"), Field("mission_type", "uint8_t"), Field("opaque_id", "uint32_t"),
)  # fmt: skip
MissionCurrent = declare(
    "MISSION_CURRENT", common.MAVLINK_MSG_ID_MISSION_CURRENT, 28,
    Field("seq", "uint16_t"), Field("total", "uint16_t"), Field("mission_state", "uint8_t"),
    Field("mission_mode", "uint8_t"), Field("mission_id", "uint32_t"), Field("fence_id", "uint32_t"),
    Field("rally_points_id", "uint32_t"),
)  # fmt: skip

SetAttitudeTarget = declare(
    "SET_ATTITUDE_TARGET", common.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, 49,
    Field("time_boot_ms", "uint32_t"), Field("q", "float", 4), Field("body_roll_rate", "float"),
    Field("body_pitch_rate", "float"), Field("body_yaw_rate", "float"), Field("thrust", "float"), *_TARGET,
    Field("type_mask", "uint8_t"), Field("thrust_body", "float", 3),
    order=(
        "time_boot_ms", "target_system", "target_component", "type_mask", "q", "body_roll_rate",
        "body_pitch_rate", "body_yaw_rate", "thrust", "thrust_body",
    ),
)  # fmt: skip
"""With the extension for a thrust vector."""

MESSAGE_IDS: dict[str, int] = {made.msgname: message_id for message_id, made in common.mavlink_map.items()}
"""By message name."""
T = TypeVar("T")


def by_id(**by_name: T) -> dict[int, T]:
    """Return values by message id that are given by message name. Raises KeyError for an unknown name."""
    return {MESSAGE_IDS[name]: value for name, value in by_name.items()}
