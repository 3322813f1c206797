"""Messages and expected values in tests of the parameter services."""

import struct

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.parameters.table import ROW_INDEX_OF, ROWS
from autopilot.services.parameter import value_bytes

UINT32, INT32, REAL32 = 5, 6, 9


def bits(message):
    """Value of a PARAM_VALUE as the four bytes on the wire."""
    if message.param_type == UINT32:
        return struct.pack("<I", message.param_value)
    return struct.pack("<f", message.param_value)


def expected(parameters):
    return {
        index: (row.name, value_bytes(row.is_integer, parameters.get(row.name)))
        for index, row in enumerate(ROWS)
    }


def over_the_wire(message, system=255):
    (decoded,) = Parser().push(Encoder(system=system, component=190).encode(message))
    return decoded


def set_message(name, value, kind=None):
    row = ROWS[ROW_INDEX_OF[name]] if name in ROW_INDEX_OF else None
    if kind is None:
        kind = INT32 if row is not None and row.is_integer else REAL32
    if kind == INT32:
        (value,) = struct.unpack("<f", struct.pack("<i", round(value)))
    return common.MAVLink_param_set_message(1, 1, name.encode(), value, kind)
