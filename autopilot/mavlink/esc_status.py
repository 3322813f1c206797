"""ESC_STATUS of MAVLink's common messages, which the installed dialect does not have: what motors draw.

Importing this module makes the dialect know the message, so that it is packed and parsed like any other.
"""

import struct
from collections.abc import Sequence
from typing import Any, ClassVar

from pymavlink.dialects.v20 import common

ESC_STATUS = 291
MOTORS = 4
"""Of one message; its ``index`` is the number of the first."""
_FIELDS = ("index", "time_usec", "rpm", "voltage", "current")


class EscStatus(common.MAVLink_message):  # type: ignore[misc]  # pymavlink has no types
    """Speeds in rpm, voltages in V, currents in A of four motors from the ``index``-th on."""

    id = ESC_STATUS
    msgname = "ESC_STATUS"
    fieldnames: ClassVar[Any] = list(_FIELDS)
    ordered_fieldnames: ClassVar[Any] = ["time_usec", "rpm", "voltage", "current", "index"]
    fieldtypes: ClassVar[Any] = ["uint8_t", "uint64_t", "int32_t", "float", "float"]
    fielddisplays_by_name: ClassVar[Any] = {}
    fieldenums_by_name: ClassVar[Any] = {}
    fieldunits_by_name: ClassVar[Any] = {"time_usec": "us", "rpm": "rpm", "voltage": "V", "current": "A"}
    native_format: ClassVar[Any] = bytearray(b"<QiffB")
    orders: ClassVar[Any] = [4, 0, 1, 2, 3]
    lengths: ClassVar[Any] = [1, MOTORS, MOTORS, MOTORS, 1]
    array_lengths: ClassVar[Any] = [0, MOTORS, MOTORS, MOTORS, 0]
    crc_extra = 10
    unpacker = struct.Struct("<Q4i4f4fB")
    instance_field = "index"
    instance_offset = 56

    def __init__(  # the signature that the dialect's decoder expects
        self,
        index: int,
        time_usec: int,
        rpm: Sequence[int],
        voltage: Sequence[float],
        current: Sequence[float],
    ) -> None:
        common.MAVLink_message.__init__(self, EscStatus.id, EscStatus.msgname)
        self._fieldnames = EscStatus.fieldnames
        self._instance_field = EscStatus.instance_field
        self._instance_offset = EscStatus.instance_offset
        self.index = index
        self.time_usec = time_usec
        self.rpm = rpm
        self.voltage = voltage
        self.current = current

    def pack(self, mav: common.MAVLink, force_mavlink1: bool = False) -> bytes:  # noqa: FBT001, FBT002  as generated
        """Give the whole frame, with the sender's numbers of ``mav``."""
        payload = self.unpacker.pack(self.time_usec, *self.rpm, *self.voltage, *self.current, self.index)
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return frame


common.mavlink_map.setdefault(ESC_STATUS, EscStatus)
