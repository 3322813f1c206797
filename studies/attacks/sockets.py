"""Ports and sockets that the processes of a run have open. An I/O module."""

import os
import random
import socket

import psutil

from harness.launch.swarm import Swarm
from studies.attacks.tasks import Address

HERE = "127.0.0.1"
_BELOW_EPHEMERAL = range(15_000, 30_000, 16)


class OpenSockets:
    """What is open at the moment: UDP ports, listening TCP ports, named Unix sockets."""

    def __init__(self, swarm: Swarm) -> None:
        self.datagrams: list[Address] = []
        self.listening: list[Address] = []
        self.named: list[str] = []
        pids = {*swarm.pids.values(), os.getpid()}
        for pid in pids:
            for each in psutil.Process(pid).net_connections("all"):
                if each.family == socket.AF_UNIX:
                    if each.laddr:
                        self.named.append(str(each.laddr))
                elif each.type == socket.SOCK_DGRAM and each.laddr:
                    self.datagrams.append((each.laddr[0], each.laddr[1]))
                elif each.status == psutil.CONN_LISTEN:
                    self.listening.append((each.laddr[0], each.laddr[1]))
        self.datagrams = sorted(set(self.datagrams))
        self.listening = sorted(set(self.listening))
        self.named = sorted(set(self.named))


def vehicle_ports(swarm: Swarm, instance: int) -> list[Address]:
    """Return the addresses of a vehicle's two MAVLink links, those of the ground station first."""
    process = psutil.Process(swarm.pids[f"uav {instance}"])
    found = [each.laddr[1] for each in process.net_connections("udp4") if each.laddr]
    line = swarm.addresses[instance]
    return [(HERE, port) for port in sorted(found, key=lambda number: line.index(f"UDP {number}"))]


def listening_ports(pid: int) -> list[int]:
    """Return the TCP ports on which a process and its descendants listen."""
    processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    return sorted(
        {
            each.laddr[1]
            for process in processes
            for each in process.net_connections("tcp")
            if each.status == psutil.CONN_LISTEN
        }
    )


def free_base(count: int) -> int:
    """Return the first of ``count`` TCP ports, at most 16, that are free and not given to other sockets.

    Raises OSError without any.
    """
    bases = list(_BELOW_EPHEMERAL)
    random.SystemRandom().shuffle(bases)
    for base in bases:
        try:
            for port in range(base, base + count):
                with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
                    probe.bind((HERE, port))
        except OSError:
            continue
        return base
    raise OSError("no free TCP ports")
