"""A non-blocking UDP socket that reports unreachable destinations and checks the owners of others. Does I/O.

Whether a partner listens is reported by the kernel: on Linux a datagram to a closed port causes an error that
contains the address. So no timeout is needed.

A port of the loopback interface can be used by every user of the machine. With `DatagramOwners` a socket
communicates there only with sockets of its own user or root.
"""

import contextlib
import socket
import struct
import sys
import time

from foundation.processes.socket_owners import DatagramOwners

Address = tuple[str, int]

MAX_RECEIVED_DATAGRAM_BYTES = 2_048
"""Longer datagrams are truncated to one byte more: MAVLink senders keep within one Ethernet frame."""
_MOST_ERRORS = 64
"""Errors of earlier datagrams that one call passes over at most."""
_IP_RECVERR = 11  # linux/in.h; not in the socket module of CPython 3.11
_SO_MEMINFO = 55  # asm-generic/socket.h
_MEMINFO = struct.Struct("=9I")  # linux/sock_diag.h: the last is SK_MEMINFO_DROPS


class UdpSocket:
    """A socket at ``host:local_port`` (0: any free port). Raises OSError if the port is in use.

    ``default`` is an address that is sent to without having sent anything; None: there is none.
    """

    def __init__(
        self,
        host: str,
        local_port: int,
        *,
        default: Address | None = None,
        owners: DatagramOwners | None = None,
    ) -> None:
        self.defaults = () if default is None else (default,)
        self._owners = owners
        self._unreachable: list[Address] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.settimeout(0.0)  # non-blocking
            if sys.platform == "linux":
                self._socket.setsockopt(socket.IPPROTO_IP, _IP_RECVERR, 1)
            self._socket.bind((host, local_port))
        except OSError:
            self._socket.close()
            raise

    @property
    def local_port(self) -> int:
        """The port that the socket is bound to."""
        port: int = self._socket.getsockname()[1]
        return port

    @property
    def dropped(self) -> int:
        """Number of datagrams that the kernel has dropped because the socket's buffer was full."""
        if sys.platform != "linux":
            return 0
        try:
            return int(
                _MEMINFO.unpack(self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[-1]
            )
        except (OSError, struct.error):  # an old kernel
            return 0

    def fileno(self) -> int:
        """Return the socket's descriptor, for select and poll."""
        return self._socket.fileno()

    @staticmethod
    def wall_s() -> float:
        """Return the wall time of budgets and of answers about owners."""
        return time.monotonic()

    def receive(self) -> tuple[bytes, Address] | None:
        """Return the next datagram and its sender, without waiting; None without one."""
        for _ in range(_MOST_ERRORS):
            try:
                # the kernel truncates datagrams, so one extra byte detects those that are too long
                data, address = self._socket.recvfrom(MAX_RECEIVED_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                return None
            except OSError:  # an earlier datagram was refused; the error queue has its address
                self._read_errors()
            else:
                return data, address
        return None

    def send(self, datagram: bytes | bytearray, address: Address) -> None:
        """Send a datagram; it is lost if the buffer is full."""
        for _ in range(2):
            try:
                self._socket.sendto(datagram, address)
            except BlockingIOError:
                return  # the buffer is full; the datagram is lost
            except OSError:
                # the error is of an earlier datagram, possibly to another partner; this one was not sent
                self._read_errors()
                continue
            return

    def take_unreachable(self, *, look: bool = False) -> list[Address]:
        """Return the addresses found to be unreachable since the last call; ``look``: ask the kernel too."""
        if look:
            self._read_errors()
        if not self._unreachable:
            return self._unreachable
        found, self._unreachable = self._unreachable, []
        return found

    def trusts(self, sender: Address, wall_s: float) -> bool:
        """Whether a datagram of a sender may be read."""
        return self._owners is None or self._owners.trusts(sender, wall_s, wall_since_s=wall_s)

    def may_send(self, address: Address, wall_s: float, *, has_sent: bool) -> bool:
        """Whether an address may be sent to; ``has_sent``: it is that of a partner that was trusted."""
        if self._owners is None:
            return True
        if has_sent:
            return not self._owners.is_foreign(address, wall_s)
        return self._owners.trusts(address, wall_s)

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def _read_errors(self) -> None:
        """Note the addresses that the kernel's error queue reports as unreachable."""
        if sys.platform != "linux":
            return
        with contextlib.suppress(BlockingIOError):
            while True:
                _, _, _, address = self._socket.recvmsg(1, 512, socket.MSG_ERRQUEUE)
                self._unreachable.append(address)
