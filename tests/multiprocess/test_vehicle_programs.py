"""Unmodified programs on vehicles: ping, sockets and their checksums, floods, restarts, stops."""

import contextlib
import socket
import struct
import subprocess
import sys
import types
from pathlib import Path

import psutil
import pytest
from supervising import wait_for
from vehicle_programs import HostProcess, namespaces, needs, programs_on_vehicles  # noqa: F401  a fixture

from foundation.processes.child_protocol import Ready
from netsim.network.ethernet import build
from netsim.network.messages import CompanionLink, ProgramEnded, ProgramStarted
from netsim.wire.addresses import mac_address

pytestmark = [pytest.mark.multiprocess, pytest.mark.usefixtures("namespaces")]

RECEIVER = """
import socket, struct, sys
index = socket.if_nametoindex("wlan0")
v4 = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
v4.bind(("", 5000))
group = struct.pack("4s4si", socket.inet_aton("239.1.2.3"), bytes(4), index)
v4.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
v6 = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)
v6.bind(("::", 5001))
print("bound", flush=True)
for each, count in ((v4, 3), (v6, 1)):
    for _ in range(count):
        data, sender = each.recvfrom(2000)
        print(data.decode(), sender[0], flush=True)
"""
SENDER = """
import socket
v4 = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
v4.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
for host in ("255.255.255.255", "10.255.255.255", "239.1.2.3"):
    v4.sendto(host.encode(), (host, 5000))
v6 = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)
v6.sendto(b"ff02::1", ("ff02::1", 5001, 0, socket.if_nametoindex("wlan0")))
"""
TCP_SERVER = """
import socket
server = socket.create_server(("", 6000))
print("bound", flush=True)
connection, _ = server.accept()
received = b""
while data := connection.recv(65536):
    received += data
print(len(received), set(received) == {7}, flush=True)
"""
TCP_CLIENT = """
import socket
with socket.create_connection(("10.1.0.3", 6000)) as connection:
    connection.sendall(bytes([7]) * 200_000)
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams:
    datagrams.sendto(bytes(5000), ("10.1.0.3", 6001))
"""
FLOOD = """
import socket
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
for number in range(500):
    sender.sendto(number.to_bytes(2, "big"), ("10.255.255.255", 5000))
"""
FORGER = """
import socket
raw = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
raw.bind(("wlan0", 0))
raw.send(bytes.fromhex("ffffffffffff" "020000000001" "88b5") + bytes(46))
raw.send(bytes.fromhex("ffffffffffff" "020000000000" "88b5") + bytes(46))
"""
TAP = Path("/dev/net/tun")
both_interfaces = pytest.mark.parametrize(
    "interfaces",
    ["veth", pytest.param("tap", marks=pytest.mark.skipif(not TAP.exists(), reason=f"there is no {TAP}"))],
)
WITHOUT_VETH = """
import sys
from netsim.network import __main__, interfaces
def make_pair(*_):
    raise interfaces.NoVeth("no veth")
interfaces.make_pair = interfaces.make_companion_pair = make_pair
sys.argv[1:] = sys.argv[4:]
sys.exit(__main__.main())
"""
"""The process on a kernel that makes no veth pairs; its arguments follow those of ``python``."""
both_users = pytest.mark.parametrize("other_user", [False, True], ids=["own user", "other user"])


def script(code):
    """Return the command of a Python script without coflight."""
    return sys.executable, "-I", "-S", "-c", code


def public_script(code, *, other_user):
    return ("/usr/bin/python3", "-c", code) if other_user else script(code)


@needs("ping", "setpriv")
@both_users
def test_vehicles_ping_each_other_and_resolve_their_addresses(other_user):
    command = (
        "ping -c 3 -i 0.2 10.1.0.3; ping -6 -c 2 -i 0.2 ff02::1%wlan0; cat /proc/net/arp /proc/net/if_inet6"
    )
    with programs_on_vehicles([(0, ["sh", "-c", command])], other_user=other_user) as (_, host):
        host.start()
        assert host.event(ProgramEnded).returncode == 0
        log = host.log(0)
    assert "3 packets transmitted, 3 received, 0% packet loss" in log
    assert any(
        line.split()[0] == "10.1.0.3" and "02:00:00:00:00:03" in line for line in log.splitlines() if line
    )
    for station in (1, 3):
        assert f"from fe80::ff:fe00:{station}%wlan0" in log
    assert "fe8000000000000000000000ff" not in log  # the link-local address has no tentative copy
    (local,) = [line for line in log.splitlines() if line.endswith("wlan0") and line.startswith("fe80")]
    assert local.split()[0] == "fe80000000000000000000fffe000000"
    assert int(local.split()[4], 16) & 0x40 == 0  # IFA_F_TENTATIVE


