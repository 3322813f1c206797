"""Other programs of this machine at a run's sockets: at most they are counted, and no flight changes."""

import contextlib
import json
import os
import socket
import sys
import tempfile
import threading
from pathlib import Path

import psutil
import pytest
from external_swarms import free_base
from other_user import OTHER_UID, as_other_user, root_only
from paths import SCENARIOS
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from foundation.processes.child_protocol import Warned
from foundation.processes.socket_owners import read_tables
from harness.launch.process_commands import PHYSICS, PREFORK, RADIO, uav
from harness.launch.swarm import Swarm

pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(sys.platform != "linux", reason="Linux's tables of sockets"),
]

ARTICLE = SCENARIOS / "article.toml"
HERE = "127.0.0.1"
UNTIL_S = 3.0
IDLE = 100
INTRODUCTION = Encoder(system=1, component=1).encode(common.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))
DISARM = Encoder(system=255, component=190).encode(
    common.MAVLink_command_long_message(1, 1, common.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, 0, 0, 0, 0, 0)
)


def make(folder, *overrides, ports="free"):
    overrides = ["formation.rows=1", "formation.columns=2", *overrides]
    return Swarm(ARTICLE, agents=2, seed=3, overrides=overrides, out=folder, ports=ports, wall_limit_s=200.0)


def finished(flown):
    """Return the summary, the manifest and the details of each process."""
    summary = flown.summary(draw=False)
    manifest = json.loads((flown.path / "manifest.json").read_text())
    return summary, manifest, {each["name"]: each["details"] for each in manifest["processes"]}


def warnings_of(flown, name):
    return [event.text for event in flown.events if isinstance(event, Warned) and event.name == name]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Return the hash of an undisturbed flight, and the sockets of its processes while it flew."""
    with make(tmp_path_factory.mktemp("undisturbed") / "run") as flown:
        flown.run(until_s=1.0)
        names = (PHYSICS, PREFORK, RADIO, uav(0), uav(1))
        sockets = {name: psutil.Process(flown.pids[name]).net_connections("all") for name in names}
        sockets["launcher"] = psutil.Process().net_connections("all")
        flown.run(until_s=UNTIL_S)
        return flown.summary(draw=False)["log_sha256"], sockets


def test_a_run_of_own_vehicles_listens_at_the_radios_private_socket_alone(undisturbed):
    _, sockets = undisturbed
    listening = [c for found in sockets.values() for c in found if c.status == psutil.CONN_LISTEN]
    assert listening == []
    named = {
        name: {c.laddr for c in found if c.family == socket.AF_UNIX and c.laddr}
        for name, found in sockets.items()
    }
    assert [name for name, paths in named.items() if paths] == [RADIO]
    (path,) = named[RADIO]
    assert path.startswith("/")  # not abstract: its folder protects it
    assert not [c for c in sockets[PHYSICS] if c.family == socket.AF_INET]


class Crowd:
    """A thread that connects to a port as soon as it listens; each second one claims to be vehicle 0."""

    def __init__(self, port):
        self._address = (HERE, port)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.connected = 0

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()

    def _run(self):
        with contextlib.ExitStack() as stack:
            while not self._ended.is_set() and self.connected < IDLE:
                try:
                    sock = stack.enter_context(socket.create_connection(self._address, 1.0))
                except OSError:
                    self._ended.wait(0.002)
                    continue
                with contextlib.suppress(OSError):
                    sock.sendall(INTRODUCTION if self.connected % 2 == 0 else b"")
                self.connected += 1
            self._ended.wait()


def test_a_crowd_at_a_tcp_port_takes_no_slot_delays_no_start_and_is_named(tmp_path, undisturbed):
    base = free_base(2, socket.SOCK_STREAM)
    ports = [f"ports.{name}=0" for name in ("gcs_local_udp", "companion_local_udp", "radio_tcp")]
    ports += ["ports.gcs_remote_udp=0", "ports.companion_remote_udp=0", f"ports.simulator_tcp={base}"]
    flown = make(tmp_path / "run", "ports.simulator_link=tcp", *ports, ports="scenario")
    with Crowd(base) as crowd, flown:
        flown.run(until_s=UNTIL_S)
        listening = [c for c in psutil.Process(flown.pids[PHYSICS]).net_connections() if c.status == "LISTEN"]
    summary, _, details = finished(flown)
    assert listening == []
    assert crowd.connected > IDLE // 2
    assert summary["log_sha256"] == undisturbed[0]
    assert summary["deterministic"]
    rejected = details[PHYSICS]["rejected_connections"]
    assert sum(entry["count"] for entry in rejected) > IDLE // 2
    assert {"port": base, "uid": os.geteuid(), "pid": os.getpid()}.items() <= rejected[0].items()
    warned = warnings_of(flown, PHYSICS)
    assert any(f"process {os.getpid()}" in text and f"port {base}" in text for text in warned)


@root_only
def test_another_user_neither_commands_a_vehicle_nor_receives_from_it(tmp_path, undisturbed):
    """It sends to both ports of a vehicle, and has taken the ground station's port before the start."""
    base = free_base(8)
    ports = ["ports.simulator_tcp=0", "ports.radio_tcp=0", "ports.companion_remote_udp=0"]
    ports += [f"ports.gcs_local_udp={base}", f"ports.companion_local_udp={base + 2}"]
    ports += [f"ports.gcs_remote_udp={base + 4}"]

    def bind_and_send():
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind((HERE, base + 4))

        def send():
            while True:
                for port in (base, base + 2):
                    with contextlib.suppress(OSError):
                        sock.sendto(DISARM, (HERE, port))
                threading.Event().wait(0.005)

        threading.Thread(target=send, daemon=True).start()
        return sock

    flown = make(tmp_path / "run", *ports, ports="scenario")
    with as_other_user(bind_and_send):
        with flown:
            flown.run(until_s=UNTIL_S)
        (line,) = [each for each in (read_tables("udp") or "").splitlines() if f":{base + 4:04X} 0" in each]
        assert line.split()[4] == "00000000:00000000"  # nothing waits in its socket
        assert int(line.split()[7]) == OTHER_UID
    summary, manifest, details = finished(flown)
    assert summary["log_sha256"] == undisturbed[0]
    assert summary["deterministic"]
    assert manifest["ground_messages"] == 0
    for link in ("ground_station", "companion"):
        assert details[uav(0)]["links"][link]["datagrams_foreign"] > 0
        assert details[uav(1)]["links"][link]["datagrams_foreign"] == 0
    warned = warnings_of(flown, uav(0))
    assert len(warned) == 2
    assert all("is of another user (links.local_senders)" in text for text in warned)


