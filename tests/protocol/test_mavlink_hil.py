"""The struct codecs of the simulator link against pymavlink: equal bytes and fields for any input."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.dialect import EscStatus
from autopilot.mavlink.hil import (
    EscReport,
    HilActuatorControls,
    HilEncoder,
    HilGps,
    HilParser,
    HilSensor,
    pack,
)

FLOATS = st.floats(width=32)
SENSORS = st.builds(
    HilSensor,
    st.integers(0, 2**64 - 1),
    *[FLOATS | st.just(0.0)] * 13,
    st.integers(0, 2**32 - 1) | st.just(0),
    st.integers(0, 255) | st.just(0),
)
ACTUATORS = st.builds(
    HilActuatorControls,
    st.integers(0, 2**64 - 1),
    st.lists(FLOATS, min_size=16, max_size=16),
    st.integers(0, 255) | st.just(0),
    st.integers(0, 2**64 - 1),
)
U8, U16, I16, I32 = (st.integers(low, high) | st.just(0) for low, high in (
    (0, 2**8 - 1), (0, 2**16 - 1), (-(2**15), 2**15 - 1), (-(2**31), 2**31 - 1),
))  # fmt: skip
FIXES = st.builds(
    HilGps, st.integers(0, 2**64 - 1), U8, I32, I32, I32, U16, U16, U16, I16, I16, I16, U16, U8, U8, U16
)
ESCS = st.builds(
    EscReport,
    U8,
    st.integers(0, 2**64 - 1),
    *[st.lists(values, min_size=4, max_size=4) for values in (I32, FLOATS, FLOATS)],
)
HOT = st.one_of(SENSORS, FIXES, ESCS, ACTUATORS)
THEIRS = {
    HilSensor: common.MAVLink_hil_sensor_message,
    HilGps: common.MAVLink_hil_gps_message,
    EscReport: EscStatus,
    HilActuatorControls: common.MAVLink_hil_actuator_controls_message,
}


def theirs(message):
    """Return pymavlink's message with the same fields."""
    return THEIRS[type(message)](*message)


def bits(message):
    """Return a representation that distinguishes values, NaNs and signs of zero included."""
    flat = [x for field in message for x in (field if isinstance(field, list | tuple) else [field])]
    return [struct.pack("<d", x) if isinstance(x, float) else x for x in flat]


def heartbeat():
    return common.MAVLink_heartbeat_message(2, 12, 129, 0, 4, 3)


@given(HOT, st.integers(0, 255), st.integers(1, 255), st.integers(0, 255))
def test_frames_are_those_of_pymavlink(message, sequence, system, component):
    link = common.MAVLink(None, srcSystem=system, srcComponent=component)
    link.seq = sequence
    ours = pack(message, sequence=sequence, system=system, component=component)
    assert ours == theirs(message).pack(link)


@given(HOT)
def test_pymavlinks_frames_are_parsed_with_the_same_fields(message):
    parser = HilParser(type(message))
    (ours,) = parser.push(Encoder(system=1, component=1).encode(theirs(message)))
    assert type(ours) is type(message)
    assert bits(ours) == bits(message)
    assert ours.get_msgId() == theirs(message).get_msgId()
    assert parser.bad_bytes == 0


def test_hot_and_other_messages_share_one_sequence():
    encoder, parser = HilEncoder(system=7, component=1), Parser()
    controls = HilActuatorControls(4000, [0.5] * 16, 129, 1)
    for _ in range(150):
        frames = encoder.encode(controls) + encoder.encode(heartbeat())
        first, second = parser.push(frames)
        assert (first.get_srcSystem(), first.get_srcComponent()) == (7, 1)
        assert second.get_seq() == (first.get_seq() + 1) % 256
    assert first.time_usec == 4000


@given(
    st.lists(st.sampled_from("shaxv") | st.binary(max_size=30), max_size=8),
    st.lists(st.integers(1, 120), min_size=1, max_size=5),
)
def test_any_split_of_a_stream_gives_the_same_messages_as_the_general_parser(parts, pieces):
    """Hot frames (s), others (h, a), a broken hot frame (x) or one of MAVLink 1 (v), and random bytes."""
    encoder, old = Encoder(system=1, component=1), common.MAVLink(None)
    stream = bytearray()
    for number, part in enumerate(parts):
        sensor = common.MAVLink_hil_sensor_message(4000 * number, *[float(number)] * 13, 0x3F, 0)
        actuators = common.MAVLink_hil_actuator_controls_message(number, [0.25] * 16, 1, 1)
        if isinstance(part, bytes):
            stream += part
        elif part == "v":
            stream += sensor.pack(old, force_mavlink1=True)
        elif part == "x":
            stream += encoder.encode(sensor)[:-1] + b"\x00"
        else:
            stream += encoder.encode({"s": sensor, "a": actuators, "h": heartbeat()}[part])
    ours, general = HilParser(HilSensor), Parser()
    got, expected, at, turn = [], [], 0, 0
    while at < len(stream):
        size = pieces[turn % len(pieces)]
        got += ours.push(bytes(stream[at : at + size]))
        expected += general.push(bytes(stream[at : at + size]))
        at, turn = at + size, turn + 1
    assert ours.bad_bytes == general.bad_bytes
    assert [m.get_msgId() for m in got] == [m.get_msgId() for m in expected]
    for mine, other in zip(got, expected, strict=True):
        if other.get_msgId() == common.MAVLINK_MSG_ID_HIL_SENSOR:
            assert mine == HilSensor(*(getattr(other, name) for name in HilSensor._fields))


@given(st.binary(max_size=400))
def test_random_bytes_never_raise(data):
    for hot in (HilSensor, HilActuatorControls):
        HilParser(hot).push(data)
        # preceded by a right header
        kind = 107 if hot is HilSensor else 93
        HilParser(hot).push(bytes([0xFD, len(data) % 256, 0, 0, 0, 1, 1, kind, 0, 0]) + data)


@given(HOT, st.data())
def test_a_frame_with_any_wrong_bit_is_rejected(message, data):
    frame = bytearray(pack(message, sequence=1, system=1, component=1))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    parser = HilParser(type(message))
    assert [m for m in parser.push(bytes(frame)) if isinstance(m, type(message))] == []


def test_a_signed_frame_is_parsed_by_the_general_parser():
    encoder = common.MAVLink(None, srcSystem=1)
    encoder.signing.secret_key, encoder.signing.sign_outgoing = bytes(32), True
    frame = common.MAVLink_hil_sensor_message(4000, *[0.5] * 13, 0x3F, 0).pack(encoder)
    assert len(frame) == 10 + 61 + 2 + 13
    (message,) = HilParser(HilSensor).push(bytes(frame))
    assert message == HilSensor(4000, *[0.5] * 13, 0x3F, 0)


@pytest.mark.parametrize("value", [1e39, math.inf])
def test_a_value_beyond_float32_raises_in_the_sender_and_infinity_does_not(value):
    message = HilActuatorControls(0, [value] * 16, 1, 1)
    if math.isinf(value):
        (got,) = HilParser(HilActuatorControls).push(pack(message, sequence=0, system=1, component=1))
        assert list(got.controls) == [value] * 16
    else:
        with pytest.raises(OverflowError):
            pack(message, sequence=0, system=1, component=1)
