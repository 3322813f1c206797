"""UDP sockets of socket diagnostics: the same as those of Linux's tables."""

import contextlib
import os
import socket
import sys

import pytest

from foundation.processes import socket_diagnostics
from foundation.processes.socket_diagnostics import udp_sockets
from foundation.processes.socket_owners import UDP_TABLES, read_tables, read_udp
from foundation.processes.socket_table import entries

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux's socket diagnostics")
needs_diagnostics = pytest.mark.skipif(udp_sockets() is None, reason="a system without them")


@needs_diagnostics
@pytest.mark.parametrize(
    ("family", "host"),
    [
        (socket.AF_INET, "127.0.0.1"),
        (socket.AF_INET, "0.0.0.0"),  # noqa: S104
        (socket.AF_INET6, "::"),
        (socket.AF_INET6, "::1"),
        (socket.AF_INET6, "::ffff:127.0.0.1"),
    ],
)
def test_a_socket_is_the_same_as_in_the_tables(family: socket.AddressFamily, host: str) -> None:
    with socket.socket(family, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind((host, 0))
        except OSError:
            pytest.skip("without IPv6")
        port = sock.getsockname()[1]
        (entry,) = entries(udp_sockets() or "", port)
        assert [entry] == entries(read_tables(*UDP_TABLES) or "", port)
        assert (entry.uid, entry.inode) == (os.geteuid(), os.fstat(sock.fileno()).st_ino)
    assert entries(udp_sockets() or "", port) == []


@needs_diagnostics
def test_a_connected_socket_has_its_peer_and_many_are_all_found() -> None:
    with contextlib.ExitStack() as stack:
        first, *others = (
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(400)
        )
        for sock in (first, *others):
            sock.bind(("127.0.0.1", 0))
        first.connect(others[0].getsockname())
        text = udp_sockets() or ""
        assert entries(text, first.getsockname()[1])[0].remote == others[0].getsockname()
        assert all(len(entries(text, sock.getsockname()[1])) == 1 for sock in others)


def test_the_tables_are_read_where_there_are_no_diagnostics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket_diagnostics, "_SOCK_DIAG", 31)  # a protocol that does not exist
    assert udp_sockets() is None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        assert len(entries(read_udp() or "", sock.getsockname()[1])) == 1


def test_a_kernel_without_a_handler_for_the_protocol_has_no_diagnostics(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It answers with an end that has an error, and not with an error."""
    monkeypatch.setattr(socket, "IPPROTO_UDP", 99)
    assert udp_sockets() is None
