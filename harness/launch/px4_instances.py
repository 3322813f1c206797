"""Instance numbers of PX4s on this machine. An I/O module.

All files and ports of a PX4 process are named by its instance number: a lock, a socket for its shell, and UDP
and TCP ports. Two processes of one number cannot run, whichever swarm and user they belong to.
"""

import contextlib
import fcntl
import os
import socket
import struct
from collections.abc import Iterable
from pathlib import Path

from harness.launch.resources import ResourceError, bind

LOCK, SHELL = "px4_lock-", "px4-sock-"
"""Names of PX4's files in `FOLDER`, before the instance number."""
FOLDER = Path("/tmp")  # noqa: S108
LINK_PORTS = (14_280, 13_030)
"""Local UDP ports of the links to camera and gimbal, to which the instance number is added."""
_FLOCK = struct.Struct("@hhqqi4x")
"""struct flock of Linux: type, whence, start, length, process."""


def check_free(instance: int, host: str) -> None:
    """Check that no PX4 of this number is in the way. Raises ResourceError with what is."""
    lock, shell = FOLDER / f"{LOCK}{instance}", FOLDER / f"{SHELL}{instance}"
    owner = _locked_by(lock)
    if owner is not None:
        raise ResourceError(f"PX4 instance {instance} is running as process {owner}", in_use=True)
    for path in (lock, shell):
        if path.exists() and os.geteuid() not in (0, path.stat().st_uid):
            line = f"{path}: of another user's PX4 of the same number; if it has ended, remove the file"
            raise ResourceError(line, in_use=True)
    for base in LINK_PORTS:
        bind(socket.SOCK_DGRAM, host, base + instance).close()


def remove_files(instances: Iterable[int]) -> None:
    """Remove the files that PX4s of these numbers leave when they end, except those of running ones."""
    for instance in instances:
        lock = FOLDER / f"{LOCK}{instance}"
        if _locked_by(lock) is None:
            for path in (FOLDER / f"{SHELL}{instance}", lock):
                with contextlib.suppress(OSError):
                    path.unlink(missing_ok=True)


def _locked_by(path: Path) -> int | None:
    """Return the process that has locked a file; None if there is none, or the file is another user's."""
    try:
        descriptor = os.open(path, os.O_RDWR)
    except OSError:
        return None
    try:
        found = fcntl.fcntl(descriptor, fcntl.F_GETLK, _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0))
        kind, _, _, _, process = _FLOCK.unpack(found)
    finally:
        os.close(descriptor)
    return None if kind == fcntl.F_UNLCK else int(process)
