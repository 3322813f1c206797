"""Linux's tables of sockets: entries by port, addresses of both versions, and the peer of a connection."""

import os
import socket
import struct
import sys
from pathlib import Path

import pytest

from foundation.processes import socket_table
from foundation.processes.socket_table import (
    ANY_HOST,
    SocketEntry,
    SocketTable,
    entries,
    is_on_this_machine,
    peer_of,
)

HEADER = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"


def word(packed: bytes) -> str:
    """Return four bytes of an address as the kernel writes them on this machine."""
    return f"{struct.unpack('=I', packed)[0]:08X}"


def v4(host: str, port: int) -> str:
    return f"{word(socket.inet_aton(host))}:{port:04X}"


def v6(host: str, port: int) -> str:
    packed = socket.inet_pton(socket.AF_INET6, host)
    return "".join(word(packed[i : i + 4]) for i in range(0, 16, 4)) + f":{port:04X}"


def line(local: str, remote: str, uid: int, inode: int) -> str:
    return f"   7: {local} {remote} 01 00000000:00000000 00:00000000 00000000 {uid:5} 0 {inode} 2 0000 0\n"


NONE = v4(ANY_HOST, 0)


def test_entries_have_a_ports_sockets_with_user_and_inode() -> None:
    table = HEADER + line(v4("127.0.0.1", 14_550), NONE, 1000, 77) + line(v4("10.0.0.7", 80), NONE, 0, 78)
    assert entries(table, 14_550) == [SocketEntry(("127.0.0.1", 14_550), (ANY_HOST, 0), 1000, 77)]
    assert entries(table, 80) == [SocketEntry(("10.0.0.7", 80), (ANY_HOST, 0), 0, 78)]
    assert entries(table, 81) == entries("", 80) == []


def test_a_table_finds_what_can_send_from_an_address() -> None:
    lines = [
        line(v4("127.0.0.1", 14_550), NONE, 1000, 77),
        line(v6("::", 14_550), v6("::", 0), 5, 78),
        line(v4("10.0.0.7", 14_550), NONE, 6, 79),
        line(v4("127.0.0.1", 81), v4("127.0.0.1", 14_550), 7, 80),
    ]
    text = HEADER + "\n no line\n" + "".join(lines)
    table = SocketTable(text)
    assert [each.inode for each in table.at(("127.0.0.1", 14_550))] == [77, 78]
    assert [each.inode for each in table.at(("10.0.0.7", 14_550))] == [79, 78]
    assert table.at(("127.0.0.1", 81)) == entries(text, 81)
    assert table.at(("127.0.0.1", 80)) == SocketTable("").at(("127.0.0.1", 81)) == []


def test_a_table_finds_addresses_of_version_6() -> None:
    lines = [
        line(v6("::1", 500), v6("::", 0), 1, 1),
        line(v6("::ffff:127.0.0.1", 500), v6("::", 0), 2, 2),
        line(v4(ANY_HOST, 500), NONE, 3, 3),
    ]
    table = SocketTable("".join(lines))
    assert [each.inode for each in table.at(("::1", 500))] == [1, 3]
    assert [each.inode for each in table.at(("127.0.0.1", 500))] == [2, 3]


def test_a_look_up_does_not_read_sockets_of_other_addresses_of_the_port(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Any user can bind thousands of addresses of the loopback interface with one port."""
    text = "".join(line(v4(f"127.0.{i // 256}.{i % 256}", 500), NONE, 1, i) for i in range(3_000))
    read, entry = [], socket_table._entry
    monkeypatch.setattr(socket_table, "_entry", lambda text: read.append(text) or entry(text))
    table = SocketTable(text)
    assert [each.inode for each in table.at(("127.0.1.7", 500))] == [263]
    assert len(read) == 1
    same = SocketTable("".join(line(v4("127.0.0.1", 500), NONE, 1, i) for i in range(3_000)))
    assert len(same.at(("127.0.0.1", 500))) == len(same.at(("127.0.0.1", 500))) == 3_000
    assert len(read) == 3_001


def test_a_remote_port_of_the_same_number_is_no_entry() -> None:
    table = HEADER + line(v4("127.0.0.1", 5_000), v4("127.0.0.1", 80), 0, 1)
    assert entries(table, 80) == []
    both = table + line(v4("127.0.0.1", 80), v4("127.0.0.1", 5_000), 3, 2)
    assert [entry.inode for entry in entries(both, 80)] == [2]


def test_addresses_of_version_6_that_stand_for_version_4_are_those() -> None:
    table = (
        line(v6("::ffff:127.0.0.1", 14_550), v6("::", 0), 5, 1)
        + line(v6("::", 14_550), v6("::", 0), 6, 2)
        + line(v6("fe80::1", 14_550), v6("::", 0), 7, 3)
    )
    assert [entry.local[0] for entry in entries(table, 14_550)] == ["127.0.0.1", ANY_HOST, "fe80::1"]


@pytest.mark.parametrize(
    "wrong", ["", ":", "x:38D6 ", "1: ZZZZZZZZ:38D6 1:2 3 4 5 6 7 8 9\n", ":38D6 \n:38D6 "]
)
def test_lines_of_another_form_are_skipped(wrong: str) -> None:
    assert entries(wrong, 0x38D6) == []
    assert len(entries(f"{wrong}\n{line(v4('127.0.0.1', 0x38D6), NONE, 0, 1)}", 0x38D6)) == 1


def test_a_socket_bound_to_all_addresses_can_send_from_each() -> None:
    table = "".join(
        line(v4(host, 9_000), NONE, uid, uid)
        for uid, host in enumerate(("127.0.0.1", ANY_HOST, "127.0.0.2"), 1)
    )
    found = SocketTable(table).at(("127.0.0.1", 9_000))
    assert [entry.uid for entry in found] == [1, 2]


def test_the_peer_of_a_connection_has_its_addresses_reversed() -> None:
    own, remote = ("127.0.0.1", 4_560), ("127.0.0.1", 40_000)
    table = (
        line(v4(*own), v4(*remote), 0, 1)
        + line(v4(*remote), v4("127.0.0.1", 4_561), 1000, 2)
        + line(v4(*remote), v4(*own), 1001, 3)
    )
    peer = peer_of(entries(table, 40_000), own, remote)
    assert peer is not None
    assert (peer.uid, peer.inode) == (1001, 3)
    assert peer_of(entries(table, 40_000), own, ("127.0.0.1", 40_001)) is None


def test_loopback_and_the_own_address_are_of_this_machine() -> None:
    assert is_on_this_machine("127.0.0.5", "127.0.0.1")
    assert is_on_this_machine("192.0.2.1", "192.0.2.1")
    assert not is_on_this_machine("192.0.2.2", "192.0.2.1")
    assert not is_on_this_machine("192.0.2.2", ANY_HOST)


@pytest.mark.skipif(sys.platform != "linux", reason="Linux's tables")
@pytest.mark.parametrize("family", [socket.AF_INET, socket.AF_INET6])
def test_a_real_connections_peer_is_found(family: socket.AddressFamily) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket(family) as client:
        host = "127.0.0.1" if family == socket.AF_INET else "::ffff:127.0.0.1"
        try:
            client.connect((host, server.getsockname()[1]))
        except OSError:
            pytest.skip("no IPv6 here")
        connection, remote = server.accept()
        with connection:
            text = Path("/proc/net", "tcp" if family == socket.AF_INET else "tcp6").read_text()
            peer = peer_of(entries(text, remote[1]), connection.getsockname(), remote)
            assert peer is not None
            assert peer.uid == os.geteuid()
            assert peer.inode == os.fstat(client.fileno()).st_ino
