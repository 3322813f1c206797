"""Schema of the messages between simulator and vehicle: one packed NumPy dtype a message.

Vehicle, simulator and compiled code derive struct formats, offsets, lengths and checksums from it. Fields
have MAVLink's names and are in the order of the wire, as tests verify with pymavlink's dialect:
https://mavlink.io/en/guide/serialization.html#field_reordering.
A view of a payload in compiled code (``octets[PAYLOAD : PAYLOAD + schema.payload_bytes].view(dtype)[0]``)
reaches beyond the payload if its trailing zeros were truncated.
"""

from struct import Struct
from typing import Any, Final

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink import dialect
from autopilot.mavlink.frame import CHECKSUM_BYTES, HEADER_BYTES, struct_format

_SENSOR_FLOATS = (
    "xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag", "abs_pressure",
    "diff_pressure", "pressure_alt", "temperature",
)  # fmt: skip
_RC_CHANNELS = 18


class MessageSchema:
    """One message: its id, CRC_EXTRA, and the layout of its payload."""

    def __init__(self, message_id: int, fields: list[tuple[Any, ...]]) -> None:
        self.message_id: Final = message_id
        self.crc_extra: Final = int(common.mavlink_map[message_id].crc_extra)
        self.dtype: Final = np.dtype(fields)
        """Packed payload, with its trailing zeros"""
        self.payload_bytes: Final = self.dtype.itemsize
        self.frame_bytes: Final = HEADER_BYTES + self.payload_bytes + CHECKSUM_BYTES
        """Greatest length of a frame; trailing zeros of a payload are truncated"""
        self.struct: Final = Struct(struct_format(self.dtype))

    def offset(self, field: str) -> int:
        """Return the offset of a field in the payload."""
        fields = self.dtype.fields
        if fields is None:
            raise TypeError("a message has fields")
        return fields[field][1]


HIL_SENSOR = MessageSchema(
    common.MAVLINK_MSG_ID_HIL_SENSOR,
    [
        ("time_usec", "<u8"),
        *((name, "<f4") for name in _SENSOR_FLOATS),
        ("fields_updated", "<u4"),
        ("id", "u1"),
    ],
)
HIL_GPS = MessageSchema(
    common.MAVLINK_MSG_ID_HIL_GPS,
    [
        ("time_usec", "<u8"),
        ("lat", "<i4"), ("lon", "<i4"), ("alt", "<i4"),
        ("eph", "<u2"), ("epv", "<u2"),
        ("vel", "<u2"), ("vn", "<i2"), ("ve", "<i2"), ("vd", "<i2"),
        ("cog", "<u2"),
        ("fix_type", "u1"),
        ("satellites_visible", "u1"),
        ("id", "u1"),
        ("yaw", "<u2"),
    ],
)  # fmt: skip
HIL_STATE_QUATERNION = MessageSchema(
    common.MAVLINK_MSG_ID_HIL_STATE_QUATERNION,
    [
        ("time_usec", "<u8"),
        ("attitude_quaternion", "<f4", 4),
        ("rollspeed", "<f4"), ("pitchspeed", "<f4"), ("yawspeed", "<f4"),
        ("lat", "<i4"), ("lon", "<i4"), ("alt", "<i4"),
        ("vx", "<i2"), ("vy", "<i2"), ("vz", "<i2"),
        ("ind_airspeed", "<u2"), ("true_airspeed", "<u2"),
        ("xacc", "<i2"), ("yacc", "<i2"), ("zacc", "<i2"),
    ],
)  # fmt: skip
ESC_STATUS = MessageSchema(
    dialect.ESC_STATUS,
    [("time_usec", "<u8"), ("rpm", "<i4", 4), ("voltage", "<f4", 4), ("current", "<f4", 4), ("index", "u1")],
)
RC_CHANNELS = MessageSchema(
    common.MAVLINK_MSG_ID_RC_CHANNELS,
    [
        ("time_boot_ms", "<u4"),
        *((f"chan{number}_raw", "<u2") for number in range(1, _RC_CHANNELS + 1)),
        ("chancount", "u1"),
        ("rssi", "u1"),
    ],
)
HIL_ACTUATOR_CONTROLS = MessageSchema(
    common.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS,
    [("time_usec", "<u8"), ("flags", "<u8"), ("controls", "<f4", 16), ("mode", "u1")],
)
"""Its payload has no trailing zeros, since its last byte, the mode, is not zero."""
SCHEMAS = (HIL_SENSOR, HIL_GPS, HIL_STATE_QUATERNION, ESC_STATUS, RC_CHANNELS, HIL_ACTUATOR_CONTROLS)
