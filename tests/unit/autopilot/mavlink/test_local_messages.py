"""The plain messages between autopilot and application against pymavlink's."""

import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.local_messages import LocalPosition, PositionTarget

POSITION = LocalPosition(4_000, 1.5, -2.5, -10.0, 0.25, 0.5, -0.125)
TARGET = PositionTarget(4_000, 3, 1, 1, 3072, 1.5, -2.5, -10.0, 0.25, 0.5, -0.125, 0.5, 0.75)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (POSITION, common.MAVLink_local_position_ned_message),
        (TARGET, common.MAVLink_set_position_target_local_ned_message),
    ],
)
def test_fields_id_and_name_are_equal(value, message):
    assert value._fields == tuple(message.fieldnames)
    assert value.get_msgId() == message.id
    assert value.get_type() == message.msgname


def test_a_position_target_is_preserved_by_packing_and_parsing():
    """The values are exact in single precision."""
    frame = Encoder(system=3, component=191).encode(TARGET.to_wire())
    (received,) = Parser().push(frame)
    assert received.get_type() == TARGET.get_type()
    assert tuple(getattr(received, field) for field in TARGET._fields) == TARGET
