"""Where what lies in frames of the two messages of every step, for compiled code; counted as `frame` does.

`hil` has the same for Python, as formats; tests hold both against pymavlink's dialect.
"""

from pymavlink.dialects.v20 import common

from autopilot.mavlink.frame import PAYLOAD

SENSOR_KIND = int(common.MAVLINK_MSG_ID_HIL_SENSOR)
SENSOR_EXTRA = int(common.mavlink_map[SENSOR_KIND].crc_extra)
SENSOR_BYTES = 65
"""Of the payload, before zeros are cut off its end."""
SENSOR_FLOATS = PAYLOAD + 8
"""After eight bytes of time: acceleration, rates, and the slower sensors"""
SENSOR_UPDATED = PAYLOAD + 60
"""Which of them are new, in four bytes"""

ACTUATORS_KIND = int(common.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS)
ACTUATORS_EXTRA = int(common.mavlink_map[ACTUATORS_KIND].crc_extra)
ACTUATORS_BYTES = 81
"""Of the payload; nothing is cut off it, for its last byte, the mode, is not zero."""
ACTUATORS_TIME = PAYLOAD
ACTUATORS_FLAGS = PAYLOAD + 8
ACTUATORS_CONTROLS = PAYLOAD + 16
"""Sixteen floats"""
ACTUATORS_MODE = PAYLOAD + 80
