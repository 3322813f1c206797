"""One thread hears many descriptors, does what others ask of it in order, and leaves nothing open."""

import os
import queue
import threading
import time
from collections.abc import Iterator

import psutil
import pytest

from harness.launch.descriptor_watcher import DescriptorWatcher

WALL_LIMIT_S = 20.0


@pytest.fixture
def listener() -> Iterator[DescriptorWatcher]:
    listener = DescriptorWatcher("test listener")
    yield listener
    listener.close()


class Ear:
    """A pipe that is heard: every chunk with the thread that read it."""

    def __init__(self, listener: DescriptorWatcher) -> None:
        self.heard: queue.SimpleQueue[tuple[bytes, int]] = queue.SimpleQueue()
        self._listener = listener
        self._theirs, self.ours = os.pipe()
        listener.call(lambda: listener.watch(self._theirs, self._read))

    def _read(self) -> None:
        data = os.read(self._theirs, 100)
        if not data:
            self._listener.forget(self._theirs)
            os.close(self._theirs)
        self.heard.put((data, threading.get_ident()))

    def next(self) -> tuple[bytes, int]:
        return self.heard.get(timeout=WALL_LIMIT_S)


def test_many_are_heard_by_one_thread_until_they_end(listener: DescriptorWatcher) -> None:
    before = psutil.Process().num_threads()
    ears = [Ear(listener) for _ in range(100)]
    assert psutil.Process().num_threads() == before + 1
    for i, ear in enumerate(ears):
        os.write(ear.ours, b"%d" % i)
    said = [ear.next() for ear in ears]
    assert [data for data, _ in said] == [b"%d" % i for i in range(100)]
    assert len({thread for _, thread in said}) == 1
    for ear in ears:
        os.close(ear.ours)
        assert ear.next()[0] == b""


def test_what_is_asked_is_done_in_order_on_its_thread_also_while_it_closes(
    listener: DescriptorWatcher,
) -> None:
    done: list[tuple[int, int]] = []
    for i in range(1_000):
        listener.call(lambda i=i: done.append((i, threading.get_ident())))
    listener.close()
    assert [i for i, _ in done] == list(range(1_000))
    (thread,) = {thread for _, thread in done}
    assert thread != threading.get_ident()
    listener.call(lambda: done.append((-1, 0)))
    listener.close()
    assert len(done) == 1_000


def test_one_that_is_forgotten_in_the_round_in_which_it_speaks_is_not_called_any_more(
    listener: DescriptorWatcher,
) -> None:
    pipes = [os.pipe() for _ in range(2)]
    for _, ours in pipes:
        os.write(ours, b"x")  # both are there before either is watched: one round has both
    called: list[int] = []
    done = threading.Event()

    def on_readable(which: int) -> None:
        called.append(which)
        for theirs, _ in pipes:
            listener.forget(theirs)
        listener.call(done.set)

    def begin() -> None:
        for which, (theirs, _) in enumerate(pipes):
            listener.watch(theirs, lambda which=which: on_readable(which))

    listener.call(begin)
    assert done.wait(WALL_LIMIT_S)
    assert len(called) == 1
    for fd in (fd for pipe in pipes for fd in pipe):
        os.close(fd)


def test_it_starts_no_thread_before_it_is_asked_and_leaves_no_descriptor() -> None:
    descriptors, threads = psutil.Process().num_fds(), psutil.Process().num_threads()
    idle, busy = DescriptorWatcher("idle"), DescriptorWatcher("busy")
    assert psutil.Process().num_threads() == threads
    busy.call(lambda: None)
    assert psutil.Process().num_threads() == threads + 1
    for listener in (idle, busy):
        listener.close()
    # a joined thread may still be on its way out of the kernel
    deadline_s = time.monotonic() + 10.0
    while psutil.Process().num_threads() != threads:
        assert time.monotonic() < deadline_s
    assert psutil.Process().num_fds() == descriptors
