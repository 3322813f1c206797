"""Folders of the runs of tests: one for each swarm, named after its test, claimed while the test runs.

A test has the same folders in every session, so a kept one is replaced when the test runs again. A locked
file, of the same name in ``.claims``, keeps others from it: other swarms of the test, sessions, and workers
of pytest-xdist. Only their owner can read them.
"""

import contextlib
import fcntl
import hashlib
import itertools
import os
import re
import shutil
from pathlib import Path
from typing import NamedTuple

from foundation.records.private_files import FILE_MODE, make_private

_CLAIMS = ".claims"
_GIT_IGNORE = "# Created by coflight.\n*\n"
_LONGEST_NAME = 80


class RunPlace(NamedTuple):
    """A free path for the folder of one run, claimed until it is kept or removed."""

    path: Path
    claim_fd: int

    @property
    def is_empty(self) -> bool:
        """Whether no run was started in it, or the test has removed it."""
        return not self.path.exists()

    def keep(self) -> None:
        """Release the folder with its content."""
        _claim_file(self.path).unlink(missing_ok=True)
        os.close(self.claim_fd)

    def remove(self) -> None:
        """Remove the folder as far as possible."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.keep()


def name_of(nodeid: str) -> str:
    """Return the name of a test's folder: readable words, and a hash because they are not unique."""
    path, _, rest = nodeid.partition("::")
    words = re.sub(r"[^A-Za-z0-9_.=+]+", "-", f"{Path(path).stem}-{rest}")
    return f"{words[:_LONGEST_NAME].strip('-.')}-{hashlib.sha256(nodeid.encode()).hexdigest()[:8]}"


def claim(out: Path, nodeid: str) -> RunPlace:
    """Return a free path in ``out`` for a swarm of the test. Raises OSError.

    The first swarm of a test also removes what earlier sessions have kept of it.
    """
    if not out.exists():
        make_private(out, exist_ok=True)
        (out / ".gitignore").write_text(_GIT_IGNORE, encoding="utf-8")
    name = name_of(nodeid)
    for number in itertools.count(1):
        path = out / (name if number == 1 else f"{name}-{number}")
        claim_fd = _claimed(path)
        if claim_fd is None:
            continue
        if number == 1:
            for other in sorted(out.glob(f"{name}-*")):
                if (other_fd := _claimed(other)) is not None:
                    RunPlace(other, other_fd).remove()
        if path.exists():
            shutil.rmtree(path)
        return RunPlace(path, claim_fd)
    raise AssertionError


def shown(path: Path, base: Path) -> str:
    """Return a path relative to ``base`` if it is below it."""
    return os.fspath(path.relative_to(base) if path.is_relative_to(base) else path)


def tidy(out: Path) -> None:
    """Remove the folder if `claim` has created it and nothing was kept."""
    ignored = out / ".gitignore"
    with contextlib.suppress(OSError):
        (out / _CLAIMS).rmdir()
        if list(out.iterdir()) == [ignored] and ignored.read_text(encoding="utf-8") == _GIT_IGNORE:
            ignored.unlink()
            out.rmdir()


def _claim_file(path: Path) -> Path:
    return path.parent / _CLAIMS / path.name


def _claimed(path: Path) -> int | None:
    """Claim the folder; returns the descriptor of the lock, None if the folder is in use."""
    claim = _claim_file(path)
    make_private(claim.parent, exist_ok=True)
    try:
        claim_fd = os.open(claim, os.O_RDWR | os.O_CREAT, FILE_MODE)
    except FileNotFoundError:  # `tidy` of another session
        return None
    with contextlib.suppress(BlockingIOError, FileNotFoundError):
        fcntl.flock(claim_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(claim_fd), claim.stat()):
            return claim_fd
    os.close(claim_fd)
    return None
