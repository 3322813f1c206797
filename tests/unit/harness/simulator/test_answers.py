"""Answers that are taken at once are those that the codec makes, and nothing that is not exactly one."""

import contextlib
import socket

import numpy as np
import pytest
from fastcrc import crc16
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.hil import HilActuatorControls, pack
from harness.simulator.actuator_inbox import ANSWER_BYTES, ActuatorInbox
from harness.simulator.lockstep import Lockstep
from harness.simulator.response_watchdog import ResponseWatchdog
from netsim.wire.lockstep import BATCH_HANDED_OVER

NOW_US = 4_000
CRC_EXTRA = bytes([mavlink.mavlink_map[mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS].crc_extra])


def answer(i, time_us=NOW_US, *, mode=129, flags=1, controls=(0.25, 0.5, 0.75, 1.0)):
    values = HilActuatorControls(time_us, [*controls, *(0.125,) * 12], mode, flags)
    return pack(values, sequence=i, system=i + 1, component=1)


def heartbeat(i):
    return Encoder(system=i + 1, component=1).encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))


def test_an_answer_is_taken_as_it_was_packed():
    answers, rng = ActuatorInbox(3), np.random.default_rng(1)
    for step in range(50):
        time_us = NOW_US * (step + 1)
        controls = rng.random((3, 4)).astype(np.float32)
        modes, hands_over = rng.choice([1, 129], 3), rng.random(3) < 0.5
        for i in range(3):
            flags = 1 | BATCH_HANDED_OVER if hands_over[i] else 1
            answers.hear(
                i, answer(i, time_us, mode=int(modes[i]), flags=flags, controls=controls[i].tolist())
            )
        assert answers.take(time_us) == 3
        np.testing.assert_array_equal(answers.controls, controls)
        assert answers.armed.tolist() == (modes == 129).tolist()
        assert answers.senders == tuple(np.flatnonzero(hands_over))
        assert answers.answered_us.tolist() == [time_us] * 3


def test_what_the_codec_makes_of_an_answer_is_taken_as_well():
    """By pymavlink, whose frame is the other witness."""
    message = mavlink.MAVLink_hil_actuator_controls_message(NOW_US, [0.5] * 16, 129, 1)
    answers = ActuatorInbox(1)
    answers.hear(0, Encoder(system=1, component=1).encode(message))
    assert answers.take(NOW_US) == 1
    assert answers.controls.tolist() == [[0.5] * 4]


def resealed(frame, at, byte):
    """The frame with another byte at a place, and the checksum that belongs to it."""
    changed = bytearray(frame)
    changed[at] = byte
    changed[-2:] = crc16.mcrf4xx(bytes(changed[1:-2]) + CRC_EXTRA).to_bytes(2, "little")
    return bytes(changed)


def test_a_resealed_frame_is_right():
    """So what is refused of the frames below is not their sum."""
    answers = ActuatorInbox(1)
    answers.hear(0, resealed(answer(0), 4, 200))  # another number in the sequence
    assert answers.take(NOW_US) == 1


def not_one_answer():
    frame = answer(0)
    assert len(frame) == ANSWER_BYTES
    yield "nothing", b""
    yield "a part", frame[:-1]
    yield "more", frame + b"\0"
    yield "another message", heartbeat(0)
    yield "of another time", answer(0, NOW_US - 4_000)
    for at in (1, 2, 4, 5, 10, 30, 89, 90, 91, 92):
        yield f"a wrong sum for byte {at}", frame[:at] + bytes((frame[at] ^ 0x40,)) + frame[at + 1 :]
    # these have the sum that belongs to them
    yield "MAVLink 1", resealed(frame, 0, 0xFE)
    yield "a shorter payload", resealed(frame, 1, frame[1] - 1)
    yield "a longer payload", resealed(frame, 1, frame[1] + 1)
    yield "a signed frame", resealed(frame, 2, 1)
    for at in (7, 8, 9):
        yield f"another kind, by byte {at}", resealed(frame, at, frame[at] ^ 1)


@pytest.mark.parametrize(
    "said", [said for _, said in not_one_answer()], ids=[what for what, _ in not_one_answer()]
)
def test_whatever_is_not_one_answer_is_left_as_it_was_said(said):
    answers = ActuatorInbox(2)
    answers.hear(0, answer(0, controls=(0.5,) * 4))
    assert answers.take(NOW_US) == 1
    answers.hear(0, said)
    answers.hear(1, answer(1))
    assert answers.take(NOW_US) == 1
    assert answers.answered_us.tolist() == [0, NOW_US]
    assert answers.controls[0].tolist() == [0.5] * 4  # of before
    assert answers.said(0) == said
    assert answers.said(0) == b""


@contextlib.contextmanager
def one_seat():
    listener = socket.create_server(("127.0.0.1", 0))
    said, lost = [], []
    lockstep = Lockstep(
        [listener],
        patience=ResponseWatchdog(1.0),
        on_message=lambda i, message: said.append((i, message.get_type())),
        on_silent=lambda *_: None,
        on_lost=lambda i, reason: lost.append((i, reason)),
    )
    with contextlib.closing(lockstep), socket.create_connection(listener.getsockname()) as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.sendall(heartbeat(0))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        yield lockstep, client, said, lost


def test_answers_count_however_the_stream_is_cut():
    """Messages before and behind an answer, long speeches, pieces that end anywhere: all is heard once."""
    rng = np.random.default_rng(4)
    with one_seat() as (lockstep, client, said, lost):
        beats, left = 0, b""
        for step in range(200):
            time_us = NOW_US * (step + 1)
            lockstep.send([b"sensors"])
            before, behind = (int(n) for n in rng.choice([0, 0, 0, 1, 2, 20], 2))
            control = float(np.float32(rng.random()))
            frame = answer(0, time_us, controls=(control,) * 4)
            stream = left + heartbeat(0) * before + frame + heartbeat(0) * behind
            beats += before + behind
            # what follows the answer may come with the next one's first bytes
            end = len(stream) - int(rng.integers(0, 1 + behind * len(heartbeat(0))))
            left = stream[end:]
            for piece in np.split(np.frombuffer(stream[:end], np.uint8), np.sort(rng.integers(0, end, 3))):
                client.sendall(piece.tobytes())
            answers = lockstep.answers(time_us)
            assert answers.answered_us.tolist() == [time_us]
            assert answers.controls[0].tolist() == [control] * 4
        lockstep.send([b"sensors"])
        client.sendall(left + answer(0, 201 * NOW_US))
        lockstep.answers(201 * NOW_US)
        assert said == [(0, "HEARTBEAT")] * beats
        assert lost == []
