"""The inbox unpacks exactly one valid answer frame and leaves all other input to the parser."""

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


def put_bytes(inbox, instance, data):
    """Store bytes as if they had been received from a vehicle."""
    inbox.buffers[instance][: len(data)] = data
    inbox.states["received_bytes"][instance] = len(data)


def answer(i, time_us=NOW_US, *, mode=129, flags=1, controls=(0.25, 0.5, 0.75, 1.0)):
    values = HilActuatorControls(time_us, [*controls, *(0.125,) * 12], mode, flags)
    return pack(values, sequence=i, system=i + 1, component=1)


def heartbeat(i):
    return Encoder(system=i + 1, component=1).encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))


def test_an_answer_is_unpacked_as_it_was_packed():
    inbox, rng = ActuatorInbox(3), np.random.default_rng(1)
    for step in range(50):
        time_us = NOW_US * (step + 1)
        controls = rng.random((3, 4)).astype(np.float32)
        modes, hands_over = rng.choice([1, 129], 3), rng.random(3) < 0.5
        for i in range(3):
            flags = 1 | BATCH_HANDED_OVER if hands_over[i] else 1
            put_bytes(
                inbox, i, answer(i, time_us, mode=int(modes[i]), flags=flags, controls=controls[i].tolist())
            )
        assert inbox.unpack(time_us) == 3
        np.testing.assert_array_equal(inbox.controls, controls)
        assert inbox.armed.tolist() == (modes == 129).tolist()
        assert inbox.senders == tuple(np.flatnonzero(hands_over))
        assert inbox.answered_us.tolist() == [time_us] * 3


def test_the_newest_answer_is_that_to_any_step_however_it_was_unpacked():
    inbox = ActuatorInbox(2)
    assert inbox.newest(0) is None
    put_bytes(inbox, 0, answer(0))
    inbox.put(1, HilActuatorControls(NOW_US, [0.5] * 16, 1, 0))
    inbox.unpack(NOW_US)
    inbox.unpack(2 * NOW_US)  # a step without an answer
    first, second = inbox.newest(0), inbox.newest(1)
    assert (first.time_usec, first.controls[:4], first.mode) == (NOW_US, (0.25, 0.5, 0.75, 1.0), 128)
    assert (second.time_usec, second.controls[:4], second.mode) == (NOW_US, (0.5,) * 4, 0)
    assert len(first.controls) == len(second.controls) == 16


def test_an_answer_encoded_by_pymavlink_is_unpacked():
    """Pymavlink is an independent implementation of the frame."""
    message = mavlink.MAVLink_hil_actuator_controls_message(NOW_US, [0.5] * 16, 129, 1)
    inbox = ActuatorInbox(1)
    put_bytes(inbox, 0, Encoder(system=1, component=1).encode(message))
    assert inbox.unpack(NOW_US) == 1
    assert inbox.controls.tolist() == [[0.5] * 4]


def resealed(frame, at, byte):
    """Return the frame with one byte replaced and its checksum recomputed."""
    changed = bytearray(frame)
    changed[at] = byte
    changed[-2:] = crc16.mcrf4xx(bytes(changed[1:-2]) + CRC_EXTRA).to_bytes(2, "little")
    return bytes(changed)


def test_a_resealed_frame_is_valid():
    """So the frames below are not refused because of their checksums."""
    inbox = ActuatorInbox(1)
    put_bytes(inbox, 0, resealed(answer(0), 4, 200))  # another sequence number
    assert inbox.unpack(NOW_US) == 1


def not_one_answer():
    frame = answer(0)
    assert len(frame) == ANSWER_BYTES
    yield "nothing", b""
    yield "a part", frame[:-1]
    yield "more", frame + b"\0"
    yield "another message", heartbeat(0)
    yield "another time stamp", answer(0, NOW_US - 4_000)
    for at in (1, 2, 4, 5, 10, 30, 89, 90, 91, 92):
        yield f"a wrong checksum for byte {at}", frame[:at] + bytes((frame[at] ^ 0x40,)) + frame[at + 1 :]
    # frames with a valid checksum
    yield "MAVLink 1", resealed(frame, 0, 0xFE)
    yield "a shorter payload", resealed(frame, 1, frame[1] - 1)
    yield "a longer payload", resealed(frame, 1, frame[1] + 1)
    yield "a signed frame", resealed(frame, 2, 1)
    for at in (7, 8, 9):
        yield f"another message id, byte {at}", resealed(frame, at, frame[at] ^ 1)


@pytest.mark.parametrize(
    "data", [data for _, data in not_one_answer()], ids=[name for name, _ in not_one_answer()]
)
def test_input_that_is_not_one_answer_is_left_unchanged(data):
    inbox = ActuatorInbox(2)
    put_bytes(inbox, 0, answer(0, controls=(0.5,) * 4))
    assert inbox.unpack(NOW_US) == 1
    put_bytes(inbox, 0, data)
    put_bytes(inbox, 1, answer(1))
    assert inbox.unpack(NOW_US) == 1
    assert inbox.answered_us.tolist() == [0, NOW_US]
    assert inbox.controls[0].tolist() == [0.5] * 4  # of the step before
    assert inbox.take_bytes(0) == data
    assert inbox.take_bytes(0) == b""


@contextlib.contextmanager
def one_slot():
    listener = socket.create_server(("127.0.0.1", 0))
    messages, lost = [], []
    lockstep = Lockstep(
        {0: listener},
        watchdog=ResponseWatchdog(1.0),
        on_message=lambda i, message: messages.append((i, message.get_type())),
        on_silent=lambda *_: None,
        on_lost=lambda i, reason: lost.append((i, reason)),
    )
    with contextlib.closing(lockstep), socket.create_connection(listener.getsockname()) as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.sendall(heartbeat(0))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        yield lockstep, client, messages, lost


def test_answers_count_however_the_stream_is_cut():
    """Messages before and after an answer, long input, pieces of any length: each is received once."""
    rng = np.random.default_rng(4)
    with one_slot() as (lockstep, client, messages, lost):
        beats, left = 0, b""
        for step in range(200):
            time_us = NOW_US * (step + 1)
            lockstep.send([b"sensors"])
            before, behind = (int(n) for n in rng.choice([0, 0, 0, 1, 2, 20], 2))
            control = float(np.float32(rng.random()))
            frame = answer(0, time_us, controls=(control,) * 4)
            stream = left + heartbeat(0) * before + frame + heartbeat(0) * behind
            beats += before + behind
            # messages after the answer may arrive with the first bytes of the next one
            end = len(stream) - int(rng.integers(0, 1 + behind * len(heartbeat(0))))
            left = stream[end:]
            for piece in np.split(np.frombuffer(stream[:end], np.uint8), np.sort(rng.integers(0, end, 3))):
                client.sendall(piece.tobytes())
            inbox = lockstep.receive(time_us)
            assert inbox.answered_us.tolist() == [time_us]
            assert inbox.controls[0].tolist() == [control] * 4
        lockstep.send([b"sensors"])
        client.sendall(left + answer(0, 201 * NOW_US))
        lockstep.receive(201 * NOW_US)
        assert messages == [(0, "HEARTBEAT")] * beats
        assert lost == []
