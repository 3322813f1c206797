"""Plain values of frequent messages against pymavlink's messages of the same frames."""

import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.frame import whole_frame
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.mavlink.telemetry import FREQUENT, CompanionEncoder, TelemetryParser

SYSTEM, COMPONENT = 3, 1
TARGET = PositionTarget(4_000, 3, 1, 1, 3072, 1.5, -2.5, -10.0, 0.25, 0.5, -0.125, 0.5, 0.75)


def example(message_id, *, zeros=False):
    """A message of which each field has another value, exact in single precision; or zeros only."""
    described = common.mavlink_map[message_id]
    values = []
    for index, length in enumerate(described.array_lengths[order] for order in described.orders):
        value = 0 if zeros else index + 1
        values.append([value] * length if length else value)
    return described(*values)


def frame(message, *, system=SYSTEM, component=COMPONENT):
    return Encoder(system=system, component=component).encode(message)


def parser():
    return TelemetryParser(system=SYSTEM, component=COMPONENT)


@pytest.mark.parametrize("zeros", [False, True])
@pytest.mark.parametrize("message_id", sorted(FREQUENT))
def test_fields_id_and_name_are_pymavlinks(message_id, zeros):
    data = frame(example(message_id, zeros=zeros))
    (plain,), (message,) = parser().push_datagram(data), Parser().push_datagram(data)
    assert isinstance(plain, tuple)
    assert (plain.get_msgId(), plain.get_type()) == (message_id, message.get_type())
    arrays = {name for name in message.fieldnames if isinstance(getattr(message, name), list)}
    assert plain._fields == tuple(name for name in message.fieldnames if name not in arrays)
    assert plain._asdict() == {name: getattr(message, name) for name in plain._fields}


@pytest.mark.parametrize("source", [(SYSTEM, 100), (9, COMPONENT), (255, 190)])
def test_messages_of_others_keep_their_source(source):
    system, component = source
    data = frame(example(common.MAVLINK_MSG_ID_ALTITUDE), system=system, component=component)
    (message,) = parser().push_datagram(data)
    assert (message.get_srcSystem(), message.get_srcComponent()) == source


def test_rare_messages_and_several_in_one_datagram_are_parsed_as_before():
    beat = frame(common.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))
    altitude = frame(example(common.MAVLINK_MSG_ID_ALTITUDE))
    names = [message.get_type() for message in parser().push_datagram(beat + altitude + beat)]
    assert names == ["HEARTBEAT", "ALTITUDE", "HEARTBEAT"]
    (message,) = parser().push_datagram(beat)
    assert (message.get_srcSystem(), message.autopilot) == (SYSTEM, 12)


def test_ids_of_messages_that_the_dialect_lacks_are_reported_once():
    receiver = parser()
    unknown, system = 290, SYSTEM
    for _ in range(2):
        data = whole_frame(
            bytes(20), message_id=unknown, crc_extra=b"x", sequence=0, system=system, component=COMPONENT
        )
        assert receiver.push_datagram(data) == []
        system = 9  # another one's
    assert receiver.take_unknown() == {unknown}
    assert receiver.take_unknown() == set()
    assert receiver.bad_bytes == 0


@pytest.mark.parametrize("message_id", sorted(FREQUENT))
def test_a_changed_or_cut_frame_is_no_message_and_is_counted(message_id):
    data = frame(example(message_id))
    for at in range(len(data)):
        receiver = parser()
        assert receiver.push_datagram(data[:at]) == []
        changed = data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]
        assert receiver.push_datagram(changed) == []
        assert receiver.bad_bytes + receiver.counters.bytes_unknown == at + len(data)


def test_a_payload_that_is_longer_than_the_message_is_left_to_the_general_parser():
    """A later version of a message has more fields, which its checksum does not show."""
    message_id = common.MAVLINK_MSG_ID_ALTITUDE
    described = common.mavlink_map[message_id]
    payload = bytes(range(1, described.unpacker.size + 5))
    data = whole_frame(
        payload, message_id=message_id, crc_extra=bytes([described.crc_extra]), sequence=0, system=SYSTEM,
        component=COMPONENT,
    )  # fmt: skip
    expected = [message.to_dict() for message in Parser().push_datagram(data)]
    assert [message.to_dict() for message in parser().push_datagram(data)] == expected


def test_a_setpoint_has_the_frame_that_pymavlink_gives_it():
    encoder, general = CompanionEncoder(system=3, component=191), Encoder(system=3, component=191)
    beat = common.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    setpoint = common.MAVLink_set_position_target_local_ned_message(*TARGET)
    for _ in range(2):
        assert encoder.encode(TARGET) == general.encode(setpoint)
        assert encoder.encode(beat) == general.encode(beat)
