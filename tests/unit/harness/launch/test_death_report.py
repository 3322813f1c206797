"""What is quoted of a process that ended, and how a signal and a full disk are named."""

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from harness.launch import death_report
from harness.launch.death_report import ending, is_full, last_words

BANNER = "pybullet build time: May 4"
TRACE = """Fatal Python error: Segmentation fault

Thread 0x00007f (most recent call first):
  File "/lib/threading.py", line 5 in wait

Current thread 0x00007e (most recent call first):
  File "/code/world.py", line 12 in step
  File "/code/server.py", line 99 in main

Extension modules: numpy._core, pybullet (total: 2)""".splitlines()
CRASH = "Fatal Python error: Segmentation fault, in step (line 12 of /code/world.py)"


@pytest.mark.parametrize(
    ("lines", "returncode", "words"),
    [
        ([BANNER], -signal.SIGKILL, ""),
        ([BANNER, *TRACE], -signal.SIGSEGV, CRASH),
        (["ERROR no route", BANNER, *TRACE], -signal.SIGSEGV, f"ERROR no route; {CRASH}"),
        ([*TRACE, "later"], -signal.SIGKILL, CRASH),
        (TRACE[:1], -signal.SIGABRT, "Fatal Python error: Segmentation fault"),
        (["ERROR no route", "note"], None, "ERROR no route"),
        (["uav: no such airframe"], 2, "uav: no such airframe"),
        (["ERROR one", "ERROR two", "ERROR three", "last"], 1, "ERROR two; ERROR three; last"),
        ([], 1, ""),
    ],
)
def test_only_errors_are_quoted(lines: list[str], returncode: int | None, words: str) -> None:
    assert last_words(lines, returncode) == words


def test_a_real_crash_is_quoted_with_its_innermost_line() -> None:
    code = "import ctypes\ndef crash():\n    ctypes.string_at(0)\ncrash()"
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", code],
        stderr=subprocess.PIPE, text=True, check=False, preexec_fn=_no_core,
    )  # fmt: skip
    assert done.returncode == -signal.SIGSEGV
    words = last_words(done.stderr.splitlines(), done.returncode)
    assert words.startswith("Fatal Python error: Segmentation fault, in string_at (line ")


def _no_core() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def test_signals_are_named_in_words() -> None:
    assert ending(-signal.SIGBUS) == "was killed by SIGBUS (bus error)"
    assert ending(-signal.SIGTERM) == "was killed by SIGTERM (terminated)"
    assert ending(None) == "ended with unknown status"


@pytest.mark.parametrize(
    ("number", "beginning"),
    [
        (errno.ENOSPC, "no space left on the device of"),
        (errno.EDQUOT, "the disk quota is exceeded in"),
        (errno.EFBIG, "a file has reached the limit of sizes (ulimit -f) in"),
    ],
)
def test_a_full_disk_is_recognised_by_words_and_by_a_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, beginning: str
) -> None:
    assert is_full(tmp_path, f"physics: raw/truth.bin: {os.strerror(number)}") == beginning
    assert is_full(tmp_path, "physics: the world has ended") is None
    assert list(tmp_path.iterdir()) == []

    def full(**_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(death_report.tempfile, "TemporaryFile", full)
    assert is_full(tmp_path, "") == beginning


def test_kills_for_lack_of_memory_are_counted() -> None:
    assert death_report.memory_kills() >= 0
