"""Messages between threads: order, limits, and waits that end with a call to wake."""

import threading
import time

from netsim.transport.packet_inbox import PacketInbox

LONG_S = 20.0


def inbox(most_waiting=10, most_bytes=100):
    return PacketInbox(most_waiting=most_waiting, most_bytes=most_bytes)


def taken(messages):
    return list(iter(messages.take, None))


def test_messages_are_taken_in_their_order():
    messages = inbox()
    for payload in (b"a", b"", b"b"):
        messages.put(payload)
    assert taken(messages) == [b"a", b"", b"b"]


def test_messages_beyond_number_or_bytes_are_dropped_and_counted_until_there_is_room():
    messages = inbox(most_waiting=2)
    for payload in (bytes(60), bytes(41), bytes(40), b""):
        messages.put(payload)
    assert messages.dropped == 2  # too many bytes, too many messages
    assert [len(each) for each in taken(messages)] == [60, 40]
    messages.put(bytes(100))
    assert (messages.dropped, len(taken(messages))) == (2, 1)


def test_a_wait_ends_with_a_wake_that_may_be_earlier():
    messages = inbox()
    wall_s = time.monotonic()
    messages.wake()
    messages.wake()
    messages.wait(LONG_S)
    threading.Timer(0.05, messages.wake).start()
    messages.wait(LONG_S)
    assert time.monotonic() - wall_s < LONG_S


def test_a_wait_without_a_wake_lasts_for_its_limit():
    messages = inbox()
    messages.wake()
    messages.wait(LONG_S)
    wall_s = time.monotonic()
    messages.wait(0.05)
    assert time.monotonic() - wall_s >= 0.05
