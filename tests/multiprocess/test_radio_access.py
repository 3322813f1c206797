"""Use of a run's radio: strangers are refused, guests are limited to their station, floods are bounded."""

import contextlib
import json
import os
import queue
import signal
import socket
import stat
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import msgspec
import psutil
import pytest
import zenoh
from paths import ROOT
from radio_access import TESTER, router
from radio_process import RUN, Radio

from netsim.model.config import GuestConfig
from netsim.transport.access_control import User
from netsim.transport.guest import Guest
from netsim.transport.guest_access import GuestAccess, GuestLogin, read_guest_access
from netsim.transport.lockstep_radio import (
    RadioFull,
    directory_key,
    guest_transmit_key,
    receive_key,
    transmit_key,
)
from netsim.transport.socket_folder import LOCK, SOCKET, SocketFolder
from netsim.transport.zenoh_session import Transport, TransportError
from netsim.wire.messages import (
    MOST_GUEST_ITEMS,
    Ack,
    Broadcast,
    Delivery,
    Directory,
    DirectoryRequest,
    RxBatch,
    TxBatch,
    decode,
    encode,
)

pytestmark = pytest.mark.multiprocess

ARTICLE = "scenarios/article.toml"
GUESTS = [GuestConfig(name=name, pos_ned_m=(0.0, 8.5, -10.0)) for name in ("ground", "car")]
GROUND, CAR = 3, 4
"""Stations of the guests, after three vehicles."""
MALFORMED_BYTES = 200
OTHER_UID = 65_534
LIMIT_S = 30.0


@pytest.fixture
def radio(tmp_path):
    with contextlib.closing(Radio(tmp_path, guests=GUESTS)) as each:
        yield each


def batch(station, now_us, payload=b"forged"):
    return encode(
        TxBatch(station=station, now_us=now_us, items=(Broadcast(seq=99, at_us=now_us, payload=payload),))
    )


def reply(session, key, payload):
    """Return the reply to a query, None without one."""
    asker = session.asker(key, timeout_s=0.5)
    return asker.ask(payload).answer()


def wait_until(is_so, what):
    wall_deadline_s = time.monotonic() + LIMIT_S
    while not is_so():
        assert time.monotonic() < wall_deadline_s, f"{what} within {LIMIT_S:g} s"
        time.sleep(0.02)


@pytest.mark.parametrize(
    "user",
    [("vehicles", "1234"), ("vehicles", ""), ("guest-3", "of the vehicles"), ("root", "1234"), ("", "")],
)
def test_a_client_with_a_wrong_password_is_refused_in_one_line(radio, user):
    name, password = user
    if name == "guest-3":
        password = radio.passwords.vehicles
    with pytest.raises(TransportError) as refused:
        Transport.connect(radio.endpoint, User(name, password), limit_s=0.5)
    assert str(refused.value) == (
        f"cannot connect to {radio.endpoint} as {name} within 0.5 s: it does not respond, as when other "
        "programs occupy it, or does not accept the password, which may be of another run"
    )
    assert radio.advance(8000).to_us == 8000


def test_a_client_without_user_and_password_is_refused(radio):
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", [radio.endpoint]),
        ("connect/timeout_ms", 500),
        ("connect/exit_on_failure", True),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    with pytest.raises(zenoh.ZError):
        zenoh.open(config)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user")
def test_other_users_cannot_reach_the_socket(radio):
    path = Path(radio.socket_path)
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setgroups([])
            os.setresgid(OTHER_UID, OTHER_UID, OTHER_UID)
            os.setresuid(OTHER_UID, OTHER_UID, OTHER_UID)
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
                other.connect(str(path))
        except PermissionError:
            status = 0
        finally:
            os._exit(status)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0


def test_no_file_with_a_password_is_left_beside_the_socket(radio):
    names = {path.name for path in Path(radio.socket_path).parent.iterdir()}
    assert names == {SOCKET, f"{SOCKET}.lock", LOCK}


def exchange(radio, attack):
    """Let vehicles exchange datagrams, with ``attack`` in between; returns what the second one receives."""
    received = []
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as receiver:
        for to_us in range(8_000, 48_000, 4_000):
            attack(to_us - 4_000)
            sender.send(to_us - 4_000, [Broadcast(seq=to_us, at_us=to_us - 4_000, payload=b"mine")])
            assert 1 in radio.advance(to_us, senders=(0,)).delivered
            received += receiver.receive(to_us + 4_000)
        assert receiver.malformed == 0
    return received