@needs("setpriv")
@both_users
def test_scripts_receive_broadcasts_and_multicasts(other_user):
    receivers = [(station, public_script(RECEIVER, other_user=other_user)) for station in (1, 3)]
    programs = [(0, public_script(SENDER, other_user=other_user)), *receivers]
    with programs_on_vehicles(programs, other_user=other_user) as (_, host):
        host.start([1, 2])
        for index in (1, 2):
            host.wait_for_log(index, "bound")
        host.start()
        for index in (1, 2):
            *_, first, second, third, fourth = host.wait_for_log(index, "ff02::1").splitlines()
            assert first == "255.255.255.255 10.1.0.0"
            assert second == "10.255.255.255 10.1.0.0"
            assert third == "239.1.2.3 10.1.0.0"
            assert fourth == "ff02::1 fe80::ff:fe00:0"
        counters = host.stop()
    assert counters["programs"] == {"started": 3, "failed": 0, "orphans": 0}


@needs("tshark")
@both_interfaces
def test_packets_are_complete_when_they_are_read(tmp_path, interfaces):
    programs = [(3, script(TCP_SERVER)), (0, script(TCP_CLIENT))]
    with programs_on_vehicles(programs, interfaces=interfaces) as (channel, host):
        host.start([0])
        host.wait_for_log(0, "bound")
        host.start()
        assert host.event(ProgramEnded, program=1).returncode == 0
        assert "200000 True" in host.wait_for_log(0, "200000")
        wait_for(lambda: sum(each.payload[9] == 17 for each in ipv4(channel)) >= 4, "four fragments")
        packets = [each for each in ipv4(channel) if each.payload[9] in {6, 17}]  # TCP, UDP
    assert max(len(each.payload) for each in packets) == 1500
    capture = tmp_path / "packets.pcap"
    with capture.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1))
        for each in packets:
            frame = build(each.destination, mac_address(each.station), each.ether_type, each.payload)
            file.write(struct.pack("<IIII", 0, 0, len(frame), len(frame)) + frame)
    options = [f"-o{name}.check_checksum:TRUE" for name in ("ip", "udp", "tcp")]
    fields = [f"-e{name}.checksum.status" for name in ("ip", "udp", "tcp")]
    command = ["tshark", "-r", str(capture), *options, "-Tfields", *fields]
    table = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    statuses = [line.split("\t") for line in table.splitlines()]
    assert len(statuses) == len(packets)
    checked = [set(",".join(column).split(",")) for column in zip(*statuses, strict=True)]
    assert checked == [{"1"}, {"", "1"}, {"", "1"}]  # good, or of another protocol


def ipv4(channel):
    return [each for each in channel.packets if each.ether_type == 0x0800]


@both_interfaces
def test_flood_waits_in_the_kernel_until_packets_have_ended(interfaces):
    window = 20
    settings = {"hold": True, "window_packets": window, "interfaces": interfaces}
    with programs_on_vehicles([(0, script(FLOOD))], **settings) as (channel, host):
        host.start()
        assert host.event(ProgramEnded).returncode == 0
        wait_for(lambda: sum(each.station == 0 for each in channel.packets) == window, "a full window")
        channel.release()
        wait_for(lambda: len(flood(channel)) == 500, "the rest of the flood")
        counters = host.stop()["bridge"]
    assert flood(channel) == list(range(500))
    assert counters["outstanding_packets"] <= 1  # a multicast of the kernel may have been sent at the end
    assert counters["kernel_drops"] == {}


@pytest.mark.skipif(not TAP.exists(), reason=f"there is no {TAP}")
@needs("ping")
def test_kernel_without_veth_has_tap_interfaces_alone():
    command = ["sh", "-c", "ping -c 2 -i 0.2 10.1.0.3; cat /proc/net/dev"]
    link = CompanionLink(
        station=0, companion_host="127.0.0.1", companion_port=0, autopilot_host="127.0.0.1", autopilot_port=0
    )
    # without threads, of which there may be none yet
    before = ("env", "OPENBLAS_NUM_THREADS=1", sys.executable, "-c", WITHOUT_VETH)
    with programs_on_vehicles([(0, command)], before=before, companions=(link,)) as (_, host):
        host.start()
        assert host.event(ProgramEnded).returncode == 0
        log = host.log(0)
        host.stop()
        lines = host.process.stderr.read().decode().splitlines()
    assert "2 received, 0% packet loss" in log
    assert "eth0" not in log
    assert lines == ["network: programs do not reach their autopilots: no veth"]


def flood(channel):
    packets = [each.payload for each in ipv4(channel) if each.payload[9] == 17]
    return [int.from_bytes(each[28:30], "big") for each in packets]


