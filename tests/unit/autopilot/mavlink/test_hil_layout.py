"""Field offsets of compiled code against pymavlink's dialect."""

import re
import struct

from pymavlink.dialects.v20 import common

from autopilot.mavlink import hil_layout as layout
from autopilot.mavlink.frame import PAYLOAD


def places(kind):
    """Offsets in the buffer of a message's fields by name, and the payload's length."""
    message = common.mavlink_map[kind]
    lengths = [struct.calcsize("<" + field) for field in re.findall(r"\d*[a-zA-Z]", message.unpacker.format)]
    names = message.ordered_fieldnames
    assert len(names) == len(lengths)
    return {name: PAYLOAD + sum(lengths[:i]) for i, name in enumerate(names)}, sum(lengths)


def test_hil_sensor_has_the_dialects_layout():
    fields, size = places(layout.SENSOR_KIND)
    assert size == layout.SENSOR_BYTES
    floats = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")
    assert [fields[name] for name in floats] == [layout.SENSOR_FLOATS + 4 * i for i in range(6)]
    assert fields["time_usec"] == PAYLOAD
    assert fields["fields_updated"] == layout.SENSOR_UPDATED


def test_hil_actuator_controls_has_the_dialects_layout():
    fields, size = places(layout.ACTUATORS_KIND)
    assert size == layout.ACTUATORS_BYTES
    assert fields == {
        "time_usec": layout.ACTUATORS_TIME,
        "flags": layout.ACTUATORS_FLAGS,
        "controls": layout.ACTUATORS_CONTROLS,
        "mode": layout.ACTUATORS_MODE,
    }
