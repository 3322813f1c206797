"""Network namespaces of all vehicles with their interfaces, made by a process that ends afterwards.

A thread that has left the host's network namespace cannot return to it, as it has no privileges there. So a
child process makes the namespaces, and passes sockets and descriptors of the namespaces to this one.
For each vehicle a small process remains, the holder, by which other processes can enter its namespaces
(`netsim.network.vehicle_entry`).
"""

import contextlib
import os
import signal
import socket
import time
from collections.abc import Collection, Sequence
from ipaddress import IPv4Address
from typing import NamedTuple, NoReturn

import msgspec

from foundation.system_error import described
from netsim.network.companion_sockets import AUTOPILOT, CompanionSockets
from netsim.network.namespaces import (
    CLONE_NEWNET,
    new_network_namespace,
    outer_pid,
    own_mount_namespace,
    set_namespace,
)
from netsim.network.vehicle_files import add_host_names, new_mount_namespace
from netsim.wire.addresses import ipv4_address
from netsim.wire.messages import Station

_RUNNING_LIMIT_S = 10.0
"""Wall time that the kernel has to report that an interface can send; it takes milliseconds."""
_POLL_S = 0.002
_MOST_BYTES = 65_536


class Namespaces(NamedTuple):
    """Descriptors of the namespaces of a vehicle's programs."""

    network_fd: int
    mounts_fd: int


class VehicleNetwork(NamedTuple):
    """What this process has of a vehicle's network."""

    station: Station
    namespaces: Namespaces
    frames: socket.socket
    """Packet socket of the bridge's end of the interface"""
    holder_pid: int
    """As the host numbers processes"""
    companion: CompanionSockets | None
    """Of ``eth0``, if it has one"""


class NetworksNotMade(OSError):
    """Namespaces or interfaces cannot be made; the text is one line."""


class _Made(msgspec.Struct, tag=True):
    station: Station
    holder_pid: int
    companion_index: int | None
    """Of ``eth0``. Descriptors: two namespaces, packet socket, and of ``eth0`` UDP socket and diagnostics."""


class _Failed(msgspec.Struct, tag=True):
    reason: str


_answers = msgspec.json.Decoder(_Made | _Failed)


def make_networks(
    stations: Sequence[Station], companions: Collection[Station], outer_proc: int
) -> list[VehicleNetwork]:
    """Return a network for each station, with interfaces that can send, and ``eth0`` for ``companions``.

    ``/etc/hosts`` of this process and of the vehicles has the names ``uav-0`` and so on.

    To be called with one thread in `namespaces.run_as_first_process`, whose descriptor of the host's
    ``/proc`` it takes. Raises NetworksNotMade.
    """
    names = {f"uav-{each}": str(IPv4Address(ipv4_address(each))) for each in stations}
    add_host_names(names | ({"autopilot": AUTOPILOT[0]} if companions else {}))
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    pid = os.fork()
    if pid == 0:
        ours.close()
        _make(stations, companions, outer_proc, theirs)
    theirs.close()
    networks = []
    with ours:
        while True:
            answer, fds, _, _ = socket.recv_fds(ours, _MOST_BYTES, 5)  # ignores its flags in Python 3.11
            for fd in fds:
                os.set_inheritable(fd, False)  # noqa: FBT003  or all programs would have them
            if not answer:
                break
            match _answers.decode(answer):
                case _Made() as made:
                    networks.append(_received(made, *fds))
                case _Failed(reason):
                    raise NetworksNotMade(reason)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if status or len(networks) != len(stations):
        raise NetworksNotMade(f"the process that makes the vehicles' networks ended with status {status}")
    return networks


def _received(
    made: _Made, network_fd: int, mounts_fd: int, frames_fd: int, *companion_fds: int
) -> VehicleNetwork:
    companion = None
    if made.companion_index is not None:
        autopilot, *others = (socket.socket(fileno=fd) for fd in companion_fds)
        companion = CompanionSockets(autopilot, made.companion_index, others[0] if others else None)
    namespaces, frames = Namespaces(network_fd, mounts_fd), socket.socket(fileno=frames_fd)
    return VehicleNetwork(made.station, namespaces, frames, made.holder_pid, companion)