KEYS = [transmit_key(RUN), *(receive_key(RUN, i) for i in range(CAR)), guest_transmit_key(RUN, GROUND)]
"""Keys of vehicles and of another guest."""
WILD = [f"coflight/{RUN}/radio/tx/*", f"coflight/{RUN}/**", "**"]


def forge(session, now_us):
    """Try to send as a vehicle and as another guest, and to a vehicle, in all ways."""
    delivery = Delivery(source=0, seq=1, received_ns=1, rssi_dbm=-50.0, payload=b"forged")
    to_vehicle = encode(RxBatch(station=1, release_us=now_us, items=(delivery,)))
    for key in KEYS:
        for payload in (batch(0, now_us), to_vehicle):
            session.sender(key).send(payload)
    for key in KEYS + WILD:
        for payload in (batch(0, now_us), batch(GROUND, 0)):
            assert reply(session, key, payload) is None


def test_a_guest_can_neither_receive_nor_send_as_another_station(tmp_path):
    results = []
    for attack in (False, True):
        folder = tmp_path / str(attack)
        folder.mkdir()
        with (
            contextlib.closing(Radio(folder, guests=GUESTS)) as radio,
            radio.session(guest=CAR) as car,
            radio.session(guest=CAR) as spy,
            radio.session(guest=GROUND) as ground,
        ):
            queries, deliveries = queue.SimpleQueue(), queue.SimpleQueue()
            mailboxes = [spy.mailbox(key) for key in KEYS + WILD]
            for key in (*KEYS[:-1], directory_key(RUN), *WILD):  # after CAR's own key, which is its right
                spy.serve(key, queries.put)
            ground.serve(receive_key(RUN, GROUND), deliveries.put)
            assert reply(ground, guest_transmit_key(RUN, GROUND), b"") is None
            results.append(exchange(radio, partial(forge, car) if attack else lambda _: None))
            for _ in range(10):
                deliveries.get(timeout=LIMIT_S)
            assert [mailbox.take(0.0) for mailbox in mailboxes] == [None] * len(mailboxes)
            own = receive_key(RUN, CAR)
            assert {queries.get().key for _ in range(queries.qsize())} <= {own}
            details = radio.stop()
            assert details["malformed"] == {"guest ground": 1}
            assert details["influences"] == []
            results.append(radio.frames_path.read_bytes())
    assert len(results[0]) == 20  # and surveys
    assert results[:2] == results[2:]


def test_a_guest_cannot_send_with_the_number_of_another_station(radio):
    with radio.session(guest=CAR) as car:
        for station in (0, GROUND, CAR + 1):
            assert reply(car, guest_transmit_key(RUN, CAR), batch(station, 0)) is None
        directory = decode(Directory, reply(car, directory_key(RUN), encode(DirectoryRequest())))
        assert directory.guests == ("ground", "car")
        assert reply(car, guest_transmit_key(RUN, CAR), batch(CAR, 0)) == encode(Ack())
    details = radio.stop()
    assert details["malformed"] == {"guest car": 3}
    assert details["influences"] == ["a guest on the radio"]


def test_a_vehicles_batch_is_not_accepted_by_query_nor_a_guests_by_publishing(radio):
    with radio.session() as vehicle:
        assert reply(vehicle, transmit_key(RUN), batch(0, 4_000)) is None
        sender = vehicle.sender(transmit_key(RUN))
        sender.send(batch(CAR, 0))
        assert reply(vehicle, transmit_key(RUN), encode(TxBatch(station=0, now_us=0, items=()))) == encode(
            Ack()
        )
        assert radio.advance(8_000).delivered == ()
    details = radio.stop()
    assert details["malformed"] == {"vehicles": 2}
    assert details["influences"] == ["a program that uses the vehicles' password"]
    assert details["counters"]["frames_sent"]["data"] == 0


