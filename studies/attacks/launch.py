"""Start of programs that attack, as this user or as another. An I/O module."""

import contextlib
import os
import subprocess
import sys
import tempfile
from typing import Self

import msgspec

from studies.attacks.attack_program import BEGUN, OTHER_UID
from studies.attacks.tasks import Order, Report, Task

END_LIMIT_S = 60.0
"""Wall time from the request to end to the end."""


class AttackError(Exception):
    """A program that attacks has failed itself; the text is its last line."""


def can_be_another() -> bool:
    """Whether this process may start programs as another user."""
    return os.geteuid() == 0


class AttackProcess:
    """A running attack; ended with its block. Raises AttackError if it does not begin."""

    def __init__(self, task: Task, *, is_other: bool) -> None:
        self._messages = tempfile.TemporaryFile()  # noqa: SIM115  closed with its block; a full pipe holds a program
        self._process = subprocess.Popen(
            [sys.executable, "-m", "studies.attacks.attack_program"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._messages,
            bufsize=0,  # else the first line is read with a part of the report
        )
        order = Order(task=task, uid=OTHER_UID if is_other else None)
        self._write(msgspec.json.encode(order) + b"\n")
        assert self._process.stdout is not None  # noqa: S101  it is a pipe
        if self._process.stdout.readline().strip() != BEGUN.encode():
            self._process.kill()
            self._process.communicate()
            error = AttackError(self._last_line())
            self._messages.close()
            raise error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()
        self._messages.close()

    @property
    def is_running(self) -> bool:
        """Whether it attacks."""
        return self._process.poll() is None

    def report(self) -> Report:
        """End the attack and return its report. Raises AttackError."""
        try:
            output, _ = self._process.communicate(timeout=END_LIMIT_S)
        except subprocess.TimeoutExpired:
            raise AttackError(f"an attack does not end within {END_LIMIT_S:g} s") from None
        if self._process.returncode != 0:
            raise AttackError(self._last_line())
        return msgspec.json.decode(output, type=Report)

    def _write(self, data: bytes) -> None:
        assert self._process.stdin is not None  # noqa: S101  it is a pipe
        with contextlib.suppress(BrokenPipeError):  # its messages say why
            self._process.stdin.write(data)
            self._process.stdin.flush()

    def _last_line(self) -> str:
        self._messages.seek(0)
        lines = self._messages.read().decode(errors="replace").strip().splitlines()
        return f"an attack has ended with status {self._process.returncode}: {lines[-1] if lines else ''}"
