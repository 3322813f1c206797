"""Connections that occupy ports: many to each, as soon as it listens. An I/O module."""

import contextlib
import socket
import threading

from studies.attacks.tasks import Address, IdleConnections, Report

RETRY_S = 0.002
CONNECT_LIMIT_S = 1.0


def hold_connections(task: IdleConnections, ended: threading.Event) -> Report:
    """Connect to each port as soon as it listens; every second connection sends the introduction."""
    held = [0] * len(task.streams_to)
    with contextlib.ExitStack() as stack:
        while min(held) < task.count and not ended.is_set():
            for place, address in enumerate(task.streams_to):
                if held[place] < task.count:
                    held[place] += _hold(stack, address, task.introduction if held[place] % 2 == 0 else b"")
        ended.wait()
    return Report(counts={"connections": sum(held)})


def _hold(stack: contextlib.ExitStack, address: Address, introduction: bytes) -> bool:
    """Connect for the duration of the stack; returns whether the port listens."""
    try:
        sock = stack.enter_context(socket.create_connection(address, CONNECT_LIMIT_S))
    except OSError:
        threading.Event().wait(RETRY_S)
        return False
    with contextlib.suppress(OSError):  # closed by the simulator
        sock.sendall(introduction)
    return True