def _make(
    stations: Sequence[Station], companions: Collection[Station], outer_proc: int, answers: socket.socket
) -> NoReturn:
    """Make the networks, send them, and exit; must not return into the parent's code."""
    status = 1
    try:
        bridge, mounts = new_network_namespace(), own_mount_namespace()
        made = []
        for station in stations:  # before the import of pyroute2, so that the holders are small
            namespaces = Namespaces(new_network_namespace(), new_mount_namespace(mounts))
            made.append((station, namespaces, _start_holder(station, outer_proc)))
        networks = [(station, namespaces.network_fd) for station, namespaces, _ in made]
        interfaces = zip(
            made, _with_interfaces(bridge, networks), _with_companions(networks, companions), strict=True
        )
        for (station, namespaces, holder_pid), frames, companion in interfaces:
            answer = _Made(station, holder_pid, None if companion is None else companion.interface)
            files = [frames]
            if companion is not None:
                files += filter(None, (companion.autopilot, companion.diagnostics))
            fds = [*namespaces, *(each.fileno() for each in files)]
            socket.send_fds(answers, [msgspec.json.encode(answer)], fds)
        status = 0
    except BaseException as error:  # noqa: BLE001  reported by the parent
        answers.send(msgspec.json.encode(_Failed(described(error))))
    finally:
        os._exit(status)


def _with_interfaces(bridge: int, namespaces: Sequence[tuple[Station, int]]) -> list[socket.socket]:
    """Make the interfaces of all vehicles and return their packet sockets."""
    from netsim.network import interfaces, packet_socket  # noqa: PLC0415  after the holders have been forked

    set_namespace(bridge, CLONE_NEWNET)
    interfaces.disable_ipv6()
    sockets = []
    for station, namespace_fd in namespaces:
        interfaces.make_pair(station, namespace_fd)
        sockets.append(packet_socket.open_packet_socket(interfaces.peer_name(station)))
    for station, namespace_fd in namespaces:
        set_namespace(namespace_fd, CLONE_NEWNET)
        interfaces.configure(station)
    wall_deadline_s = time.monotonic() + _RUNNING_LIMIT_S
    for station, namespace_fd in namespaces:
        set_namespace(namespace_fd, CLONE_NEWNET)
        while not interfaces.is_running(interfaces.INTERFACE):
            if time.monotonic() > wall_deadline_s:
                raise NetworksNotMade(f"station {station}: {interfaces.INTERFACE} does not get up")
            time.sleep(_POLL_S)
    return sockets


def _with_companions(
    namespaces: Sequence[tuple[Station, int]], companions: Collection[Station]
) -> list[CompanionSockets | None]:
    """Make ``eth0`` of the vehicles that have one and return their sockets."""
    from netsim.network.companion_interface import make_companion  # noqa: PLC0415  likewise

    return [make_companion(*each) if each[0] in companions else None for each in namespaces]


def _start_holder(station: Station, outer_proc: int) -> int:
    """Fork a process that stays in the present network namespace; return its process id of the host."""
    reader, writer = os.pipe()
    if os.fork() == 0:
        _hold(outer_proc, writer)
    os.close(writer)
    with os.fdopen(reader, "rb") as answer:
        text = answer.read()
    if not text:
        raise NetworksNotMade(f"station {station}: the process that holds its namespace has ended")
    return int(text)


def _hold(outer_proc: int, answer: int) -> NoReturn:
    """Report the process id, close all files, and wait for a signal."""
    try:
        os.setsid()
        for number in (signal.SIGINT, signal.SIGPIPE):
            signal.signal(number, signal.SIG_DFL)
        os.write(answer, str(outer_pid(outer_proc)).encode())
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        with contextlib.suppress(OSError, ValueError):
            os.closerange(3, os.sysconf("SC_OPEN_MAX"))
        while True:
            signal.pause()
    finally:
        os._exit(1)
