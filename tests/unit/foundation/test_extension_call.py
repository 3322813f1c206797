"""Calls of the user's code: exceptions, endless loops, calls that block, and memory."""

import re
import threading
import time

import pytest

from foundation import extension_call
from foundation.extension_call import ExtensionCall, watched
from foundation.extension_failure import ExtensionFailure

LIMIT_S = 1.0


def never(line):
    raise AssertionError(line)


def test_an_exception_becomes_one_line_with_title_and_place():
    call = ExtensionCall("field code")
    line = r"^field code: ValueError: of two lines \(.*test_extension_call\.py:\d+\)$"
    with pytest.raises(ExtensionFailure, match=line), call:
        raise ValueError("of two\nlines")
    with call:  # it can be called again
        pass


def test_a_failure_keeps_its_line_and_a_keyboard_interrupt_is_none():
    call = ExtensionCall("field code")
    with pytest.raises(ExtensionFailure, match=r"^wrong$"), call:
        raise ExtensionFailure("wrong")
    with pytest.raises(KeyboardInterrupt), call:
        raise KeyboardInterrupt


def test_an_endless_loop_is_ended_before_the_limit():
    call, begin_s = ExtensionCall("field code"), time.monotonic()
    line = r"^field code: CallEnded: the call has not returned for 0\.\d s \(.*test_extension_call\.py:\d+\)$"
    with watched(LIMIT_S, on_stuck=never), pytest.raises(ExtensionFailure, match=line):
        loop_in(call)
    assert time.monotonic() - begin_s >= extension_call.ENDED_SHARE * LIMIT_S


def test_a_call_that_gets_no_processor_is_awaited(monkeypatch):
    """Here for nine tenths of the time; the call takes four times the limit of wall time."""
    begin_s = time.monotonic()
    monkeypatch.setattr(extension_call, "_starved_s", lambda _: 0.9 * (time.monotonic() - begin_s))
    call = ExtensionCall("field code")
    with watched(LIMIT_S, on_stuck=never), call:
        while time.monotonic() - begin_s < 4.0 * LIMIT_S:
            pass


def test_the_time_without_a_processor_is_that_of_the_scheduler():
    ended, native_id = threading.Event(), []

    def compute():
        native_id.append(threading.get_native_id())
        while not ended.is_set():
            pass

    thread = threading.Thread(target=compute)
    thread.start()
    while not native_id:
        time.sleep(0.001)
    before_s, begin_s = extension_call._starved_s(native_id[0]), time.monotonic()
    time.sleep(0.2)
    starved_s, elapsed_s = extension_call._starved_s(native_id[0]) - before_s, time.monotonic() - begin_s
    ended.set()
    thread.join()
    assert 0.0 <= starved_s <= elapsed_s
    assert extension_call._starved_s(-1) == 0.0


def test_a_call_that_blocks_is_reported():
    lines, call = [], ExtensionCall("field code")
    with watched(LIMIT_S, on_stuck=lines.append), pytest.raises(ExtensionFailure), call:
        time.sleep(2.0 * LIMIT_S)
    (line,) = lines
    assert re.fullmatch(r"field code: a call has not returned for (0\.9|1\.\d) s, and cannot be ended", line)


def test_many_short_calls_are_neither_ended_nor_reported():
    call, end_s = ExtensionCall("field code"), time.monotonic() + 2.0 * LIMIT_S
    with watched(LIMIT_S, on_stuck=never):
        while time.monotonic() < end_s:
            with call:
                time.sleep(0.01)


@pytest.fixture
def _small(monkeypatch):
    monkeypatch.setattr(extension_call, "MOST_BYTES", 64 << 20)
    monkeypatch.setattr(extension_call, "MEASURED_BYTES", 48 << 20)


@pytest.mark.usefixtures("_small")
def test_the_caller_that_takes_most_memory_is_ended():
    line = r"^large: its calls have taken more than 64 MiB of memory$"
    with watched(1e3, on_stuck=never), pytest.raises(ExtensionFailure, match=line):
        take_in_turns(ExtensionCall("large"), ExtensionCall("small"))


@pytest.mark.usefixtures("_small")
def test_a_call_that_takes_memory_without_bound_is_ended():
    line = r"^field code: CallEnded: its calls have taken more than 64 MiB of memory \("
    with watched(1e3, on_stuck=never), pytest.raises(ExtensionFailure, match=line):
        take_in(ExtensionCall("field code"))


def loop_in(call):
    with call:
        while True:
            pass


def take_in(call):
    taken = []
    with call:
        while len(taken) < 10_000:
            taken.append(bytearray(b"x") * 100_000)
            time.sleep(0.001)


def take_in_turns(large, small):
    taken, end_s = [], time.monotonic() + 30.0
    while time.monotonic() < end_s:
        with large:
            taken.append(bytearray(b"x") * 500_000)
        with small:
            taken.append(bytearray(b"x") * 50_000)
        time.sleep(0.01)
