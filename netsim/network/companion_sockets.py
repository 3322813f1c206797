"""Addresses and sockets of ``eth0``, and whether a program receives at one of its UDP ports. An I/O module.

The latter is answered by Linux's socket diagnostics. A request names one datagram's addresses, and the kernel
looks up the socket that would receive it: its time does not rise with the number of sockets.

Sources: PX4 v1.17, ROMFS/px4fmu_common/init.d-posix/px4-rc.mavlink (ports of instance 0); sock_diag(7);
linux/inet_diag.h; net/ipv4/udp_diag.c, where source and destination are those of the datagram.
"""

import socket
from struct import Struct
from typing import NamedTuple

Address = tuple[str, int]

AUTOPILOT: Address = ("192.168.0.1", 14_580)
PROGRAM: Address = ("192.168.0.2", 14_540)
"""Address of ``eth0``, and the port to which the autopilot sends."""
_SOCK_DIAG = 4
"""Protocol of netlink sockets"""
_BY_FAMILY, _REQUEST = 20, 1
"""Type of the messages, and of a socket that is found; flag of a request for one socket"""
_HEADER = Struct("=IHHII")
_SOCKET = Struct("=BBxxI2s2s4s12x4s12xIII")
"""struct inet_diag_req_v2: family, protocol, states, ports, addresses, interface, cookie"""
_ANY, _NO_COOKIE = 0xFFFFFFFF, 0xFFFFFFFF
_MOST_BYTES = 4_096


class CompanionSockets(NamedTuple):
    """What this process has of one ``eth0``."""

    autopilot: socket.socket
    """UDP socket at `AUTOPILOT`"""
    interface: int
    """Index of ``eth0`` in the vehicle's namespace"""
    diagnostics: socket.socket | None
    """Of the vehicle's namespace; None: the system has none for UDP"""

    def receives(self, port: int) -> bool:
        """Whether a program receives at a port; True without diagnostics."""
        if self.diagnostics is None:
            return True
        try:
            return has_receiver(self.diagnostics, AUTOPILOT, (PROGRAM[0], port), self.interface)
        except OSError:
            return False


def open_diagnostics() -> socket.socket:
    """Return a socket for `has_receiver` in the calling thread's network namespace. Raises OSError."""
    diagnostics = socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC, _SOCK_DIAG)
    diagnostics.settimeout(1.0)  # the kernel answers before the request returns
    return diagnostics


def has_receiver(diagnostics: socket.socket, source: Address, destination: Address, interface: int) -> bool:
    """Whether a socket would receive a datagram that arrives at an interface, which has this index.

    False where the system has no diagnostics of UDP. Raises OSError.
    """
    request = _SOCKET.pack(
        socket.AF_INET, socket.IPPROTO_UDP, _ANY,
        source[1].to_bytes(2, "big"), destination[1].to_bytes(2, "big"),
        socket.inet_aton(source[0]), socket.inet_aton(destination[0]),
        interface, _NO_COOKIE, _NO_COOKIE,
    )  # fmt: skip
    diagnostics.send(_HEADER.pack(_HEADER.size + len(request), _BY_FAMILY, _REQUEST, 0, 0) + request)
    _, kind, *_ = _HEADER.unpack_from(diagnostics.recv(_MOST_BYTES))
    return bool(kind == _BY_FAMILY)
