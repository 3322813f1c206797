"""``eth0`` of vehicles: datagrams between programs and their own vehicle's autopilot, beside the radio."""

import contextlib
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from supervising import wait_for
from vehicle_programs import as_other, namespaces, needs, programs_on_vehicles  # noqa: F401  a fixture

from netsim.network.autopilot_relay import DATAGRAMS_PER_PERIOD, PERIOD_S
from netsim.network.companion_sockets import AUTOPILOT, PROGRAM
from netsim.network.messages import CompanionLink, ProgramEnded

pytestmark = [pytest.mark.multiprocess, pytest.mark.usefixtures("namespaces")]

HOST = "127.0.0.1"
IP_RECVERR = 11  # linux/in.h
ECHO = """
import socket
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.bind(("0.0.0.0", 14540))
print("bound", flush=True)
while True:
    data, sender = link.recvfrom(2000)
    print(data.decode(), *sender, flush=True)
    link.sendto(b"echo " + data, sender)
    if data == b"end":
        break
"""
CALLER = """
import socket
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.settimeout(10.0)
link.sendto(b"call", ("192.168.0.1", 14580))
print(link.recv(2000).decode(), flush=True)
"""
FLOOD = """
import socket, time
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
end_s = time.monotonic() + 1.0
while time.monotonic() < end_s:
    link.sendto(bytes(100), ("192.168.0.1", 14580))
"""
PING = "ping -c 20 -i 0.05 10.1.0.1"


