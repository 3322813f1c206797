"""One thread watches many descriptors, runs requests in order, and leaves nothing open."""

import os
import queue
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.launch.descriptor_watcher import DescriptorWatcher

WALL_LIMIT_S = 20.0


@pytest.fixture
def watcher() -> Iterator[DescriptorWatcher]:
    watcher = DescriptorWatcher("test watcher")
    yield watcher
    watcher.close()


def open_descriptors() -> set[str]:
    """Return the numbers of this process's open descriptors, without that of the folder that lists them."""
    return {path.name for path in list(Path("/proc/self/fd").iterdir()) if path.is_symlink()}


class WatchedPipe:
    """A watched pipe: yields every chunk with the thread that read it."""

    def __init__(self, watcher: DescriptorWatcher) -> None:
        self.received: queue.SimpleQueue[tuple[bytes, int]] = queue.SimpleQueue()
        self._watcher = watcher
        self._theirs, self.ours = os.pipe()
        watcher.call(lambda: watcher.watch(self._theirs, self._read))

    def _read(self) -> None:
        data = os.read(self._theirs, 100)
        if not data:
            self._watcher.forget(self._theirs)
            os.close(self._theirs)
        self.received.put((data, threading.get_ident()))

    def next(self) -> tuple[bytes, int]:
        return self.received.get(timeout=WALL_LIMIT_S)


def test_one_thread_watches_many_descriptors_until_they_end(watcher: DescriptorWatcher) -> None:
    threads = set(threading.enumerate())
    pipes = [WatchedPipe(watcher) for _ in range(100)]
    assert len(set(threading.enumerate()) - threads) == 1
    for i, pipe in enumerate(pipes):
        os.write(pipe.ours, b"%d" % i)
    chunks = [pipe.next() for pipe in pipes]
    assert [data for data, _ in chunks] == [b"%d" % i for i in range(100)]
    assert len({thread for _, thread in chunks}) == 1
    for pipe in pipes:
        os.close(pipe.ours)
        assert pipe.next()[0] == b""


def test_requests_run_in_order_on_its_thread_also_while_it_closes(
    watcher: DescriptorWatcher,
) -> None:
    done: list[tuple[int, int]] = []
    for i in range(1_000):
        watcher.call(lambda i=i: done.append((i, threading.get_ident())))
    watcher.close()
    assert [i for i, _ in done] == list(range(1_000))
    (thread,) = {thread for _, thread in done}
    assert thread != threading.get_ident()
    watcher.call(lambda: done.append((-1, 0)))
    watcher.close()
    assert len(done) == 1_000


def test_a_descriptor_that_was_removed_in_the_same_round_is_not_called(
    watcher: DescriptorWatcher,
) -> None:
    pipes = [os.pipe() for _ in range(2)]
    for _, ours in pipes:
        os.write(ours, b"x")  # both are readable before either is watched: one round has both
    called: list[int] = []
    done = threading.Event()

    def on_readable(which: int) -> None:
        called.append(which)
        for theirs, _ in pipes:
            watcher.forget(theirs)
        watcher.call(done.set)

    def begin() -> None:
        for which, (theirs, _) in enumerate(pipes):
            watcher.watch(theirs, lambda which=which: on_readable(which))

    watcher.call(begin)
    assert done.wait(WALL_LIMIT_S)
    assert len(called) == 1
    for fd in (fd for pipe in pipes for fd in pipe):
        os.close(fd)


def test_it_starts_no_thread_before_the_first_request_and_leaves_no_descriptor() -> None:
    """By set instead of count, since threads and descriptors of earlier tests may end meanwhile."""
    descriptors, threads = open_descriptors(), set(threading.enumerate())
    idle, busy = DescriptorWatcher("idle"), DescriptorWatcher("busy")
    assert set(threading.enumerate()) <= threads
    busy.call(lambda: None)
    started = set(threading.enumerate()) - threads
    assert len(started) == 1
    for watcher in (idle, busy):
        watcher.close()
    assert not any(thread.is_alive() for thread in started)
    assert open_descriptors() <= descriptors
