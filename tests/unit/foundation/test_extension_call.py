"""Calls of the user's code: exceptions, endless loops, calls that block, and memory."""

import ast
import os
import re
import threading
import time
from functools import partial

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


def scheduled(share):
    """Return a stand-in for the scheduler's account of a thread that gets a share of a processor."""
    begin_s = time.monotonic()

    def scheduling_s(_native_id):
        elapsed_s = time.monotonic() - begin_s
        return share * elapsed_s, (1.0 - share) * elapsed_s

    return scheduling_s


def test_a_call_that_gets_no_processor_is_awaited(monkeypatch):
    """The call takes four times the limit of wall time."""
    monkeypatch.setattr(extension_call, "_scheduling_s", scheduled(0.1))
    call, begin_s = ExtensionCall("field code"), time.monotonic()
    with watched(LIMIT_S, on_stuck=never), call:
        while time.monotonic() - begin_s < 4.0 * LIMIT_S:
            pass


def test_an_endless_loop_is_ended_by_its_processor_time_on_a_busy_machine(monkeypatch):
    monkeypatch.setattr(extension_call, "_scheduling_s", scheduled(0.25))
    call, begin_s = ExtensionCall("field code"), time.monotonic()
    with watched(LIMIT_S, on_stuck=never), pytest.raises(ExtensionFailure, match="has not returned for"):
        loop_in(call)
    assert time.monotonic() - begin_s >= 2.0 * extension_call.ENDED_SHARE * LIMIT_S


def measured_shares():
    """Return the shares of time in which this thread computes with and waits for a processor."""
    scheduling = partial(extension_call._scheduling_s, threading.get_native_id())
    (ran_s, starved_s), begin_s = scheduling(), time.monotonic()
    while time.monotonic() - begin_s < 0.5:
        pass
    (ran_after_s, starved_after_s), elapsed_s = scheduling(), time.monotonic() - begin_s
    return (ran_after_s - ran_s) / elapsed_s, (starved_after_s - starved_s) / elapsed_s


def test_the_account_of_a_thread_is_the_schedulers_and_complete():
    """Two processes share a processor, one of them forked as a vehicle is: both have all of the time."""
    processors = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(processors)})
    try:
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.write(writer, repr(measured_shares()).encode())
            finally:
                os._exit(0)
        own = measured_shares()
        os.waitpid(child, 0)
        forked = ast.literal_eval(os.read(reader, 200).decode())
    finally:
        os.sched_setaffinity(0, processors)
        os.close(reader)
        os.close(writer)
    for ran, starved in (own, forked):
        assert starved > 0.1
        assert ran + starved == pytest.approx(1.0, abs=0.1)
    assert extension_call._scheduling_s(-1) == (0.0, 0.0)


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
