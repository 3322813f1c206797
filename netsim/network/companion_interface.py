"""Interfaces ``eth0``: a vehicle's link to its own autopilot, beside the radio.

The peer of ``eth0`` is in a network namespace of its own, in which the autopilot has its address. The socket
at the autopilot's port is opened there, and stays there; it keeps the namespace. Which datagrams it passes
between program and autopilot is left to `netsim.network.autopilot_relay`.
"""

import contextlib
import os
import socket

from netsim.network import interfaces
from netsim.network.companion_sockets import (
    AUTOPILOT,
    PROGRAM,
    CompanionSockets,
    has_receiver,
    open_diagnostics,
)
from netsim.network.namespaces import CLONE_NEWNET, new_network_namespace, set_namespace
from netsim.wire.messages import Station


def make_companion(station: Station, namespace_fd: int) -> CompanionSockets:
    """Make ``eth0`` in a vehicle's network namespace and return its sockets.

    The calling thread's network namespace changes. Raises OSError, also as InterfaceError.
    """
    os.close(new_network_namespace())
    interfaces.make_companion_pair(station, namespace_fd, AUTOPILOT[0])
    autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    autopilot.setblocking(False)  # noqa: FBT003
    autopilot.bind(AUTOPILOT)
    set_namespace(namespace_fd, CLONE_NEWNET)
    interfaces.configure_companion(station, PROGRAM[0])
    index = socket.if_nametoindex(interfaces.COMPANION_INTERFACE)
    return CompanionSockets(autopilot, index, _diagnostics(index))


def _diagnostics(index: int) -> socket.socket | None:
    """Return the socket of diagnostics if it finds a receiver."""
    with contextlib.ExitStack() as stack:
        try:
            diagnostics = stack.enter_context(open_diagnostics())
            receiver = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            receiver.bind(PROGRAM)
            if not has_receiver(diagnostics, AUTOPILOT, PROGRAM, index):
                return None
        except OSError:
            return None
        receiver.close()
        stack.pop_all()
    return diagnostics
