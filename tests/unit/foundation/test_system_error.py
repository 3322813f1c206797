"""Errors of the operating system in words, without their numbers."""

import errno
import socket

import pytest

from foundation.system_error import described, in_words


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (FileNotFoundError(errno.ENOENT, "No such file", "a.toml"), "a.toml: No such file or directory"),
        (OSError(errno.ENOSPC, "not written: [errno 28] No space left on device"), "No space left on device"),
        (ConnectionError("the emulator is silent"), "the emulator is silent"),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "Name or service not known"),
        (TimeoutError(), "TimeoutError"),
    ],
)
def test_file_and_cause(error, words):
    assert in_words(error) == words


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("wrong\nand more"), "ValueError: wrong"),
        (ValueError(), "ValueError"),
        (OSError(errno.ENOSPC, "No space left"), "No space left on device"),
    ],
)
def test_any_error_in_one_line(error, line):
    assert described(error) == line
