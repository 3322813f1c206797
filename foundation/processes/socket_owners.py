"""Owners of sockets on this machine: which user or process is at an address. An I/O module.

Reads Linux's /proc. On a system without it nothing can be checked, and everything is trusted.
"""

import contextlib
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import psutil

from foundation.processes.socket_diagnostics import udp_sockets
from foundation.processes.socket_table import (
    Address,
    SocketEntry,
    SocketTable,
    is_on_this_machine,
)

MARK = "COFLIGHT_CHILD"
"""Environment variable of every child and its descendants: ``<supervisor's token>/<child's name>``."""
LIFETIME_S = 1.0
"""Wall time for which an answer of `DatagramOwners` is valid."""
LONGEST_LIFETIME_S = 5.0
"""The same while the tables are long."""
SLOW_READ_S = 0.001
READ_SHARE = 0.02
"""Share of wall time for which tables are read that take `SLOW_READ_S` of processor time or more: the time
rises with the number of sockets, which any user of the machine can make. At least once per
`LONGEST_LIFETIME_S`, whatever it takes."""
MOST_KNOWN = 10_000
"""Addresses whose owners are kept until the tables are read again."""
ROOT_UID = 0
UDP_TABLES = ("udp", "udp6")
_SOCKET = "socket:["
"""Begin of a descriptor's link to a socket, before its inode."""

Read = Callable[[], str | None]


def read_tables(*names: str) -> str | None:
    """Return tables of sockets as one text (`socket_table`); None if the first cannot be read."""
    texts = []
    for name in names:
        try:
            texts.append(Path("/proc/net", name).read_text(encoding="ascii"))
        except OSError:
            if not texts:
                return None
    return "".join(texts)


def read_udp() -> str | None:
    """Return the tables of UDP sockets as one text (`socket_table`); None if the system has none."""
    text = udp_sockets()
    return read_tables(*UDP_TABLES) if text is None else text


class DatagramOwners:
    """Whether UDP sockets on this machine belong to this process's user or to root.

    ``own_host`` is the address to which the asking socket is bound; addresses of other machines have no owner
    here and are trusted. ``read`` returns the tables (`socket_table`), which are read again when they are
    older than `LIFETIME_S`, or later within `READ_SHARE`; until then answers are kept, and addresses that
    are not in the tables are not trusted. ``cpu_s`` returns the processor time of this thread. In all
    methods ``wall_s`` is the present wall time.
    """

    def __init__(
        self,
        own_host: str,
        read: Read = read_udp,
        *,
        cpu_s: Callable[[], float] = time.thread_time,
    ) -> None:
        self._own_host = own_host
        self._read = read
        self._cpu_s = cpu_s
        self._uids = {ROOT_UID, os.geteuid()}
        self._table: SocketTable | None = SocketTable("")
        """None: the system has none."""
        self._wall_read_s = float("-inf")
        self._wall_next_s = float("-inf")
        """When they may be read again."""
        self._owners: dict[Address, frozenset[int]] = {}
        """Users at each address that was looked up in the table."""

    def trusts(self, address: Address, wall_s: float, *, wall_since_s: float = float("-inf")) -> bool:
        """Whether every socket at an address is of this user or root, and there is one.

        An address without a socket is looked up again if the tables were read before ``wall_since_s``.
        """
        if not is_on_this_machine(address[0], self._own_host):
            return True
        owners = self._owners_at(address, wall_s)
        if not owners and self._wall_read_s < wall_since_s and wall_s >= self._wall_next_s:
            self._read_again(wall_s)
            owners = self._owners_at(address, wall_s)
        return self._table is None or (bool(owners) and owners <= self._uids)

    def is_foreign(self, address: Address, wall_s: float) -> bool:
        """Whether a socket at an address is of another user than this one and root."""
        if not is_on_this_machine(address[0], self._own_host):
            return False
        return not self._owners_at(address, wall_s) <= self._uids

    def _read_again(self, wall_s: float) -> None:
        begin_s = self._cpu_s()
        text, self._wall_read_s = self._read(), wall_s
        self._table = None if text is None else SocketTable(text)
        taken_s = self._cpu_s() - begin_s
        delay_s = taken_s / READ_SHARE if taken_s >= SLOW_READ_S else 0.0
        self._wall_next_s = wall_s + min(delay_s, LONGEST_LIFETIME_S)
        self._owners.clear()

    def _owners_at(self, address: Address, wall_s: float) -> frozenset[int]:
        if wall_s - self._wall_read_s > LIFETIME_S and wall_s >= self._wall_next_s:
            self._read_again(wall_s)
        owners = self._owners.get(address)
        if owners is None:
            found = [] if self._table is None else self._table.at(address)
            if len(self._owners) >= MOST_KNOWN:
                self._owners.clear()
            owners = self._owners[address] = frozenset(each.uid for each in found)
        return owners


