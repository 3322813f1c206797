"""What a run needs of its machine: ports, sockets and file descriptors; had, or refused in one line.

An edge. Of memory and processors a run takes what there is.
"""

import os
import resource
import socket
import sys
from pathlib import Path

HAS_NAMED_SOCKETS = sys.platform == "linux"
"""Whether Unix sockets may have a name that is no file's."""
DESCRIPTORS_OF_CHILD = 3
"""That its launcher holds: its stdin and stdout, and one that tells of its end."""
DESCRIPTORS_BESIDE = 64
"""What any process of a run has open beside those of children or vehicles: files, libraries, a selector."""


class ResourceError(Exception):
    """Something cannot be had; the text is one line and names it."""


class PortError(ResourceError):
    """A port cannot be had; the text names it."""


def bind(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    """Socket bound to the address, 0 for a free port; a TCP socket listens.

    Raises PortError with the address.
    """
    sock = socket.socket(socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM:
            # ports of connections that ended a minute ago are free; a listener's is refused all the same
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
        if kind == socket.SOCK_STREAM:
            sock.listen()
    except OSError as error:
        sock.close()
        protocol = "TCP" if kind == socket.SOCK_STREAM else "UDP"
        raise PortError(f"{protocol} port {port} on {host}: {os.strerror(error.errno or 0)}") from None
    return sock


def bind_local(name: str, *, backlog: int) -> socket.socket:
    """Unix socket that listens by a name that is no file's (`HAS_NAMED_SOCKETS`). Raises OSError."""
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        sock.bind(f"\0{name}")
        sock.listen(backlog)
    except OSError:
        sock.close()
        raise
    return sock


def open_descriptors() -> int:
    """How many this process has open."""
    return len(list(Path("/dev/fd").iterdir()))


def allow_descriptors(children: int) -> None:
    """Raise this process's limit as far as a run of so many children needs it, which they inherit.

    A launcher holds `DESCRIPTORS_OF_CHILD` for each; the physics server and the 802.11 emulator hold two for
    each vehicle, which is less. Raises ResourceError where the system allows no more.
    """
    needed = open_descriptors() + DESCRIPTORS_BESIDE + DESCRIPTORS_OF_CHILD * children
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
    except (ValueError, OSError):  # more than the hard limit, or than a system without one knows
        allowed = "this system allows no more" if hard == resource.RLIM_INFINITY else f"the limit is {hard}"
        raise ResourceError(
            f"{children} processes take {needed} file descriptors, and {allowed} (ulimit -Hn)"
        ) from None
