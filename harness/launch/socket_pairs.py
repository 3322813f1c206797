"""Connected sockets between the physics server and other processes of a run. An I/O module."""

import contextlib
import socket
from collections.abc import Iterable, Iterator
from typing import Self


class SocketPairs:
    """One pair of connected stream sockets per instance; close it. Raises OSError.

    Neither end has a name, so no other program can connect to it. Each process inherits its end, and the
    launcher closes its own copy then: the end of a process is an end of file for the other.
    """

    def __init__(self, instances: Iterable[int]) -> None:
        self._servers: dict[int, socket.socket] = {}
        self._others: dict[int, socket.socket] = {}
        with contextlib.ExitStack() as stack:
            stack.callback(self.close)
            for instance in instances:
                self._servers[instance], self._others[instance] = socket.socketpair()
            stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def server_descriptors(self) -> dict[int, int]:
        """Return the descriptors of the physics server's ends, by instance."""
        return {instance: end.fileno() for instance, end in self._servers.items()}

    def close_server_ends(self) -> None:
        """Close the launcher's copies of the physics server's ends; harmless when repeated."""
        for end in self._servers.values():
            end.close()

    @contextlib.contextmanager
    def handed_over(self, instance: int) -> Iterator[int]:
        """Yield the descriptor of a process's end, and close the launcher's copy at the end of the block."""
        with self._others[instance] as end:
            yield end.fileno()

    def close(self) -> None:
        """Close what is open of both ends; harmless when repeated."""
        for end in (*self._servers.values(), *self._others.values()):
            end.close()


def descriptor_list(descriptors: dict[int, int]) -> str:
    """Return descriptors by instance as an argument of the physics server: "0:8,1:9"."""
    return ",".join(f"{instance}:{descriptor}" for instance, descriptor in descriptors.items())