class ChildSockets:
    """The sockets of a child of a run and of its descendants, as of the first question about them.

    The child is the process ``pid``, or has ``mark`` as the value of `MARK` in its environment. Of processes
    whose descriptors cannot be read, as of those of other users, only the users can be compared.
    """

    def __init__(self, *, pid: int | None, mark: str | None) -> None:
        self._pid, self._mark = pid, mark
        self._inodes: frozenset[int] | None = None
        """None: not looked up."""
        self._uids: frozenset[int] = frozenset()
        """Users of the processes whose descriptors cannot be read."""

    def has(self, sockets: Sequence[SocketEntry]) -> bool:
        """Whether there are sockets, and all are of the child."""
        return bool(sockets) and all(map(self._has, sockets))

    def _has(self, socket: SocketEntry) -> bool:
        if not socket.inode:
            return False
        if self._inodes is None:
            if self._pid is not None and socket.inode in (socket_inodes(self._pid) or ()):
                return True  # the most frequent case, which needs no other process
            self._inodes, self._uids = self._look_up()
        return socket.inode in self._inodes or socket.uid in self._uids

    def _look_up(self) -> tuple[frozenset[int], frozenset[int]]:
        inodes: set[int] = set()
        uids: set[int] = set()
        for process in _family(self._pid, self._mark):
            held = socket_inodes(process.pid)
            if held is not None:
                inodes |= held
                continue
            with contextlib.suppress(psutil.NoSuchProcess):
                uids.add(process.uids().effective)
        return frozenset(inodes), frozenset(uids)


def socket_inodes(pid: int) -> set[int] | None:
    """Return the inodes of a process's sockets; None if its descriptors cannot be read."""
    try:
        with os.scandir(f"/proc/{pid}/fd") as descriptors:
            targets = [_target(each) for each in descriptors]
    except PermissionError:
        return None
    except OSError:  # it has ended
        return set()
    return {int(target[len(_SOCKET) : -1]) for target in targets if target.startswith(_SOCKET)}


def _target(descriptor: "os.DirEntry[str]") -> str:
    try:
        return os.readlink(descriptor.path)  # noqa: PTH115  some hundred links, without an object for each
    except OSError:  # closed meanwhile
        return ""


def mark_beside(name: str) -> str | None:
    """Return the mark of another child of the run that this process belongs to; None: it is of no run."""
    token, has_name, _ = os.environ.get(MARK, "").partition("/")
    return f"{token}/{name}" if has_name else None


def _family(pid: int | None, mark: str | None) -> list[psutil.Process]:
    """Return a child's processes: itself, those with its mark, and all descendants of these."""
    processes, found = list(psutil.process_iter(["ppid"])), set()
    for process in processes:
        if process.pid == pid or (mark is not None and _mark_of(process) == mark):
            found.add(process.pid)
    grown = True
    while grown:
        more = {each.pid for each in processes if each.info["ppid"] in found} - found
        found |= more
        grown = bool(more)
    return [process for process in processes if process.pid in found]


def _mark_of(process: psutil.Process) -> str | None:
    try:
        mark: str | None = process.environ().get(MARK)
    except (psutil.Error, OSError):
        return None
    return mark


def holder_of(inode: int) -> tuple[int, str] | None:
    """Return the process id and name of a process that has a socket, as far as it can be found."""
    for process in psutil.process_iter():
        if inode in (socket_inodes(process.pid) or ()):
            try:
                return process.pid, process.name()
            except psutil.NoSuchProcess:
                return None
    return None
