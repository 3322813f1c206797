"""The schema of the simulator link against pymavlink's dialect."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.frame import HEADER, HEADER_BYTES, HEADER_STRUCT
from autopilot.mavlink.hil_schema import HIL_ACTUATOR_CONTROLS, HIL_SENSOR, SCHEMAS


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: str(schema.message_id))
def test_a_schema_has_the_dialects_fields_in_the_order_of_the_wire(schema):
    message = common.mavlink_map[schema.message_id]
    assert list(schema.dtype.names) == message.ordered_fieldnames
    assert schema.crc_extra == message.crc_extra
    values = (
        np.random.default_rng(schema.message_id).integers(0, 256, schema.payload_bytes, np.uint8).tobytes()
    )
    assert repr(schema.struct.unpack(values)) == repr(message.unpacker.unpack(values))
    (row,) = np.frombuffer(values, schema.dtype).tolist()
    flat = [number for value in row for number in np.atleast_1d(value).tolist()]
    assert repr(tuple(flat)) == repr(message.unpacker.unpack(values))


def test_offsets_and_lengths_are_those_of_the_specification():
    assert (HIL_SENSOR.offset("xacc"), HIL_SENSOR.offset("fields_updated")) == (8, 60)
    assert (HIL_SENSOR.payload_bytes, HIL_SENSOR.frame_bytes) == (65, 77)
    assert (HIL_ACTUATOR_CONTROLS.offset("controls"), HIL_ACTUATOR_CONTROLS.payload_bytes) == (16, 81)


def test_the_header_has_the_fields_of_mavlink_2():
    """As in https://mavlink.io/en/guide/serialization.html#mavlink2_packet_format."""
    link = common.MAVLink(None, srcSystem=7, srcComponent=9)
    link.seq = 200
    frame = common.MAVLink_home_position_message(1, 2, 3, 4, 5, 6, [1, 0, 0, 0], 7, 8, 9).pack(link)
    header = HEADER_STRUCT.unpack_from(frame)
    assert header == np.frombuffer(frame[:HEADER_BYTES], HEADER)[0].item()
    assert header == (0xFD, len(frame) - 12, 0, 0, 200, 7, 9, 242, 0)