@pytest.fixture
def open_folder():
    """A folder that every user of the machine may enter and list, unlike pytest's."""
    with tempfile.TemporaryDirectory(prefix="open-") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


def can_open(path, flags):
    try:
        os.close(os.open(path, flags | os.O_NONBLOCK))
    except OSError:
        return False
    return True


def can_connect(family, address):
    with socket.socket(family, socket.SOCK_STREAM) as sock:
        sock.settimeout(2.0)
        try:
            sock.connect(address)
        except OSError:
            return False
        return True


def can_signal(pid):
    try:
        os.kill(pid, 0)
    except PermissionError:
        return False
    return True


@root_only
def test_another_user_opens_no_file_no_socket_and_no_process_of_a_run(open_folder, undisturbed):
    out = open_folder / "run"
    with make(out) as flown:
        flown.run(until_s=1.0)
        processes = [psutil.Process(pid) for pid in flown.pids.values()]
        opened = {file.path for process in processes for file in process.open_files()}
        private = {path for path in opened if not Path(path).is_relative_to(sys.prefix)} | set(out.rglob("*"))
        private |= {
            Path("/proc", str(process.pid), name) for process in processes for name in ("environ", "mem")
        }
        connections = [each for process in processes for each in process.net_connections("all")]
        listening = [(c.family, c.laddr) for c in connections if c.status == psutil.CONN_LISTEN]
        named = [(c.family, c.laddr) for c in connections if c.family == socket.AF_UNIX and c.laddr]

        def attack():
            reached = [path for path in private if can_open(path, os.O_RDONLY) or can_open(path, os.O_WRONLY)]
            reached += [address for address in {*listening, *named} if can_connect(*address)]
            reached += [process.pid for process in processes if can_signal(process.pid)]
            assert not reached, reached

        assert {out / "raw", out / "config" / "physics.json"} <= private
        assert len(named) > 0
        with as_other_user(attack):
            flown.run(until_s=UNTIL_S)
    assert flown.summary(draw=False)["log_sha256"] == undisturbed[0]


def test_the_own_user_commands_a_vehicle_and_receives_from_it(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind((HERE, 0))
        station.settimeout(10.0)
        ports = [f"ports.{name}=0" for name in ("simulator_tcp", "gcs_local_udp", "companion_local_udp")]
        ports += ["ports.radio_tcp=0", "ports.companion_remote_udp=0"]
        ports += [f"ports.gcs_remote_udp={station.getsockname()[1]}"]
        with make(tmp_path / "run", *ports, ports="scenario") as flown:
            flown.run(until_s=1.0)
            _, vehicle = station.recvfrom(2_048)
            station.sendto(DISARM, vehicle)
            flown.run(until_s=1.5)
        _, manifest, details = finished(flown)
    assert manifest["ground_messages"] == 1
    assert not manifest["deterministic"]
    assert sum(details[uav(i)]["links"]["ground_station"]["datagrams_foreign"] for i in range(2)) == 0
