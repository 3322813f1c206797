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
import sys
import time
from collections.abc import Collection, Sequence
from ipaddress import IPv4Address
from typing import NamedTuple, NoReturn

import msgspec

from foundation.system_error import described
from netsim.network.companion_sockets import AUTOPILOT, CompanionSockets
from netsim.network.messages import INTERFACE, Interfaces
from netsim.network.namespaces import (
    CLONE_NEWNET,
    new_network_namespace,
    outer_pid,
    own_mount_namespace,
    set_namespace,
)
from netsim.network.packet_socket import PacketSocket, open_packet_socket
from netsim.network.tap_file import QUEUE_FRAMES, TapFile, open_tap
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
    frames: PacketSocket | TapFile
    """Of ``wlan0``"""
    holder_pid: int
    """As the host numbers processes"""
    companion: CompanionSockets | None
    """Of ``eth0``, if it has one"""


class NetworksNotMade(OSError):
    """Namespaces or interfaces cannot be made; the text is one line."""


class _Made(msgspec.Struct, tag=True):
    station: Station
    holder_pid: int
    is_tap: bool
    companion_index: int | None
    """Of ``eth0``. Descriptors: two namespaces, packet socket or both files of the TAP, and of ``eth0`` UDP
    socket and diagnostics."""


class _Failed(msgspec.Struct, tag=True):
    reason: str


_answers = msgspec.json.Decoder(_Made | _Failed)


def make_networks(
    stations: Sequence[Station],
    companions: Collection[Station],
    outer_proc: int,
    interfaces: Interfaces = "auto",
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
        _make(stations, companions, outer_proc, interfaces, theirs)
    theirs.close()
    networks = []
    with ours:
        while True:
            answer, fds, _, _ = socket.recv_fds(ours, _MOST_BYTES, 6)  # ignores its flags in Python 3.11
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


def _received(made: _Made, network_fd: int, mounts_fd: int, frames_fd: int, *fds: int) -> VehicleNetwork:
    if made.is_tap:
        table_fd, *companion_fds = fds
        frames: PacketSocket | TapFile = TapFile(INTERFACE, frames_fd, table_fd)
    else:
        companion_fds = list(fds)
        frames = PacketSocket(socket.socket(fileno=frames_fd))
    companion = None
    if made.companion_index is not None:
        autopilot, *others = (socket.socket(fileno=fd) for fd in companion_fds)
        companion = CompanionSockets(autopilot, made.companion_index, others[0] if others else None)
    return VehicleNetwork(made.station, Namespaces(network_fd, mounts_fd), frames, made.holder_pid, companion)


def _make(
    stations: Sequence[Station],
    companions: Collection[Station],
    outer_proc: int,
    kind: Interfaces,
    answers: socket.socket,
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
        is_tap, frames_fds = _with_interfaces(bridge, networks, kind)
        interfaces = zip(made, frames_fds, _with_companions(networks, companions), strict=True)
        for (station, namespaces, holder_pid), frames, companion in interfaces:
            answer = _Made(station, holder_pid, is_tap, None if companion is None else companion.interface)
            fds = [*namespaces, *frames]
            if companion is not None:
                fds += (each.fileno() for each in (companion.autopilot, companion.diagnostics) if each)
            socket.send_fds(answers, [msgspec.json.encode(answer)], fds)
        status = 0
    except BaseException as error:  # noqa: BLE001  reported by the parent
        answers.send(msgspec.json.encode(_Failed(described(error))))
    finally:
        os._exit(status)


def _with_interfaces(
    bridge: int, namespaces: Sequence[tuple[Station, int]], kind: Interfaces
) -> tuple[bool, list[Sequence[int]]]:
    """Make ``wlan0`` of all vehicles and return whether they are TAPs, and their descriptors."""
    from netsim.network import interfaces  # noqa: PLC0415  after the holders have been forked

    is_tap = kind == "tap"
    if not is_tap:
        try:
            files = _pairs(bridge, namespaces)
        except interfaces.NoVeth:
            if kind == "veth":
                raise
            is_tap = True
    if is_tap:
        files = [_tap(*each) for each in namespaces]
    for station, namespace_fd in namespaces:
        set_namespace(namespace_fd, CLONE_NEWNET)
        interfaces.configure(station)
    wall_deadline_s = time.monotonic() + _RUNNING_LIMIT_S
    for station, namespace_fd in namespaces:
        set_namespace(namespace_fd, CLONE_NEWNET)
        while not interfaces.is_running(INTERFACE):
            if time.monotonic() > wall_deadline_s:
                raise NetworksNotMade(f"station {station}: {INTERFACE} does not get up")
            time.sleep(_POLL_S)
    return is_tap, files


def _pairs(bridge: int, namespaces: Sequence[tuple[Station, int]]) -> list[Sequence[int]]:
    """Make the veth pairs and return the packet sockets of their peers."""
    from netsim.network import interfaces  # noqa: PLC0415  likewise

    set_namespace(bridge, CLONE_NEWNET)
    interfaces.disable_ipv6()
    files: list[Sequence[int]] = []
    for station, namespace_fd in namespaces:
        interfaces.make_pair(station, namespace_fd)
        files.append([open_packet_socket(interfaces.peer_name(station)).detach()])
    return files


def _tap(station: Station, namespace_fd: int) -> Sequence[int]:
    """Make the TAP interface of a vehicle and return its files."""
    from netsim.network import interfaces  # noqa: PLC0415  likewise

    set_namespace(namespace_fd, CLONE_NEWNET)
    try:
        files = open_tap(INTERFACE)
    except OSError as error:
        raise NetworksNotMade(f"station {station}: no TAP interface: {described(error)}") from None
    interfaces.prepare_tap(station, QUEUE_FRAMES)
    return files


def _with_companions(
    namespaces: Sequence[tuple[Station, int]], companions: Collection[Station]
) -> list[CompanionSockets | None]:
    """Make ``eth0`` of the vehicles that have one and return their sockets; of none without veth pairs."""
    from netsim.network.companion_interface import make_companion  # noqa: PLC0415  likewise
    from netsim.network.interfaces import NoVeth  # noqa: PLC0415

    try:
        return [make_companion(*each) if each[0] in companions else None for each in namespaces]
    except NoVeth as error:
        print(f"network: programs do not reach their autopilots: {error}", file=sys.stderr)  # noqa: T201
        return [None] * len(namespaces)


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