FLOOD = """
import sys
from netsim.transport.access_control import User
from netsim.transport.zenoh_session import Transport
endpoint, user, password, key, count, payload = sys.argv[1:]
session = Transport.connect(endpoint, User(user, password))
asker = session.asker(key, timeout_s=20.0)
asker.ask(bytes.fromhex(payload)).answer()
print("begun", flush=True)
for _ in range(int(count)):
    asker.ask(bytes.fromhex(payload))
print("flooded", flush=True)
sys.stdin.read()
"""


@contextlib.contextmanager
def flood(radio, payload, count):
    """Yield a process that queries as a guest, without reading a reply, once it has sent all."""
    command = [
        sys.executable, "-c", FLOOD, radio.endpoint, "guest-3", radio.passwords.guests[0],
        guest_transmit_key(RUN, GROUND), str(count), payload.hex(),
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == b"begun\n"
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("kind", ["valid", "malformed"])
def test_a_flood_of_a_guest_is_bounded_and_counted_and_vehicles_go_on(radio, kind):
    payload = batch(GROUND, 0, b"x" * 1_000) if kind == "valid" else b"\xff" * MALFORMED_BYTES
    memory = psutil.Process(radio.process.pid).memory_info
    with flood(radio, payload, 20_000) as process, contextlib.closing(radio.client(0)) as vehicle:
        rss_bytes = memory().rss
        assert process.stdout.readline() == b"flooded\n"
        vehicle.send(4_000, [Broadcast(seq=1, at_us=4_000, payload=b"x")])
        assert 1 in radio.advance(8_000, senders=(0,)).delivered
        assert memory().rss - rss_bytes < 100_000_000
        for to_us in range(12_000, 52_000, 4_000):
            assert radio.advance(to_us).to_us == to_us
    details = radio.stop()
    if kind == "malformed":
        assert details["malformed"]["guest ground"] > MOST_GUEST_ITEMS
        assert details["influences"] == []
    else:
        assert details["dropped_batches"]["guest ground"] > MOST_GUEST_ITEMS
        assert details["influences"] == ["a guest on the radio"]


def test_a_guest_that_sends_too_much_in_an_interval_raises(radio, tmp_path):
    logins = {"ground": GuestLogin(station=GROUND, user="guest-3", password=radio.passwords.guests[0])}
    access = GuestAccess(endpoint=radio.endpoint, run_id=RUN, guests=logins)
    (tmp_path / "guests.json").write_bytes(msgspec.json.encode(access))
    with Guest(tmp_path, name="ground") as ground:
        for _ in range(MOST_GUEST_ITEMS):
            ground.broadcast(b"")
        for _ in range(2):
            with pytest.raises(
                RadioFull, match=r"station 3: the 802\.11 emulator has dropped 1 transmissions"
            ):
                ground.broadcast(b"")
        radio.advance(8_000)
        ground.broadcast(b"")
    assert radio.stop()["dropped_batches"] == {"guest ground": 2}


# --- in a flight

FLIGHT = ["radio.guests=[{name='ground', pos_ned_m=[0.0, -20.0, -1.5]}]", "formation.height_m=2"]


def test_a_guest_that_only_attacks_changes_no_byte_of_a_flight(swarm):
    summaries = []
    for link in ("unix", "tcp"):
        overrides = [*FLIGHT, f"ports.radio_link={link}"]
        flight = swarm(ARTICLE, agents=2, overrides=overrides)
        flight.run_for(0.1)
        access = read_guest_access(flight.path)
        assert stat.S_IMODE((flight.path / "guests.json").stat().st_mode) == 0o600
        assert access.endpoint.startswith("tcp/127.0.0.1:" if link == "tcp" else "unixsock-stream/")
        with Guest(flight.path, name="ground") as ground:
            session = ground._transport
            keys = [transmit_key(access.run_id), receive_key(access.run_id, 1)]
            senders = [session.sender(key) for key in keys]
            for _ in range(20 if link == "tcp" else 0):
                now_us = flight.run_for(0.1).time_us
                for sender in senders:
                    sender.send(batch(0, now_us + 40_000))
                for key in keys:
                    assert reply(session, key, batch(0, now_us + 40_000)) is None
            flight.run(until_s=3.0)
        summaries.append(flight.summary(draw=False))
        assert not (flight.path / "guests.json").exists()
        assert flight.leftovers() == []
    assert [summary["deterministic"] for summary in summaries] == [True, True]
    assert summaries[0]["log_sha256"] == summaries[1]["log_sha256"]
    assert summaries[0]["frames"]["sent"] > 0


def test_a_flooded_flight_goes_on_and_names_the_flood(swarm):
    flight = swarm(ARTICLE, agents=2, overrides=FLIGHT)
    flight.run_for(0.1)
    login = read_guest_access(flight.path)
    station, user, password = msgspec.structs.astuple(login.guests["ground"])
    command = [
        sys.executable, "-c", FLOOD, login.endpoint, user, password,
        guest_transmit_key(login.run_id, station), "1000000000", batch(station, 0).hex(),
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as flooding:
        try:
            assert flooding.stdout.readline() == b"begun\n"
            flight.run_for(2.0)
        finally:
            flooding.kill()
    summary = flight.summary(draw=False)
    assert (summary["status"], summary["deterministic"]) == ("completed", False)
    manifest = json.loads((flight.path / "manifest.json").read_text())
    assert manifest["nondeterminism"] == ["radio received messages from a guest on the radio"]
    (details,) = (each["details"] for each in manifest["processes"] if each["name"] == "radio")
    assert details["malformed"] == {}
    log = (flight.path / "logs" / "radio.log").read_text()
    assert len(log.splitlines()) == len(details["dropped_batches"])


@pytest.mark.parametrize("victim", ["radio", "launcher"])
def test_a_killed_process_leaves_no_socket_after_the_next_launcher(tmp_path, victim, monkeypatch):
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    command = [
        sys.executable, "scripts/launch_swarm.py", ARTICLE, "--agents=2", "--out", str(tmp_path / "run"),
        *(f"--set={each}" for each in FLIGHT),
    ]  # fmt: skip
    with subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as launcher:
        try:
            folder = tmp_path / "run"
            wait_until((folder / "raw" / "uav-1.bin").exists, "the vehicles write their logs")
            (sockets,) = tmp_path.glob("coflight-radio-*")
            monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
            SocketFolder().remove()
            assert (sockets / SOCKET).exists()  # of a launcher that lives
            processes = psutil.Process(launcher.pid).children()
            if victim == "radio":
                (pid,) = (each.pid for each in processes if "netsim" in each.cmdline())
                os.kill(pid, signal.SIGKILL)
                launcher.wait(LIMIT_S)
            else:
                launcher.kill()
                psutil.wait_procs(processes, timeout=LIMIT_S)
        finally:
            launcher.kill()
    assert sockets.exists() is (victim == "launcher")  # the kernel kills the emulator with its launcher
    SocketFolder().remove()
    assert not sockets.exists()


def test_connections_that_send_nothing_do_not_lock_clients_out():
    with router(link="tcp") as listener, contextlib.ExitStack() as stack:
        host, _, port = listener.endpoint.removeprefix("tcp/").rpartition(":")
        for _ in range(300):
            stack.enter_context(socket.create_connection((host, int(port)), LIMIT_S))
        Transport.connect(listener.endpoint, TESTER, limit_s=5.0).close()


# --- the emulator alone


@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGHUP, 128 + signal.SIGHUP), (signal.SIGINT, 130)],
)
def test_an_emulator_alone_serves_guests_over_tcp_and_removes_its_files(number, status):
    command = [sys.executable, "scripts/wifi_lab.py", "serve", "--port", "0"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as server:
        try:
            folder = Path(server.stdout.readline().split()[0])
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
            assert read_guest_access(folder).endpoint.startswith("tcp/127.0.0.1:")
            with Guest(folder, name="s0") as one, Guest(folder / "guests.json", name="s1") as other:
                one.broadcast(b"over TCP")
                assert other.receive(timeout_s=LIMIT_S)[0].payload == b"over TCP"
            for _ in range(3):  # a closed terminal sends several
                server.send_signal(number)
            assert server.wait(LIMIT_S) == status
        finally:
            server.kill()
    assert not folder.exists()


def test_a_host_without_a_port_is_refused():
    command = [sys.executable, "scripts/wifi_lab.py", "serve", "--host", "0.0.0.0"]  # noqa: S104
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    assert done.returncode == 2
    assert "--host 0.0.0.0 requires --port" in done.stderr
    assert done.stderr.count("\n") == 1
