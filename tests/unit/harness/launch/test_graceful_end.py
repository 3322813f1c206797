"""Processes that were asked to end: how long each is waited for."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from harness.launch import graceful_end
from harness.launch.graceful_end import POLL_S, wait_for_ends

LIMIT_S = 1.0


@pytest.fixture
def start():
    processes = []

    def make(code):
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
        processes.append(process)
        ended = threading.Event()
        threading.Thread(target=lambda: (process.wait(), ended.set()), daemon=True).start()
        assert process.stdout.readline() == b"ready\n"
        return process, ended

    yield make
    for process in processes:
        process.kill()
        process.stdout.close()
        process.wait(10.0)


def waited_s(*started, limit_s=LIMIT_S):
    begin_s = time.monotonic()
    wait_for_ends({process.pid: ended for process, ended in started}, limit_s)
    return time.monotonic() - begin_s


def test_it_returns_when_all_have_ended(start):
    quick = start("import time; print('ready', flush=True); time.sleep(0.5)")
    slow = start("import time; print('ready', flush=True); time.sleep(1.0)")
    waited_s(quick, slow, limit_s=60.0)
    assert quick[1].is_set()
    assert slow[1].is_set()


def test_a_process_that_sleeps_is_given_up_after_the_limit(start):
    idle = start("import time; print('ready', flush=True); time.sleep(600)")
    assert waited_s(idle) >= LIMIT_S
    assert not idle[1].is_set()


def test_a_process_that_computes_has_longer_than_one_that_sleeps(start):
    busy = start("print('ready', flush=True)\nimport time\nend = time.process_time() + 3.0\n"
                 "while time.process_time() < end: pass")  # fmt: skip
    waited_s(busy)
    assert busy[1].is_set()


def test_a_stopped_process_is_given_up_at_once(start):
    held = start("import time; print('ready', flush=True); time.sleep(600)")
    os.kill(held[0].pid, signal.SIGSTOP)
    assert waited_s(held, limit_s=60.0) < 60.0
    assert not held[1].is_set()


def test_the_whole_wait_is_limited(start, monkeypatch):
    monkeypatch.setattr(graceful_end, "LONGEST_S", 2.0 * POLL_S)
    idle = start("import time; print('ready', flush=True); time.sleep(600)")
    assert waited_s(idle, limit_s=600.0) < 600.0
