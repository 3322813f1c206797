"""Whether senders of datagrams are a child of a run, at a cost that does not grow with their number.

An I/O module: reads Linux's tables of sockets and processes.
"""

import time
from collections.abc import Callable

from foundation.processes.socket_owners import LONGEST_LIFETIME_S, READ_SHARE, ChildSockets, Read, read_udp
from foundation.processes.socket_table import Address, SocketEntry, SocketTable

LOOK_UP_PERIOD_S = 0.5
"""Wall time for which the sockets of the machine and of the child count as they were looked up, at least."""


class ChildSenders:
    """Whether UDP sockets on this machine are a child's.

    ``child`` returns the sockets of the child, which are looked up once per `LOOK_UP_PERIOD_S` at most, and
    within `READ_SHARE`, since that reads the descriptors of all processes. ``read`` returns the tables
    (`socket_table`), None if the system has none: then every sender is the child. ``cpu_s`` returns the
    processor time of this thread.
    """

    def __init__(
        self,
        child: Callable[[], ChildSockets],
        *,
        read: Read = read_udp,
        cpu_s: Callable[[], float] = time.thread_time,
    ) -> None:
        self._make_child, self._read, self._cpu_s = child, read, cpu_s
        self._child: ChildSockets | None = None
        self._table: SocketTable | None = None
        self._verdicts: dict[Address, bool] = {}
        """By sender, since the look-up."""
        self._wall_next_s = float("-inf")
        """When they may be looked up again."""

    def admits(self, sender: Address, wall_s: float) -> bool:
        """Whether a sender is the child, at the present wall time ``wall_s``.

        One whose socket is younger than the last look-up is after the next one.
        """
        if self._child is None or wall_s >= self._wall_next_s:
            begin_s = self._cpu_s()
            text, self._child = self._read(), self._make_child()
            self._table = None if text is None else SocketTable(text)
            self._verdicts.clear()
            taken_s = self._cpu_s() - begin_s
            delay_s = min(max(LOOK_UP_PERIOD_S, taken_s / READ_SHARE), LONGEST_LIFETIME_S)
            self._wall_next_s = wall_s + delay_s
        verdict = self._verdicts.get(sender)
        if verdict is None:
            verdict = self._table is None or self._child.has(self.sockets_of(sender))
            self._verdicts[sender] = verdict
        return verdict

    def sockets_of(self, sender: Address) -> list[SocketEntry]:
        """Return the sockets at the sender's address as of the last look-up."""
        return [] if self._table is None else self._table.at(sender)
