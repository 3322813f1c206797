"""Field offsets of the two messages of every step, for compiled code; relative to the buffer as in `frame`.

`hil` has the same formats for Python; tests compare both with pymavlink's dialect.
"""

from pymavlink.dialects.v20 import common

from autopilot.mavlink.frame import PAYLOAD

SENSOR_KIND = int(common.MAVLINK_MSG_ID_HIL_SENSOR)
SENSOR_EXTRA = int(common.mavlink_map[SENSOR_KIND].crc_extra)
SENSOR_BYTES = 65
"""Length of the payload before trailing zeros are cut off."""
SENSOR_FLOATS = PAYLOAD + 8
"""After eight bytes of time: acceleration, body rates, and the slower sensors"""
SENSOR_UPDATED = PAYLOAD + 60
"""Four bytes of flags for the values that are new"""

ACTUATORS_KIND = int(common.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS)
ACTUATORS_EXTRA = int(common.mavlink_map[ACTUATORS_KIND].crc_extra)
ACTUATORS_BYTES = 81
"""Length of the payload; it has no trailing zeros, since its last byte, the mode, is not zero."""
ACTUATORS_TIME = PAYLOAD
ACTUATORS_FLAGS = PAYLOAD + 8
ACTUATORS_CONTROLS = PAYLOAD + 16
"""Sixteen floats"""
ACTUATORS_MODE = PAYLOAD + 80
