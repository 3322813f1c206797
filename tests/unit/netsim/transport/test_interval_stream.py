"""Stream between time master and emulator: complete messages from any pieces, and detection of its end."""

import socket
import struct
import threading

import msgspec
import numpy as np
import pytest

from foundation.processes.message_stream import MessageStream
from netsim.transport.interval_stream import emulators_end, time_masters_end
from netsim.wire.lockstep import Advance, Advanced, pack_rows

STATIONS = 3_000


def advance(to_us, stations=2, **changes):
    rows = {
        "pos_ned_m": pack_rows(np.arange(3.0 * stations).reshape(-1, 3)),
        "vel_ned_m_s": pack_rows(np.zeros((stations, 3))),
        "q_ned_frd": pack_rows(np.tile([1.0, 0.0, 0.0, 0.0], (stations, 1))),
        "extra_attenuation_db": 0.0,
    }
    return Advance(to_us=to_us, release_us=to_us + 4_000, at_us=to_us - 4_000, **rows | changes)


@pytest.fixture
def ends():
    pair = socket.socketpair()
    with pair[0], pair[1]:
        yield pair


def test_requests_and_replies_arrive_complete_and_in_order(ends):
    master, emulator = time_masters_end(ends[0]), emulators_end(ends[1])
    asked = [
        advance(4_000, senders=(0, 1), silent=(7,), extra_attenuation_db=3.0, range_offsets_m=((0, 5.0),)),
        advance(8_000),
    ]
    for message in asked:
        master.send(message)
    assert [emulator.receive() for _ in asked] == asked
    done = Advanced(to_us=8_000, quiet_until_us=2**52, busy_ns=12, delivered=(0, 1), missing=(3,))
    emulator.send(done)
    assert master.receive() == done


def test_message_may_arrive_in_any_pieces(ends):
    sender, emulator = ends[0], emulators_end(ends[1])
    message = advance(4_000, stations=STATIONS)
    body = msgspec.msgpack.encode(message)
    assert len(body) > 2 * 65_536  # longer than what is received at once
    stream = struct.pack("<I", len(body)) + body
    for cut in (1, 3, 4, 5, 1_000):
        sender.sendall(stream[:cut])
        thread = threading.Thread(target=sender.sendall, args=(stream[cut:],))
        thread.start()
        assert emulator.receive() == message
        thread.join(10.0)


def test_closed_connection_is_detected_and_sending_is_ignored(ends):
    master = time_masters_end(ends[0])
    ends[1].close()
    master.send(advance(4_000))
    assert master.receive() is None


def test_incomplete_message_at_the_end_is_ignored(ends):
    emulator = emulators_end(ends[1])
    ends[0].sendall(struct.pack("<I", 10) + b"abc")
    ends[0].close()
    assert emulator.receive() is None


def test_late_reply_times_out_and_can_be_received_later(ends):
    master, emulator = MessageStream(ends[0], Advanced, limit_s=0.05), emulators_end(ends[1])
    with pytest.raises(TimeoutError):
        master.receive()
    done = Advanced(to_us=4_000, quiet_until_us=8_000)
    emulator.send(done)
    assert master.receive() == done


@pytest.mark.parametrize("body", [b"", b"\xff", b"\x90", msgspec.msgpack.encode([4_000, -1])])
def test_invalid_message_is_an_error(ends, body):
    ends[0].sendall(struct.pack("<I", len(body)) + body)
    with pytest.raises(msgspec.DecodeError):
        emulators_end(ends[1]).receive()