class Autopilot:
    """A socket in the place of an autopilot's companion link."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((HOST, 0))
        self.socket.settimeout(10.0)
        self.port = self.socket.getsockname()[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind((HOST, 0))
            self.companion_port = free.getsockname()[1]

    def link(self, station, **settings):
        ports = {"companion_port": self.companion_port, "autopilot_port": self.port}
        return CompanionLink(station=station, companion_host=HOST, autopilot_host=HOST, **ports | settings)

    def has_listener(self):
        """Return whether the port to which it sends is bound."""
        lines = Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]
        return any(int(line.split()[1].partition(":")[2], 16) == self.companion_port for line in lines)

    def is_received(self, data):
        """Send a datagram and return whether the kernel has passed it to a socket."""
        self.socket.setsockopt(socket.IPPROTO_IP, IP_RECVERR, 1)
        self.send(data)
        self.socket.settimeout(0.0)
        try:
            self.socket.recvmsg(1, 512, socket.MSG_ERRQUEUE)  # of the loopback: it is there at once
        except BlockingIOError:
            return True
        finally:
            self.socket.settimeout(10.0)
        return False

    def send(self, data):
        self.socket.sendto(data, (HOST, self.companion_port))

    def close(self):
        self.socket.close()


@contextlib.contextmanager
def links(programs, count=1, *, stations=(0, 1), settings=None, **others):
    """Yield stand-ins for the autopilots of the first stations, the channel and the process of programs."""
    with contextlib.ExitStack() as stack:
        autopilots = [stack.enter_context(contextlib.closing(Autopilot())) for _ in range(count)]
        companions = tuple(each.link(i, **settings or {}) for i, each in enumerate(autopilots))
        both = programs_on_vehicles(programs, stations=stations, companions=companions, **others)
        yield autopilots, *stack.enter_context(both)


def python(code):
    return sys.executable, "-I", "-S", "-c", code


def test_each_program_exchanges_datagrams_with_its_own_autopilot():
    with links([(0, python(ECHO)), (1, python(ECHO))], 2) as (autopilots, channel, host):
        assert not any(each.has_listener() for each in autopilots)  # no program receives yet
        host.start()
        for i, autopilot in enumerate(autopilots):
            host.wait_for_log(i, "bound")
            wait_for(autopilot.has_listener, "a listener for the autopilot")
            autopilot.send(f"of {i}".encode())
            host.wait_for_log(i, f"of {i} {AUTOPILOT[0]} {AUTOPILOT[1]}")
            data, sender = autopilot.socket.recvfrom(100)
            assert (data, sender[1]) == (f"echo of {i}".encode(), autopilot.companion_port)
        autopilots[0].send(b"end")
        host.event(ProgramEnded, program=0)
        wait_for(lambda: not autopilots[0].has_listener(), "the end of the listener")
        assert autopilots[1].has_listener()
        for i in range(2):
            assert f"of {1 - i}" not in host.log(i)
        counters = host.stop()["autopilot_links"]
    assert (counters["to_autopilots"], counters["to_programs"]) == (3, 3)
    udp = [each.payload for each in channel.packets if each.ether_type == 0x0800 and each.payload[9] == 17]
    assert not any(PROGRAM[1].to_bytes(2, "big") in each[20:24] for each in udp)


@pytest.mark.parametrize("knows_port", [True, False], ids=["known autopilot", "any autopilot"])
def test_free_port_is_reported_and_refuses_while_no_program_receives(knows_port):
    settings = {"companion_port": 0} | ({} if knows_port else {"autopilot_port": 0})
    with links([(0, python(ECHO))], settings=settings) as ((autopilot,), _, host):
        autopilot.companion_port = host.ready.details["companion_ports"]["0"]
        wait_for(lambda: not autopilot.is_received(b"early"), "a refusal")
        host.start()
        host.wait_for_log(0, "bound")
        wait_for(lambda: autopilot.is_received(b"late"), "a receiver")
        host.wait_for_log(0, "late")
        autopilot.send(b"end")
        host.event(ProgramEnded)
        assert "early" not in host.log(0)
        wait_for(lambda: not autopilot.is_received(b"later"), "a refusal")


def test_programs_at_other_ports_are_answered():
    with links([(0, python(CALLER)), (0, python(CALLER))]) as ((autopilot,), _, host):
        host.start()
        senders = set()
        for _ in range(2):
            data, sender = autopilot.socket.recvfrom(100)
            assert data == b"call"
            senders.add(sender)
            autopilot.socket.sendto(f"to {sender[1]}".encode(), sender)
        assert len(senders) == 2
        for _ in range(2):
            assert host.event(ProgramEnded).returncode == 0
        assert {host.log(0), host.log(1)} == {f"to {port}\n" for _, port in senders}


@needs("ping")
def test_flood_is_limited_and_does_not_delay_the_radio():
    with links([(0, python(FLOOD)), (0, ["sh", "-c", PING])]) as (_, _, host):
        begin_s = time.monotonic()
        host.start()
        for _ in range(2):
            assert host.event(ProgramEnded).returncode == 0
        assert "20 received, 0% packet loss" in host.log(1)
        counters = host.stop()
        periods = (time.monotonic() - begin_s) / PERIOD_S + 2
    relayed = counters["autopilot_links"]
    assert DATAGRAMS_PER_PERIOD <= relayed["to_autopilots"] <= DATAGRAMS_PER_PERIOD * periods
    assert relayed["pauses"] > 0


@needs("setpriv")
@pytest.mark.parametrize("checks_owner", [True, False], ids=["own", "any"])
def test_autopilot_at_any_port_is_of_the_runs_user(checks_owner):
    settings = {"autopilot_port": 0, "checks_owner": checks_owner}
    with links([(0, python(ECHO))], settings=settings) as ((autopilot,), _, host):
        host.start()
        wait_for(autopilot.has_listener, "a listener for the autopilot")
        code = f"""
import socket
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.sendto(b"foreign", ("{HOST}", {autopilot.companion_port}))
link.settimeout(1.0)
print(link.recv(100).decode())
"""
        foreign = subprocess.run(
            [*as_other(), "/usr/bin/python3", "-c", code], capture_output=True, text=True, check=False
        )
        assert foreign.stdout == ("" if checks_owner else "echo foreign\n")
        if checks_owner:
            autopilot.send(b"own")
            assert autopilot.socket.recv(100) == b"echo own"
            assert host.stop()["autopilot_links"]["foreign"] == 1


def test_port_in_use_is_one_line():
    with links([(0, python(ECHO))]) as ((autopilot,), _, host):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind((HOST, autopilot.companion_port))
            host.start()
            host.wait_for_log(0, "bound")
            time.sleep(2.5 * PERIOD_S)
        wait_for(autopilot.has_listener, "a listener for the autopilot")
        host.stop()
        (line,) = host.process.stderr.read().decode().splitlines()
    assert f"eth0 has no autopilot: UDP {HOST}:{autopilot.companion_port}: " in line


def test_stations_without_a_link_have_no_interface():
    command = ["cat", "/proc/net/dev"]
    with links([(0, command), (1, command)]) as (_, _, host):
        host.start()
        for _ in range(2):
            assert host.event(ProgramEnded).returncode == 0
        assert ["eth0:" in host.log(i) for i in range(2)] == [True, False]
