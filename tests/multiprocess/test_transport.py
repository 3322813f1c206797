"""Queries and one-way messages between Zenoh sessions of one process, which share one thread of Zenoh."""

import contextlib
import queue
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from radio_access import TESTER, router

from netsim.transport.zenoh_session import LONGEST_DIRECT_BYTES, Question, Transport

pytestmark = pytest.mark.multiprocess


@pytest.fixture(params=["unix", "tcp"])
def listener(request):
    with router(link=request.param) as each:
        yield each


def connected(listener, **options):
    """Return a client of the router, to be closed in a ``with``."""
    return contextlib.closing(Transport.connect(listener.endpoint, TESTER, **options))


@pytest.mark.parametrize("size", [0, 1_000, 1_000_000])
def test_eight_concurrent_queries_are_answered_for_any_payload_size(listener, size):
    with contextlib.ExitStack() as stack:
        received: list[tuple[int, int]] = []
        askers = []
        for i in range(8):
            client = stack.enter_context(connected(listener))

            def answer(question, i=i):
                received.append((i, len(question.payload)))
                question.answer(bytes([i]))

            client.serve(f"test/{i}", answer)
            wait_for_declarations(client)
            askers.append(listener.asker(f"test/{i}", timeout_s=5.0))
        for _ in range(3):
            received.clear()
            pending = [asker.ask(bytes(size)) for asker in askers]
            assert [each.answer() for each in pending] == [bytes([i]) for i in range(8)]
            assert sorted(received) == [(i, size) for i in range(8)]


def test_answer_may_be_sent_later_by_another_thread(listener):
    with contextlib.ExitStack() as stack:
        client = stack.enter_context(connected(listener))
        waiting: queue.SimpleQueue[Question] = queue.SimpleQueue()
        listener.serve("test/later", waiting.put)
        listener.serve("test/now", lambda question: question.answer(b"now"))
        first, second = (client.asker(f"test/{name}", timeout_s=5.0) for name in ("later", "now"))
        later = first.ask(b"?")
        assert second.ask(b"?").answer() == b"now"
        waiting.get(timeout=5.0).answer(b"late" * 100_000)
        assert later.answer() == b"late" * 100_000


def test_a_slow_handler_loses_the_oldest_queries_and_delays_no_other_key(listener):
    with contextlib.ExitStack() as stack:
        client = stack.enter_context(connected(listener))
        asked, handled = 2_000, []
        begun, released = threading.Event(), threading.Event()

        def handle_late(question):
            begun.set()
            released.wait(30.0)
            handled.append(int(question.payload))
            question.answer(question.payload)

        listener.serve("test/slow", handle_late, most_waiting=10)
        listener.serve("test/quick", lambda question: question.answer(b"quick"))
        slow, quick = (client.asker(f"test/{name}", timeout_s=30.0) for name in ("slow", "quick"))
        pending = [slow.ask(b"0")]
        assert begun.wait(10.0)
        pending += [slow.ask(b"%d" % number) for number in range(1, asked)]
        assert quick.ask(b"?").answer() == b"quick"  # arrives after all of them, on the same connection
        released.set()
        assert pending[-1].answer() == b"%d" % (asked - 1)
        assert handled == [0, *range(asked - 10, asked)]
        assert pending[1].answer() is None


def wait_for_declarations(client):
    """Wait until the router has a client's declarations: a later query on the same connection is answered."""
    assert client.asker("test/unserved", timeout_s=5.0).ask(b"").answer() is None


@pytest.mark.parametrize(("direct", "size"), [(True, 0), (True, LONGEST_DIRECT_BYTES), (False, 1_000_000)])
def test_one_way_messages_arrive_complete_and_in_order_in_both_directions(listener, direct, size):
    with contextlib.ExitStack() as stack:
        client = stack.enter_context(connected(listener, direct=direct))
        for one, other in ((listener, client), (client, listener)):
            mailbox = other.mailbox("test/letters")
            wait_for_declarations(client)
            sender = one.sender("test/letters")
            letters = [bytes([i]) * size for i in range(20)]
            for letter in letters:
                sender.send(letter)
            assert [mailbox.take(10.0) for _ in letters] == letters
            assert mailbox.take(0.0) is None
            del mailbox


def test_take_returns_none_at_its_timeout():
    with router() as listener:
        mailbox = listener.mailbox("test/letters")
        wall_begin_s = time.monotonic()
        assert mailbox.take(0.2) is None
        assert 0.2 <= time.monotonic() - wall_begin_s < 5.0


SENDER = """
import os, signal, sys
from netsim.transport.zenoh_session import Transport
from netsim.transport.access_control import User
sender = Transport.connect(sys.argv[1], User(*sys.argv[2:]), direct=True)
letters = sender.sender("test/letters")
sender.asker("test/unserved", timeout_s=5.0).ask(b"").answer()
for i in range(10):
    letters.send(bytes([i]) * 1_000)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_messages_of_a_killed_sender_on_a_direct_connection_are_delivered(listener):
    mailbox = listener.mailbox("test/letters")
    command = [sys.executable, "-c", SENDER, listener.endpoint, *TESTER]
    done = subprocess.run(command, check=False, timeout=60.0)
    assert done.returncode == -signal.SIGKILL
    assert [mailbox.take(10.0) for _ in range(10)] == [bytes([i]) * 1_000 for i in range(10)]


def test_sessions_use_no_shared_memory(listener):
    """Zenoh's segments in /dev/shm would outlive their processes, a dozen kilobytes per run."""
    with contextlib.ExitStack() as stack:
        for direct in (False, True):
            stack.enter_context(connected(listener, direct=direct))
        assert "/dev/shm" not in Path("/proc/self/maps").read_text()  # noqa: S108  no file is written
