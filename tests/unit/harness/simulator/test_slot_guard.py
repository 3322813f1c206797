"""The guard of the simulator's ports: processes of the run are admitted, others rejected and named."""

import contextlib
import os
import socket
import subprocess
import sys
import time

import pytest
from other_user import OTHER_UID, as_other_user, root_only

from foundation.processes.child_senders import LOOK_UP_PERIOD_S
from foundation.processes.socket_owners import MARK, ChildSockets
from harness.simulator import slot_guard
from harness.simulator.slot_guard import MOST_LISTED, MOST_NAMED, RejectedPeer, SlotGuard

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux's tables")
HERE = "127.0.0.1"
DEADLINE_S = 10.0
CLIENT = """
import socket, sys
kind, port = sys.argv[1], int(sys.argv[2])
sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM)
sock.connect(("127.0.0.1", port))
sock.send(b"x")
print(flush=True)
input()
"""
WRAPPED = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {CLIENT!r}, *sys.argv[1:]])"


@pytest.fixture
def ports():
    """Return a TCP listener and a UDP socket."""
    with (
        socket.create_server((HERE, 0)) as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as states,
    ):
        states.bind((HERE, 0))
        listener.settimeout(DEADLINE_S)
        states.settimeout(DEADLINE_S)
        yield listener, states


@contextlib.contextmanager
def client(kind, sock, *, code=CLIENT, mark=None):
    """Start a process that connects and sends; yields it."""
    command = [sys.executable, "-c", code, kind, str(sock.getsockname()[1])]
    env = {**os.environ, **({} if mark is None else {MARK: mark})}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env) as process:
        process.stdout.readline()
        yield process
        process.communicate(b"\n")


def admitted(guard, ports, kind, instance=0):
    """Return whether the guard admits the sender or connection that has arrived."""
    listener, states = ports
    if kind == "udp":
        _, sender = states.recvfrom(10)
        return guard.admits_sender(instance, states.getsockname(), sender, time.monotonic())
    connection, _ = listener.accept()
    with connection:
        (verdict,) = guard.admits([(instance, connection)])
    return verdict


@pytest.mark.parametrize("kind", ["tcp", "udp"])
@pytest.mark.parametrize("code", [CLIENT, WRAPPED])
def test_the_process_of_the_vehicle_and_its_children_are_admitted(ports, kind, code):
    guard = SlotGuard(mark_of=lambda _: None)
    with client(kind, ports[kind == "udp"], code=code) as process:
        guard.set_pid(2, process.pid)
        assert admitted(guard, ports, kind, instance=2)
    assert guard.rejected() == []


@pytest.mark.parametrize("kind", ["tcp", "udp"])
def test_a_marked_process_is_admitted_for_its_vehicle_alone(ports, kind):
    reported = []
    guard = SlotGuard(mark_of=lambda name: f"token/{name}", on_rejected=reported.append)
    for instance in (3, 2):
        with client(kind, ports[kind == "udp"], mark="token/uav 3") as process:
            assert admitted(guard, ports, kind, instance) is (instance == 3)
    ((peer),) = reported
    port = ports[kind == "udp"].getsockname()[1]
    assert peer[:3] == (port, os.geteuid(), process.pid)
    assert guard.rejected() == [{**peer._asdict(), "count": 1}]


def test_connections_of_one_stranger_are_counted_together(ports):
    reported = []
    guard = SlotGuard(on_rejected=reported.append)
    listener, _ = ports
    with contextlib.ExitStack() as stack:
        clients = [
            stack.enter_context(socket.create_connection(listener.getsockname(), DEADLINE_S))
            for _ in range(10)
        ]
        connections = [(0, stack.enter_context(listener.accept()[0])) for _ in clients]
        assert guard.admits(connections) == [False] * 10
    ((peer),) = reported
    assert (peer.pid, peer.uid) == (os.getpid(), os.geteuid())
    assert [entry["count"] for entry in guard.rejected()] == [10]


def test_a_connection_that_its_peer_has_closed_is_not_admitted(ports):
    guard = SlotGuard(mark_of=lambda _: None)
    listener, states = ports
    with client("tcp", listener) as process:
        guard.set_pid(0, process.pid)
    assert not admitted(guard, ports, "tcp")
    with client("udp", states) as process:
        guard.set_pid(0, process.pid)
    assert not admitted(guard, ports, "udp")
    assert {entry["uid"] for entry in guard.rejected()} == {None}


