"""Framing: every message is found, whatever precedes, separates or surrounds it, and nothing raises."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser, Sequences, frame_bytes, stamp
from autopilot.mavlink.counters import Counters
from autopilot.mavlink.modes import FlightMode, mode_from_custom, mode_from_main_sub


def attitude(number):
    return common.MAVLink_attitude_message(number, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


def frames(count):
    encoder = Encoder(system=3, component=1)
    return [encoder.encode(attitude(i)) for i in range(count)]


def numbers(messages):
    return [message.time_boot_ms for message in messages]


def test_encoded_messages_are_decoded_with_source_and_sequence():
    messages = Parser().push(b"".join(frames(300)))
    assert numbers(messages) == list(range(300))
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in messages} == {(3, 1)}
    assert [m.get_seq() for m in messages] == [i % 256 for i in range(300)]
    assert messages[0].roll == pytest.approx(0.1, rel=1e-6)


def test_a_stamped_message_keeps_its_source():
    encoder = Encoder(system=3, component=1)
    (message,) = Parser().push(encoder.encode(stamp(attitude(0), system=3, component=191)))
    assert (message.get_srcSystem(), message.get_srcComponent()) == (3, 191)
    (message,) = Parser().push(encoder.encode(attitude(1)))
    assert message.get_srcComponent() == 1


def test_the_length_of_a_frame_is_computed_without_changing_the_message():
    message = stamp(attitude(0), system=3, component=191)
    assert frame_bytes(message) == len(Encoder(system=3, component=1).encode(message))
    assert (message.get_srcSystem(), message.get_srcComponent()) == (3, 191)
    # trailing zeros are cut off
    assert frame_bytes(common.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0)) == 12 + 1


@given(st.lists(st.integers(1, 50), max_size=40))
def test_any_cut_of_the_stream_gives_the_same_messages(cuts):
    stream = b"".join(frames(8))
    parser, messages, at = Parser(), [], 0
    for cut in [*cuts, len(stream)]:
        messages += parser.push(stream[at : at + cut])
        at += cut
    assert numbers(messages) == list(range(8))
    assert parser.bad_bytes == 0


@given(st.lists(st.binary(max_size=40), min_size=5, max_size=5))
def test_garbage_between_messages_hides_none_of_them(garbage):
    # enough valid bytes at the end to complete any frame that the garbage appears to begin
    parser = Parser()
    good = frames(4 + 20)
    stream = b"".join(g + f for g, f in zip(garbage, [*good[:4], b""], strict=True)) + b"".join(good[4:])
    assert numbers(parser.push(stream)) == list(range(24))
    assert parser.bad_bytes == sum(map(len, garbage))


def test_random_bytes_never_raise_and_are_counted():
    rng = np.random.default_rng(5)
    parser = Parser()
    data = rng.integers(0, 256, 300_000, dtype=np.uint8)
    data[rng.integers(0, data.size, 6_000)] = 0xFD
    received = 0
    for chunk in np.array_split(data, 500):
        received += len(parser.push(chunk.tobytes()))
    assert received <= 1  # a checksum of 16 bits lets one of 65536 frames through
    assert parser.bad_bytes > data.size - 300 - 280 * received


def test_mutated_frames_give_the_original_or_nothing():
    rng = np.random.default_rng(6)
    original = frames(1)[0]
    for _ in range(3_000):
        frame = bytearray(original)
        frame[rng.integers(1, len(frame))] ^= 1 << rng.integers(
            8
        )  # a checksum catches every single wrong bit
        assert Parser().push_datagram(bytes(frame)) == []


def test_a_frame_does_not_continue_beyond_its_datagram():
    whole, cut = frames(2)
    parser = Parser()
    assert numbers(parser.push_datagram(cut[:-1])) == []
    assert parser.bad_bytes == len(cut) - 1
    assert numbers(parser.push_datagram(whole)) == [0]
    # a false start of a frame must not hide the message after it
    assert numbers(parser.push_datagram(b"\xfd\xff" + whole)) == [0]


def test_version_1_is_accepted():
    sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
    frame = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(sender, force_mavlink1=True)
    (message,) = Parser().push(frame)
    assert message.get_type() == "HEARTBEAT"
    assert message.get_srcSystem() == 255


@pytest.mark.parametrize(
    ("message", "fields"),
    [
        (
            common.MAVLink_command_long_message(3, 1, 400, 0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0),
            {"command": 400, "param1": 1.0, "param7": 7.0, "target_system": 3},
        ),
        (
            common.MAVLink_param_set_message(3, 1, b"MPC_XY_VEL_MAX", 5.5, 9),
            {"param_id": "MPC_XY_VEL_MAX", "param_value": 5.5, "param_type": 9},
        ),
        (
            common.MAVLink_mission_count_message(3, 1, 200),
            # fields that version 1 lacks: mission type and opaque id
            {"count": 200, "target_component": 1, "mission_type": 0, "opaque_id": 0},
        ),
    ],
    ids=["COMMAND_LONG", "PARAM_SET", "MISSION_COUNT"],
)
def test_version_1_messages_have_extension_fields_of_zero(message, fields):
    sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
    frame = message.pack(sender, force_mavlink1=True)
    assert frame[0] == 0xFE
    parser = Parser()
    (received,) = parser.push_datagram(frame)
    assert {name: getattr(received, name) for name in fields} == fields
    assert parser.counters == Counters()


def test_frames_with_unknown_incompatibility_flags_are_rejected():
    frame = bytearray(frames(1)[0])
    frame[2] = 0x02
    parser = Parser()
    assert parser.push_datagram(bytes(frame)) == []
    assert parser.counters.frames_incompatible == 1
    assert parser.bad_bytes == len(frame)


def unknown_kind(frame):
    frame[7:10] = b"\x7f\x7f\x7f"


def wrong_checksum(frame):
    frame[-1] ^= 1


def incompatible(frame):
    frame[2] = 0x02


@pytest.mark.parametrize(
    ("spoil", "cause"),
    [
        (incompatible, "frames_incompatible"),
        (wrong_checksum, "frames_bad_checksum"),
        (unknown_kind, "frames_unknown"),
    ],
)
def test_each_cause_has_its_own_counter(spoil, cause):
    whole, spoiled = frames(2)[0], bytearray(frames(2)[1])
    assert spoiled.count(0xFD) + spoiled.count(0xFE) == 1  # otherwise it contains another apparent frame
    spoil(spoiled)
    parser = Parser()
    for _ in range(7):
        assert numbers(parser.push_datagram(bytes(spoiled) + whole)) == [0]
    of_bytes = "bytes_unknown" if cause == "frames_unknown" else "bytes_bad"
    assert parser.counters == Counters(**{cause: 7, of_bytes: 7 * len(spoiled)})


def test_the_payload_of_an_unknown_message_is_no_message():
    """A frame inside another one is skipped with it, unless bytes around them are in no frame."""
    inner = frames(1)[0]
    outer = bytearray(inner[:10] + inner + inner[-2:])
    outer[1] = len(inner)
    unknown_kind(outer)
    parser = Parser()
    assert parser.push_datagram(bytes(outer)) == []
    assert parser.push_datagram(inner + bytes(outer) + inner) != []
    assert parser.counters == Counters(frames_unknown=2, bytes_unknown=2 * len(outer))
    assert numbers(parser.push_datagram(b"\x00" + bytes(outer))) == [0]
    # in a stream a length that was garbage must not hide what follows
    assert numbers(parser.push(bytes(outer))) == [0]


def test_a_datagram_of_frame_starts_is_parsed_quickly():
    """Every byte appears to begin a complete frame of a known message: the most expensive garbage."""
    header = bytes([0xFE, 0xFE, 0, 0, 0, common.MAVLINK_MSG_ID_ATTITUDE])
    parser = Parser()
    datagram = (header * 11_000)[:65_000]
    begun_s = time.process_time()
    assert parser.push_datagram(datagram) == []
    assert time.process_time() - begun_s < 1.0
    assert parser.bad_bytes == len(datagram)


def test_each_partner_receives_every_source_without_gaps():
    """Messages to one partner or from one component leave no gap in the sequence numbers of others."""
    encoder, sequences = Encoder(system=3, component=1), [Sequences(), Sequences()]
    received = [[], []]
    for i in range(600):
        message = attitude(i)
        if i % 3 == 0:
            stamp(message, system=3, component=191)
        frame = encoder.encode(message)
        for partner in (0, 1) if i % 5 else (1,):
            renumbered = sequences[partner].renumber(frame, common.MAVLINK_MSG_ID_ATTITUDE)
            received[partner] += Parser().push_datagram(renumbered)
    assert [len(messages) for messages in received] == [480, 600]
    for messages in received:
        for component in (1, 191):
            of_one = [m.get_seq() for m in messages if m.get_srcComponent() == component]
            assert of_one == [i % 256 for i in range(len(of_one))]


@pytest.mark.parametrize("mode", [m for m in FlightMode if m is not FlightMode.DESCEND])
def test_modes_have_px4s_numbers_and_convert_back(mode):
    assert mode_from_custom(mode.custom_mode) is mode
    assert mode_from_main_sub(mode.custom_mode >> 16 & 0xFF, mode.custom_mode >> 24) is mode


def test_modes_as_observed_from_px4():
    # PX4 v1.17: hold 4/3; base_mode 29 disarmed, 157 armed in auto modes, 145 armed in offboard
    assert FlightMode.HOLD.custom_mode == 4 << 16 | 3 << 24
    assert FlightMode.HOLD.base_mode == 29
    assert FlightMode.TAKEOFF.base_mode | common.MAV_MODE_FLAG_SAFETY_ARMED == 157
    assert FlightMode.OFFBOARD.base_mode | common.MAV_MODE_FLAG_SAFETY_ARMED == 145
    assert FlightMode.DESCEND.custom_mode == FlightMode.LAND.custom_mode


@pytest.mark.parametrize(
    ("main", "sub"), [(9.0, 0.0), (float("nan"), 0.0), (4.0, float("inf")), (-1.0, 3.0), (4.0, 3e9)]
)
def test_invalid_mode_numbers_give_none(main, sub):
    assert mode_from_main_sub(main, sub) is None
