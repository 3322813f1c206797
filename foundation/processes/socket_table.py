"""Linux's tables of sockets (/proc/net/tcp, udp, tcp6, udp6): which user's socket has an address. No I/O.

A table has one line per socket with its local and remote address, the user of its creator and its inode. Its
addresses are hexadecimal in the byte order of the machine, one word of 32 bits after the other.
"""

import struct
from collections.abc import Iterable
from ipaddress import IPv4Address, IPv6Address
from typing import NamedTuple

Address = tuple[str, int]
"""IPv4 address (an IPv6 one that stands for none is in its own notation) and port."""
ANY_HOST = "0.0.0.0"  # noqa: S104  compared, not bound
"""Local address of a socket that is bound to all addresses."""
LOOPBACK = "127."
"""Begin of the addresses of the loopback interface."""
_LOCAL, _REMOTE, _UID, _INODE = 1, 2, 7, 9
"""Columns of a line."""
_WORD_DIGITS = 8
_MAPPED = bytes(10) + b"\xff\xff"
"""Begin of an address of version 6 that stands for one of version 4."""


class SocketEntry(NamedTuple):
    """One socket."""

    local: Address
    remote: Address
    uid: int
    """User of the process that made it."""
    inode: int
    """Number by which a process's descriptors name it; 0: no process has it."""


def entries(table: str, port: int) -> list[SocketEntry]:
    """Return the sockets with this local port; lines of another form are skipped."""
    pattern, found = f":{port:04X} ", []
    at = table.find(pattern)
    while at >= 0:
        begin, end = table.rfind("\n", 0, at) + 1, table.find("\n", at)
        entry = _entry(table[begin : end if end >= 0 else None])
        if entry is not None and entry.local[1] == port:
            found.append(entry)
        at = table.find(pattern, end) if end >= 0 else -1
    return found


class SocketTable:
    """A table whose sockets are found by address, in a time that does not rise with their number."""

    def __init__(self, text: str) -> None:
        self._lines: dict[str, list[str]] = {}
        self._entries: dict[str, list[SocketEntry]] = {}
        """Those that were looked up; many sockets can share an address."""
        for line in text.splitlines():
            local = line.split(maxsplit=_LOCAL + 1)[_LOCAL : _LOCAL + 1]
            if local:
                self._lines.setdefault(local[0], []).append(line)

    def at(self, address: Address) -> list[SocketEntry]:
        """Return the sockets that can send from an address and receive at it; other lines are skipped."""
        host, port = address
        try:
            raw = IPv4Address(host).packed
        except ValueError:  # of version 6
            hosts = [_words(IPv6Address(host).packed)]
        else:
            hosts = [_words(raw), _words(_MAPPED + raw)]
        hosts += [_words(bytes(4)), _words(bytes(16))]
        return [entry for each in hosts for entry in self._at(f"{each}:{port:04X}")]

    def _at(self, local: str) -> list[SocketEntry]:
        if local not in self._lines:
            return []
        found = self._entries.get(local)
        if found is None:
            found = [entry for entry in map(_entry, self._lines[local]) if entry is not None]
            self._entries[local] = found
        return found


def _words(packed: bytes) -> str:
    """Return an address in the notation of the tables."""
    return "".join(f"{word:08X}" for (word,) in struct.iter_unpack("=I", packed))


def peer_of(sockets: Iterable[SocketEntry], local: Address, remote: Address) -> SocketEntry | None:
    """Return the other end of a connection on this machine, given by its own addresses; None: it has none."""
    return next((each for each in sockets if each.local == remote and each.remote == local), None)


def is_on_this_machine(host: str, own_host: str) -> bool:
    """Whether a sender's address is of this machine: loopback, or the own address that it has sent to."""
    return host == own_host or host.startswith(LOOPBACK)


def _entry(line: str) -> SocketEntry | None:
    fields = line.split()
    try:
        local, remote = _address(fields[_LOCAL]), _address(fields[_REMOTE])
        return SocketEntry(local, remote, int(fields[_UID]), int(fields[_INODE]))
    except (IndexError, ValueError):
        return None


def _address(text: str) -> Address:
    """Return an address. Raises ValueError."""
    digits, _, port = text.partition(":")
    words = [int(digits[i : i + _WORD_DIGITS], 16) for i in range(0, len(digits), _WORD_DIGITS)]
    raw = struct.pack(f"={len(words)}I", *words)
    if len(words) == 1:
        return str(IPv4Address(raw)), int(port, 16)
    address = IPv6Address(raw)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped), int(port, 16)
    return ANY_HOST if address == IPv6Address(0) else str(address), int(port, 16)