def test_forged_sources_and_invalid_messages_are_dropped_and_counted():
    with programs_on_vehicles([(0, script(FORGER))]) as (channel, host):
        for payload in (b"", b"\x00", bytes(300)):
            channel.publish_bytes(payload)
        host.start()
        assert host.event(ProgramEnded).returncode == 0
        wait_for(lambda: any(each.ether_type == 0x88B5 for each in channel.packets), "the frame of its own")
        assert [each.station for each in channel.packets if each.ether_type == 0x88B5] == [0]
        counters = host.stop()["bridge"]
    assert counters["dropped_frames"]["source"] == 1
    assert counters["malformed_messages"] == 3


def test_programs_see_only_their_vehicle_and_the_host_keeps_its_interfaces():
    before = psutil.net_if_addrs()
    names = (
        "import os, socket; print(sorted(dict(socket.if_nameindex()).values()), os.getsid(0) == os.getpid())"
    )
    files = "import os; print(sorted(os.listdir('/proc/self/fd')))"
    programs = [
        (1, script(names)),
        (1, ["sh", "-c", 'echo "$COLOUR"; pwd'], {"environment": {"COLOUR": "red"}}),
        (1, script(files)),
    ]
    with programs_on_vehicles(programs) as (_, host):
        host.start()
        assert "['lo', 'wlan0'] True" in host.wait_for_log(0, "\n")
        assert host.wait_for_log(1, str(host.folder)).splitlines()[0] == "red"
        assert host.wait_for_log(2, "\n") == "['0', '1', '2', '3']\n"  # 3 is of the folder that is listed
        assert psutil.net_if_addrs() == before
        host.stop()
    assert psutil.net_if_addrs() == before


@needs("unshare")
def test_sysfs_and_host_names_are_those_of_the_vehicle():
    mount = [
        "unshare",
        "--user",
        "--map-root-user",
        "--mount",
        "--net",
        "mount",
        "-t",
        "sysfs",
        "none",
        "/sys",
    ]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("sysfs cannot be mounted here")
    before = sorted(Path("/sys/class/net").iterdir()), Path("/etc/hosts").read_bytes()
    names = "import socket; print(socket.gethostbyname('uav-3'), socket.gethostbyname('localhost'))"
    programs = [(1, ["ls", "/sys/class/net"]), (1, script(names)), (1, ["sh", "-c", "echo > /etc/hosts"])]
    with programs_on_vehicles(programs) as (_, host):
        host.start()
        assert host.wait_for_log(0, "wlan0").split() == ["lo", "wlan0"]
        assert host.wait_for_log(1, "\n") == "10.1.0.3 127.0.0.1\n"
        assert host.event(ProgramEnded, program=2).returncode != 0  # all vehicles have the same file
        host.stop()
    assert before == (sorted(Path("/sys/class/net").iterdir()), Path("/etc/hosts").read_bytes())


def test_statuses_of_programs_and_their_restarts():
    programs = [
        (0, ["sh", "-c", "exit 3"], {"restart": "on_failure"}),
        (0, ["sh", "-c", "kill -9 $$"]),
        (1, ["/no/such/program"]),
        (1, ["/etc/passwd"]),
        (1, ["true"], {"log_path": "/no/such/folder/log"}),
        (1, ["true"], {"restart": "on_failure"}),
    ]
    with programs_on_vehicles(programs) as (_, host):
        host.start()
        ended = [host.event(ProgramEnded) for _ in programs]
        statuses = {each.program: (each.returncode, each.restart_in_s) for each in ended}
        assert statuses == {
            0: (3, 0.5), 1: (-9, None), 2: (127, None), 3: (126, None), 4: (127, None), 5: (0, None)
        }  # fmt: skip
        assert host.log(2) == "/no/such/program: No such file or directory\n"
        host.event(ProgramStarted, program=0)
        assert host.event(ProgramEnded, program=0).restart_in_s == 1.0
        counters = host.stop()["programs"]
    assert (counters["started"], counters["failed"]) == (7, 6)


def test_stop_ends_programs_that_ignore_it_and_reaps_orphans():
    orphan = (
        "trap 'echo asked' TERM; (sleep 0.05 & echo $! > orphan); while kill -0 $(cat orphan); do :; done"
    )
    command = f"{orphan}; echo running; while true; do sleep 0.1; done"
    with programs_on_vehicles([(0, ["sh", "-c", command]), (1, ["sleep", "1000"])]) as (_, host):
        host.start()
        host.wait_for_log(0, "running")
        host.command(command="start programs", programs=[7])  # there is none
        details = host.stop()
        assert "asked" in host.log(0)
    assert details["programs"] == {"started": 2, "failed": 0, "orphans": 1}


def test_unreachable_emulator_is_one_line():
    with socket.create_server(("127.0.0.1", 0)) as server:
        closed = types.SimpleNamespace(endpoint=f"tcp/127.0.0.1:{server.getsockname()[1]}", stations=(0,))
    with contextlib.closing(HostProcess(closed, [])) as host:
        with pytest.raises(AssertionError, match=r"^no Ready: network: .*\n$"):
            host.event(Ready)
        assert host.process.wait(10.0) == 2
