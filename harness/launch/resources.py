"""Resources of a run: ports, sockets and file descriptors, or an error in one line.

An I/O module. Memory and processors are not limited.
"""

import errno
import os
import resource
import socket
from pathlib import Path

BACKLOG = 1_024
"""Connections that a listener holds until they are accepted; the kernel's limit may be lower."""
DESCRIPTORS_OF_CHILD = 3
"""Descriptors that the launcher holds per child: its stdin, its stdout, and one that signals its end."""
DESCRIPTORS_BESIDE = 64
"""Further descriptors of any process of a run: files, libraries, a selector."""


class ResourceError(Exception):
    """A resource is not available; the text is one line and names it."""

    def __init__(self, line: str, *, in_use: bool = False) -> None:
        super().__init__(line)
        self.in_use = in_use
        """Whether it is an address that another socket has."""


def bind(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    """Return a socket bound to the address, port 0 for a free one; a TCP socket listens.

    Raises ResourceError with the address.
    """
    sock = socket.socket(socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM:
            # allows ports of connections that ended a minute ago; a port in use is refused nevertheless
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
        if kind == socket.SOCK_STREAM:
            sock.listen(BACKLOG)
    except OSError as error:
        sock.close()
        protocol = "TCP" if kind == socket.SOCK_STREAM else "UDP"
        raise _not_bound(protocol, host, port, error) from None
    return sock


def reserve_udp(host: str, port: int) -> socket.socket:
    """Return a socket that keeps other swarms of this machine from a UDP port, which stays free to be bound.

    It has a name in Linux's abstract namespace, which ends with it. Raises ResourceError as `bind`, if
    another swarm has reserved the port or a program has bound it.
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        sock.bind(f"\0coflight-udp-{host}-{port}")
        bind(socket.SOCK_DGRAM, host, port).close()
    except OSError as error:
        sock.close()
        raise _not_bound("UDP", host, port, error) from None
    except ResourceError:
        sock.close()
        raise
    return sock


def _not_bound(protocol: str, host: str, port: int, error: OSError) -> ResourceError:
    line = f"{protocol} port {port} on {host}: {os.strerror(error.errno or 0)}"
    return ResourceError(line, in_use=error.errno == errno.EADDRINUSE)


def open_descriptors() -> int:
    """Return the number of descriptors that this process has open."""
    return len(list(Path("/dev/fd").iterdir()))


def allow_descriptors(children: int) -> None:
    """Raise the limit of descriptors to what a run with that many children needs; they inherit it.

    The launcher holds `DESCRIPTORS_OF_CHILD` per child: of a vehicle that has not started yet, both ends of
    its link to the simulator and the socket that reserves a UDP port. The physics server and the 802.11
    emulator hold two per vehicle at most. Raises ResourceError if the system does not allow as many.
    """
    needed = open_descriptors() + DESCRIPTORS_BESIDE + DESCRIPTORS_OF_CHILD * children
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
    except (ValueError, OSError):  # above the hard limit, or above the kernel's
        allowed = "this system allows no more" if hard == resource.RLIM_INFINITY else f"the limit is {hard}"
        raise ResourceError(
            f"{children} processes take {needed} file descriptors, and {allowed} (ulimit -Hn)"
        ) from None
