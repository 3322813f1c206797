"""Guard of the simulator's ports: admits the processes that the run has started for its vehicles, no others.

An I/O module: reads Linux's tables of sockets and processes (`foundation.processes.socket_owners`). The peer
of a connection on this machine is the socket with the reverse addresses, which belongs to a process.
Connections from other machines are admitted, and all where the system has no such tables.
"""

import socket
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, Protocol

from foundation.processes.child_senders import ChildSenders
from foundation.processes.socket_owners import (
    ChildSockets,
    holder_of,
    mark_beside,
    read_tables,
    read_udp,
)
from foundation.processes.socket_table import (
    Address,
    SocketEntry,
    entries,
    is_on_this_machine,
    peer_of,
)

MOST_LISTED = 32
"""Different rejected peers that are counted one by one; further ones are counted by port."""
MOST_NAMED = 16
"""Sockets of rejected peers whose process is looked up, which reads the descriptors of all processes."""


class Guard(Protocol):
    """Decides which peers may be vehicles."""

    def admits(self, connections: Sequence[tuple[int, socket.socket]]) -> list[bool]:
        """Return for each connection, with the vehicle of its port, whether it may be that vehicle's."""

    def admits_sender(self, instance: int, local: Address, sender: Address, wall_s: float) -> bool:
        """Return whether a sender of datagrams to the address ``local`` may be that vehicle.

        ``wall_s`` is the present wall time.
        """


class _Unguarded:
    """A guard that admits every peer."""

    def admits(self, connections: Sequence[tuple[int, socket.socket]]) -> list[bool]:
        return [True] * len(connections)

    def admits_sender(
        self,
        instance: int,  # noqa: ARG002
        local: Address,  # noqa: ARG002
        sender: Address,  # noqa: ARG002
        wall_s: float,  # noqa: ARG002
    ) -> bool:
        return True


UNGUARDED: Guard = _Unguarded()


class RejectedPeer(NamedTuple):
    """A peer that was not admitted, as far as it is known."""

    port: int
    uid: int | None
    """None: it had ended."""
    pid: int | None = None
    name: str | None = None

    def describe(self) -> str:
        """Return the peer in words."""
        user = "an unknown user" if self.uid is None else f"user {self.uid}"
        return f"{user} (process {self.pid}, {self.name})" if self.pid is not None else user


class SlotGuard:
    """The guard of a run's ports.

    ``mark_of`` returns the mark of a vehicle's process by its name, None if it has none. ``on_rejected``
    receives the first rejection of each peer. The other functions return tables (`socket_table`), None if the
    system has none.
    """

    def __init__(
        self,
        *,
        mark_of: Callable[[str], str | None] = mark_beside,
        on_rejected: Callable[[RejectedPeer], None] = lambda _: None,
        read_tcp: Callable[[], str | None] = lambda: read_tables("tcp"),
        read_tcp6: Callable[[], str | None] = lambda: read_tables("tcp6"),
        read_udp: Callable[[], str | None] = read_udp,
    ) -> None:
        self._mark_of = mark_of
        self._on_rejected = on_rejected
        self._read_tcp, self._read_tcp6, self._read_udp = read_tcp, read_tcp6, read_udp
        self._pids: dict[int, int] = {}
        self._rejected: Counter[RejectedPeer] = Counter()
        self._holders: dict[int, tuple[int, str] | None] = {}
        """Processes of rejected peers by the inode of their socket, as far as they were looked up."""
        self._senders: dict[int, ChildSenders] = {}
        """Senders of datagrams to each vehicle's port."""

    def set_pid(self, instance: int, pid: int) -> None:
        """Set the process that was started for a vehicle."""
        self._pids[instance] = pid
        self._senders.pop(instance, None)

    def rejected(self) -> list[dict[str, int | str | None]]:
        """Return the rejected peers with their numbers of connections or datagrams, for the manifest."""
        return [{**peer._asdict(), "count": count} for peer, count in self._rejected.items()]

    def admits(self, connections: Sequence[tuple[int, socket.socket]]) -> list[bool]:
        """Implement `Guard`: tables and processes are read once for all connections."""
        table: str | None = None
        vehicles = {instance: self._sockets_of(instance) for instance, _ in connections}
        verdicts = []
        for instance, connection in connections:
            own: Address = connection.getsockname()
            try:
                remote: Address = connection.getpeername()
            except OSError:  # closed by its peer
                verdicts.append(False)
                continue
            if not is_on_this_machine(remote[0], own[0]):
                verdicts.append(True)
                continue
            table = self._read_tcp() if table is None else table
            peer = peer_of(entries(table or "", remote[1]), own, remote)
            if table is not None and peer is None:
                peer = peer_of(entries(self._read_tcp6() or "", remote[1]), own, remote)
            admitted = table is None or (peer is not None and vehicles[instance].has([peer]))
            if not admitted:
                self._reject(own[1], peer)
            verdicts.append(admitted)
        return verdicts

    def admits_sender(self, instance: int, local: Address, sender: Address, wall_s: float) -> bool:
        """Implement `Guard`; processes are examined as rarely as `ChildSenders` does."""
        if not is_on_this_machine(sender[0], local[0]):
            return True
        senders = self._senders.get(instance)
        if senders is None:
            senders = ChildSenders(partial(self._sockets_of, instance), read=self._read_udp)
            self._senders[instance] = senders
        if senders.admits(sender, wall_s):
            return True
        self._reject(local[1], next(iter(senders.sockets_of(sender)), None))
        return False

    def _sockets_of(self, instance: int) -> ChildSockets:
        return ChildSockets(pid=self._pids.get(instance), mark=self._mark_of(f"uav {instance}"))

    def _reject(self, port: int, peer: SocketEntry | None) -> None:
        if peer is None or not peer.inode:  # it has ended, and the user in its entry is none
            self._count(RejectedPeer(port, None))
            return
        if peer.inode not in self._holders and len(self._holders) < MOST_NAMED:
            self._holders[peer.inode] = holder_of(peer.inode)
        self._count(RejectedPeer(port, peer.uid, *(self._holders.get(peer.inode) or (None, None))))

    def _count(self, peer: RejectedPeer) -> None:
        if peer not in self._rejected and len(self._rejected) >= MOST_LISTED:
            peer = RejectedPeer(peer.port, None)
        if peer not in self._rejected and len(self._rejected) < MOST_LISTED:
            self._on_rejected(peer)
        self._rejected[peer] += 1
