"""Attempts to open a run's files, sockets and processes. An I/O module."""

import os
import socket
import threading
from collections import Counter

from studies.attacks.tasks import OpenEverything, Report

PROBE = ".probe"
"""File that is made in a folder that can be written."""


def open_everything(task: OpenEverything, ended: threading.Event) -> Report:  # noqa: ARG001
    """Try everything once; what succeeds is in the report's findings."""
    found, counts = list[str](), Counter[str]()
    for path in task.paths:
        counts["files and folders"] += 1
        if _can_open(path, os.O_RDONLY):
            found.append(f"reads {path}")
        if _can_write(path):
            found.append(f"writes {path}")
    for path in task.sockets:
        counts["sockets"] += 1
        if _can_connect(path):
            found.append(f"connects to {path}")
    for pid in task.pids:
        counts["processes"] += 1
        if _can_signal(pid):
            found.append(f"can signal process {pid}")
    return Report(counts=dict(counts), found=found)


def _can_open(path: str, flags: int) -> bool:
    try:
        os.close(os.open(path, flags | os.O_NONBLOCK))
    except OSError:
        return False
    return True


def _can_write(path: str) -> bool:
    """Whether a file can be opened to be written, or a file can be made in a folder."""
    if not os.path.isdir(path):  # noqa: PTH112  also of a path that cannot be read
        return _can_open(path, os.O_WRONLY)
    probe = os.path.join(path, PROBE)  # noqa: PTH118
    if not _can_open(probe, os.O_WRONLY | os.O_CREAT | os.O_EXCL):
        return False
    os.unlink(probe)  # noqa: PTH108
    return True


def _can_connect(path: str) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
        sock.settimeout(2.0)
        try:
            sock.connect(path)
        except OSError:
            return False
        return True


def _can_signal(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    return True
