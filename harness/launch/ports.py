"""The ports of a run: bound or checked before its processes start, or named in an error.

An I/O module.
"""

import contextlib
import socket
from typing import NamedTuple

import msgspec

from harness.launch import external_autopilots
from harness.launch.resources import ResourceError, bind, reserve_udp
from harness.scenario.scenario import Scenario

OFFSETS = range(1_000, 65_536, 1_000)
"""Offsets that are tried, in this order, when ports are in use."""
ATTEMPTS = 100
"""Free TCP ports that are tried until UDP's of the same number is free, too."""


class Claim(NamedTuple):
    """The ports of a run; close its sockets."""

    scenario: Scenario
    """With free ports."""
    listeners: dict[int, socket.socket]
    """The simulator's TCP listeners, by vehicle (`tcp_vehicles`)."""
    states: dict[int, socket.socket]
    """UDP sockets for the states of ArduPilots, by vehicle, with the numbers of their listeners."""
    reserved: dict[int, socket.socket]
    """A socket that reserves a UDP port of each vehicle without a listener: other swarms do not bind it, not
    even to try it, before the vehicle has."""

    @property
    def sockets(self) -> tuple[socket.socket, ...]:
        """All sockets."""
        return (*self.listeners.values(), *self.states.values(), *self.reserved.values())

    def close_server_sockets(self) -> None:
        """Close the sockets that the physics server has inherited; harmless when repeated."""
        for each in (*self.listeners.values(), *self.states.values()):
            each.close()

    def close(self) -> None:
        """Close all sockets; harmless when repeated."""
        for each in self.sockets:
            each.close()


def tcp_vehicles(scenario: Scenario) -> tuple[int, ...]:
    """Return the vehicles that connect to the simulator by TCP: other autopilots, or all if set."""
    uses_tcp = scenario.ports.simulator_link == "tcp"
    return tuple(range(scenario.agents)) if uses_tcp else external_autopilots.instances(scenario)


def claim(scenario: Scenario, *, search: bool) -> Claim:
    """Return free ports, and the simulator's sockets at them.

    With ``search``, all ports are raised by the first of `OFFSETS` with which they are free, if some are in
    use; the instance numbers of PX4s rise with them. Listeners and reservations keep other swarms from the
    same ports also before the processes have bound theirs. Raises ResourceError.
    """
    try:
        return _claim(scenario)
    except ResourceError as error:
        if not error.in_use:
            raise
        last = error
        if not search:
            raise ResourceError(
                f"{error}; --port-offset 1000 raises every port of this swarm by 1000, --port-offset auto by "
                "as much as needed (in Python, port_offset=)"
            ) from None
    for offset in OFFSETS:
        try:
            ports = scenario.ports.raised(offset, scenario.ground_ports)
        except ValueError:
            break
        raised = msgspec.structs.replace(scenario, ports=ports)
        try:
            return _claim(raised)
        except ResourceError as error:
            last = error
    raise ResourceError(
        f"ports are in use with every offset that is a multiple of 1000, with the last one: {last}; set "
        "others in the scenario's [ports]"
    )


def _claim(scenario: Scenario) -> Claim:
    """Return the simulator's sockets if all other ports are free too. Raises ResourceError."""
    ports = scenario.ports
    with contextlib.ExitStack() as stack:
        base, with_states = ports.simulator_tcp, scenario.ardupilots
        listeners: dict[int, socket.socket] = {}
        states: dict[int, socket.socket] = {}
        for i in tcp_vehicles(scenario):
            port = base + i if base else 0
            listener, state = _free_simulator_sockets(ports.host, port, states=i in with_states)
            listeners[i] = stack.enter_context(listener)
            if state is not None:
                states[i] = stack.enter_context(state)
        external_autopilots.check_free(scenario)
        for port in external_autopilots.application_ports(scenario):
            bind(socket.SOCK_DGRAM, ports.host, port).close()
        reserved: dict[int, socket.socket] = {}
        for base, count in (
            (ports.gcs_local_udp, scenario.ground_ports),
            (ports.companion_local_udp, scenario.agents),
        ):
            for i in range(count) if base else ():
                if i in listeners or i in reserved or i >= scenario.agents:
                    bind(socket.SOCK_DGRAM, scenario.links.host, base + i).close()
                else:
                    reserved[i] = stack.enter_context(reserve_udp(scenario.links.host, base + i))
        if ports.radio_link == "tcp" and ports.radio_tcp:
            bind(socket.SOCK_STREAM, ports.host, ports.radio_tcp).close()
        stack.pop_all()
    return Claim(scenario, listeners, states, reserved)


def _simulator_sockets(host: str, port: int, *, states: bool) -> tuple[socket.socket, socket.socket | None]:
    """Return a TCP listener and, with ``states``, a UDP socket of the same number; port 0: a free one."""
    listener = bind(socket.SOCK_STREAM, host, port)
    try:
        return listener, bind(socket.SOCK_DGRAM, host, listener.getsockname()[1]) if states else None
    except ResourceError:
        listener.close()
        raise


def _free_simulator_sockets(
    host: str, port: int, *, states: bool
) -> tuple[socket.socket, socket.socket | None]:
    """Return `_simulator_sockets`; of free TCP ports up to `ATTEMPTS` are tried."""
    for _ in range(1, 1 if port else ATTEMPTS):
        try:
            return _simulator_sockets(host, port, states=states)
        except ResourceError as error:
            if not error.in_use:
                raise
    return _simulator_sockets(host, port, states=states)
