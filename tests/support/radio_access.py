"""Routers, folders of sockets and users for tests of the radio's transport."""

import contextlib
from collections.abc import Iterator

from netsim.transport.access_control import Rights, User
from netsim.transport.socket_folder import SOCKET, SocketFolder, unix_endpoint
from netsim.transport.zenoh_session import Transport

TESTER = User("tester", "1234")
TCP = "tcp/127.0.0.1:0"


@contextlib.contextmanager
def unix_socket() -> Iterator[str]:
    """Yield the path of a socket in a folder that is removed at the end."""
    folder = SocketFolder()
    try:
        yield str(folder.path / SOCKET)
    finally:
        folder.remove()


@contextlib.contextmanager
def router(*rights: Rights, link: str = "unix") -> Iterator[Transport]:
    """Yield a router at a Unix socket or TCP port; without ``rights`` `TESTER` may do everything."""
    with unix_socket() as path:
        endpoint = TCP if link == "tcp" else unix_endpoint(path)
        listener = Transport.listen(endpoint, rights or [Rights(TESTER, shares=("**",))])
        with contextlib.closing(listener):
            yield listener
