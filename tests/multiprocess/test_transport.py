"""Questions and answers between sessions that share one Zenoh thread: a process can have it no tighter."""

import contextlib
import queue

import pytest

from netsim.transport import Question, Transport

pytestmark = pytest.mark.multiprocess


@pytest.mark.parametrize("size", [0, 1_000, 1_000_000])
def test_eight_are_asked_at_once_and_all_answer_however_long_the_question(size):
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(contextlib.closing(Transport.listen("127.0.0.1", 0)))
        heard: list[tuple[int, int]] = []
        askers = []
        for i in range(8):
            client = stack.enter_context(contextlib.closing(Transport.connect(router.endpoint)))

            def answer(question, i=i):
                heard.append((i, len(question.payload)))
                question.answer(bytes([i]))

            client.serve(f"test/{i}", answer)
            # what follows a declaration on the same connection tells that it has arrived
            nobody = client.asker("test/nobody", timeout_s=5.0)
            assert nobody.ask(b"").answer() is None
            askers.append(router.asker(f"test/{i}", timeout_s=5.0))
        for _ in range(3):
            heard.clear()
            pending = [asker.ask(bytes(size)) for asker in askers]
            assert [each.answer() for each in pending] == [bytes([i]) for i in range(8)]
            assert sorted(heard) == [(i, size) for i in range(8)]


def test_an_answer_may_come_from_another_thread_and_later():
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(contextlib.closing(Transport.listen("127.0.0.1", 0)))
        client = stack.enter_context(contextlib.closing(Transport.connect(router.endpoint)))
        waiting: queue.SimpleQueue[Question] = queue.SimpleQueue()
        router.serve("test/later", waiting.put)
        router.serve("test/now", lambda question: question.answer(b"now"))
        first, second = (client.asker(f"test/{name}", timeout_s=5.0) for name in ("later", "now"))
        later = first.ask(b"?")
        assert second.ask(b"?").answer() == b"now"
        waiting.get(timeout=5.0).answer(b"late" * 100_000)
        assert later.answer() == b"late" * 100_000
