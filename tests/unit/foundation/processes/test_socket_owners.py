"""Owners of sockets: users at an address, with memory, and the processes of a child of a run."""

import os
import socket
import subprocess
import sys

import pytest
from other_user import as_other_user, root_only

from foundation.processes.socket_owners import (
    LIFETIME_S,
    MARK,
    READ_SHARE,
    ChildSockets,
    DatagramOwners,
    holder_of,
    mark_beside,
    read_tables,
    socket_inodes,
)
from foundation.processes.socket_table import SocketEntry, entries

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux's tables")
HERE = "127.0.0.1"
SENDER = (HERE, 14_550)


def table(*uids: int, port: int = 14_550) -> str:
    return "".join(f" 1: 0100007F:{port:04X} 00000000:0000 07 0:0 0:0 0 {uid} 0 5 2 0 0\n" for uid in uids)


class Tables:
    """Text that is returned, and the number of times that it was read."""

    def __init__(self, text: str | None) -> None:
        self.text = text
        self.reads = 0

    def __call__(self) -> str | None:
        self.reads += 1
        return self.text


@pytest.mark.skipif(sys.byteorder != "little", reason="the text is of such a machine")
@pytest.mark.parametrize(
    ("uids", "trusted", "foreign"),
    [
        ((os.geteuid(),), True, False),
        ((0,), True, False),
        ((os.geteuid() + 1_234,), False, True),
        ((os.geteuid(), os.geteuid() + 1_234), False, True),  # they share the port
        ((), False, False),  # has ended
    ],
)
def test_sockets_of_this_user_and_of_root_are_trusted(
    uids: tuple[int, ...], *, trusted: bool, foreign: bool
) -> None:
    owners = DatagramOwners(HERE, Tables(table(*uids)))
    assert owners.trusts(SENDER, 5.0) is trusted
    assert owners.is_foreign(SENDER, 5.0) is foreign


def test_other_machines_are_trusted_and_so_is_everything_without_tables() -> None:
    read = Tables("")
    assert DatagramOwners(HERE, read).trusts(("192.0.2.7", 5), 0.0)
    assert not DatagramOwners(HERE, read).is_foreign(("192.0.2.7", 5), 0.0)
    assert read.reads == 0
    assert DatagramOwners(HERE, Tables(None)).trusts(SENDER, 0.0)
    assert not DatagramOwners("192.0.2.7", read).trusts(("192.0.2.7", 5), 0.0)  # the own address


@pytest.mark.skipif(sys.byteorder != "little", reason="the text is of such a machine")
def test_answers_are_kept_for_a_while_and_missing_addresses_looked_up_again_on_request() -> None:
    read = Tables(table(0))
    owners = DatagramOwners(HERE, read)
    for wall_s in (10.0, 10.1, 10.0 + LIFETIME_S):
        assert owners.trusts(SENDER, wall_s, wall_since_s=wall_s)
    assert read.reads == 1
    read.text = table(0, port=14_551)
    assert owners.trusts(SENDER, 10.0 + LIFETIME_S)
    assert not owners.trusts(SENDER, 10.1 + LIFETIME_S)
    assert read.reads == 2
    late = (HERE, 14_552)
    assert not owners.trusts(late, 11.2)
    assert read.reads == 2
    read.text = table(0, port=14_552)
    assert not owners.trusts(late, 11.3)
    assert owners.trusts(late, 11.3, wall_since_s=11.3)
    assert read.reads == 3
    for _ in range(100):  # of one call
        assert not owners.trusts((HERE, 14_553), 11.4, wall_since_s=11.4)
    assert read.reads == 4


@pytest.mark.skipif(sys.byteorder != "little", reason="the text is of such a machine")
def test_slow_tables_are_read_for_a_share_of_the_time_and_answers_are_kept_meanwhile() -> None:
    read, cpu_s = Tables(table(0)), [0.0]
    taken_s = 0.1

    def read_slowly() -> str | None:
        cpu_s[0] += taken_s
        return read()

    owners = DatagramOwners(HERE, read_slowly, cpu_s=lambda: cpu_s[0])
    assert owners.trusts(SENDER, 10.0)
    pause_s = taken_s / READ_SHARE
    assert pause_s > 2.0 * LIFETIME_S
    read.text = table(os.geteuid() + 1_234)
    for wall_s in (10.1, 10.1 + LIFETIME_S, 9.9 + pause_s):
        assert owners.trusts(SENDER, wall_s)
        assert not owners.trusts((HERE, 14_551), wall_s, wall_since_s=wall_s)
    assert read.reads == 1
    assert not owners.trusts(SENDER, 10.1 + pause_s)
    assert read.reads == 2


def test_a_real_sender_is_trusted() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind((HERE, 0))
        owners = DatagramOwners(HERE)
        assert owners.trusts(sock.getsockname(), 0.0)
        address = sock.getsockname()
    assert not DatagramOwners(HERE).trusts(address, 0.0)


@root_only
def test_a_sender_of_another_user_is_foreign() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HERE, 0))
        address = probe.getsockname()

    def bind():
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind(address)
        return sock

    with as_other_user(bind):
        owners = DatagramOwners(HERE)
        assert owners.is_foreign(address, 0.0)
        assert not owners.trusts(address, 0.0)


# ---- processes

BIND = """
import socket, sys
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sock.bind(("127.0.0.1", 0))
print(sock.getsockname()[1], flush=True)
input()
"""
VIA_CHILD = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {BIND!r}])"


def bound(code: str, mark: str | None = None) -> tuple["subprocess.Popen[str]", SocketEntry]:
    """Return a process and the socket that it or its child has bound."""
    env = {**os.environ, **({} if mark is None else {MARK: mark})}
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env
    )
    assert process.stdout is not None
    port = int(process.stdout.readline())
    (entry,) = entries(read_tables("udp") or "", port)
    return process, entry


@pytest.mark.parametrize("code", [BIND, VIA_CHILD])
def test_a_socket_of_a_child_or_its_descendant_is_found_by_process_and_by_mark(code: str) -> None:
    process, entry = bound(code, mark="token/uav 3")
    with process:
        assert (entry.inode in (socket_inodes(process.pid) or ())) is (code == BIND)
        assert ChildSockets(pid=process.pid, mark=None).has([entry])
        assert ChildSockets(pid=None, mark="token/uav 3").has([entry, entry])
        for mark in ("token/uav 30", "other/uav 3", None):
            assert not ChildSockets(pid=None, mark=mark).has([entry])
        child = ChildSockets(pid=process.pid, mark="token/uav 3")
        assert not child.has([entry._replace(inode=0)])
        assert not child.has([entry, entry._replace(inode=1)])
        assert child.has([entry])
        assert not child.has([])
        holder = holder_of(entry.inode)
        assert holder is not None
        assert (holder[0] == process.pid) is (code == BIND)
        process.communicate("\n")
    assert holder_of(entry.inode) is None
    assert not ChildSockets(pid=process.pid, mark="token/uav 3").has([entry])


def test_a_socket_of_another_process_is_not_a_childs() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mine,
        subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child,
    ):
        mine.bind((HERE, 0))
        (entry,) = entries(read_tables("udp") or "", mine.getsockname()[1])
        assert entry.inode in (socket_inodes(os.getpid()) or ())
        assert not ChildSockets(pid=child.pid, mark="token/uav 3").has([entry])
        child.communicate(b"\n")


def test_the_mark_of_another_child_has_this_runs_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MARK, "abc/application 3")
    assert mark_beside("uav 3") == "abc/uav 3"
    monkeypatch.delenv(MARK)
    assert mark_beside("uav 3") is None
