"""Standard output and error of a program whose reader may go away, as ``| head -1`` and closed terminals do.

The program is then to go on: what it does is worth more than what it prints.
"""

import contextlib
import errno
import io
import os
import sys
from collections.abc import Iterator
from typing import TextIO

_READER_GONE = frozenset({errno.EPIPE, errno.EIO, errno.ENXIO, errno.EBADF})
"""Errors of a closed pipe, a closed terminal (two) and a closed descriptor."""


class LastingStream(io.TextIOBase):
    """A text stream whose writes do not fail; after the first error the rest of the output is dropped.

    Its file descriptor then is that of the null device, so that output of libraries does not fail either.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.lost: OSError | None = None
        """Why output was lost that has a reader, as a file on a full disk."""

    @property
    def encoding(self) -> str:  # type: ignore[override]  # a plain attribute of the base
        """Encoding of the stream."""
        return self._stream.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]  # a plain attribute of the base
        """How encoding errors are handled."""
        return self._stream.errors

    @property
    def buffer(self) -> object:
        """The binary stream below."""
        return self._stream.buffer

    def write(self, text: str) -> int:
        """Write a text, or drop it; returns its length."""
        try:
            return self._stream.write(text)
        except OSError as error:
            self._drop_output(error)
            return len(text)

    def flush(self) -> None:
        """Write what is buffered, or drop it."""
        try:
            self._stream.flush()
        except OSError as error:
            self._drop_output(error)

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._stream.fileno()

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self._stream.isatty()

    def writable(self) -> bool:
        """Return True."""
        return True

    def _drop_output(self, error: OSError) -> None:
        if error.errno not in _READER_GONE:
            self.lost = self.lost or error
        with contextlib.suppress(OSError, ValueError):
            to_null(self._stream.fileno())
            self._stream.flush()  # of what the failed write has left in the buffer


def to_null(descriptor: int) -> None:
    """Make a file descriptor that of the null device, which child processes inherit."""
    null = os.open(os.devnull, os.O_RDWR)
    if null == descriptor:
        os.set_inheritable(null, True)  # noqa: FBT003
    else:
        os.dup2(null, descriptor)
        os.close(null)


def open_missing() -> None:
    """Open the null device as each standard stream that is closed, before a file takes its number."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            to_null(descriptor)
    sys.stdin = sys.stdin or open(0, encoding="utf-8")  # noqa: SIM115  standard streams stay open
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8")  # noqa: SIM115


@contextlib.contextmanager
def lasting_output() -> Iterator[None]:
    """Let standard output and error of the block outlast their readers.

    Other errors do not end the block either: raises the first OSError, as of a full disk, after the block.
    """
    before = sys.stdout, sys.stderr
    lasting = [LastingStream(stream) for stream in before]
    sys.stdout, sys.stderr = lasting
    try:
        yield
    finally:
        for stream in lasting:
            stream.flush()
        sys.stdout, sys.stderr = before
    for stream in lasting:
        if stream.lost is not None:
            raise stream.lost
