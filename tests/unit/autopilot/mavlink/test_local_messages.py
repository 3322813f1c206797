"""The plain messages between autopilot and application against pymavlink's."""

import pytest
from pymavlink.dialects.v20 import common

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