def test_without_tables_everything_is_admitted(ports):
    guard = SlotGuard(read_tcp=lambda: None, read_udp=lambda: None)
    for kind in ("tcp", "udp"):
        with client(kind, ports[kind == "udp"]):
            assert admitted(guard, ports, kind)


def test_the_list_of_rejected_peers_is_bounded():
    reported = []
    guard = SlotGuard(on_rejected=reported.append)
    for uid in range(10 * MOST_LISTED):
        guard._count(RejectedPeer(4560, uid))
    assert len(reported) == MOST_LISTED
    listed = guard.rejected()
    assert len(listed) == MOST_LISTED + 1
    assert listed[-1] == {"port": 4560, "uid": None, "pid": None, "name": None, "count": 9 * MOST_LISTED}


def test_processes_and_tables_are_read_rarely_however_many_senders_there_are(ports, monkeypatch):
    reads, holders = [], []
    monkeypatch.setattr(slot_guard, "holder_of", holders.append)
    table = "".join(
        f"0: 0100007F:{port:04X} 00000000:0000 07 0:0 00:0 0 1000 0 {port}\n" for port in range(9_000, 9_500)
    )
    guard = SlotGuard(read_udp=lambda: reads.append(1) or table)
    _, states = ports
    monkeypatch.setattr(ChildSockets, "_look_up", lambda _: reads.append(2) or (frozenset(), frozenset()))
    for wall_s in (0.0, 0.4 * LOOK_UP_PERIOD_S):
        for port in range(9_000, 9_500):
            assert not guard.admits_sender(0, states.getsockname(), (HERE, port), wall_s)
    assert reads == [1, 2]
    assert len(holders) == MOST_NAMED
    assert sum(entry["count"] for entry in guard.rejected()) == 1_000
    assert not guard.admits_sender(0, states.getsockname(), (HERE, 9_000), LOOK_UP_PERIOD_S)
    assert reads == [1, 2, 1, 2]


def test_a_vehicle_is_admitted_at_the_next_look_up_after_a_stranger(ports):
    guard, (_, states) = SlotGuard(mark_of=lambda _: None), ports
    assert not guard.admits_sender(0, states.getsockname(), (HERE, 9), 0.0)
    with client("udp", states) as process:
        _, sender = states.recvfrom(10)
        assert not guard.admits_sender(0, states.getsockname(), sender, 0.1)
        guard.set_pid(0, process.pid)  # looks up again
        assert guard.admits_sender(0, states.getsockname(), sender, 0.1)
    guard.set_pid(1, os.getpid())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        assert not guard.admits_sender(1, states.getsockname(), (HERE, 9), 0.0)
        own.bind((HERE, 0))
        assert not guard.admits_sender(1, states.getsockname(), own.getsockname(), 0.1)
        assert guard.admits_sender(1, states.getsockname(), own.getsockname(), LOOK_UP_PERIOD_S)


@root_only
@pytest.mark.parametrize("kind", ["tcp", "udp"])
def test_another_user_is_rejected_and_named(ports, kind):
    guard = SlotGuard(mark_of=lambda name: f"token/{name}")
    sock = ports[kind == "udp"]

    def connect():
        kind_of = socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM
        stranger = socket.socket(socket.AF_INET, kind_of)
        stranger.connect(sock.getsockname())
        stranger.send(b"x")
        return stranger

    with as_other_user(connect) as pid:
        assert not admitted(guard, ports, kind)
        (entry,) = guard.rejected()
        assert (entry["uid"], entry["pid"]) == (OTHER_UID, pid)
    assert RejectedPeer(1, OTHER_UID, 7, "thief").describe() == f"user {OTHER_UID} (process 7, thief)"


@root_only
def test_a_vehicle_that_its_command_runs_as_another_user_is_admitted(ports):
    """``setpriv`` in the command of a PX4 changes its user; the mark stays in its environment."""
    guard, (listener, _) = SlotGuard(mark_of=lambda _: None), ports
    with as_other_user(lambda: socket.create_connection(listener.getsockname(), DEADLINE_S)) as pid:
        guard.set_pid(0, pid)
        assert admitted(guard, ports, "tcp")
