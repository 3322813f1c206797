"""Ports of a run are claimed before it starts, raised if asked, or named in a one-line error."""

import contextlib
import socket
from collections.abc import Callable

import msgspec
import pytest

from harness.launch.ports import claim
from harness.launch.resources import ResourceError, bind
from harness.scenario.scenario import PortsConfig, Scenario

AGENTS = 2
HOST = "127.0.0.1"


def free_port(kind: socket.SocketKind) -> int:
    with contextlib.closing(bind(kind, HOST, 0)) as sock:
        return int(sock.getsockname()[1])


def scenario(**ports: int) -> Scenario:
    """Return a scenario with these ports and others that are free."""
    free = PortsConfig().free()
    return Scenario(name="ports", agents=AGENTS, ports=msgspec.structs.replace(free, **ports))


@pytest.mark.parametrize(
    ("field", "kind", "protocol"),
    [
        ("simulator_tcp", socket.SOCK_STREAM, "TCP"),
        ("radio_tcp", socket.SOCK_STREAM, "TCP"),
        ("gcs_local_udp", socket.SOCK_DGRAM, "UDP"),
        ("companion_local_udp", socket.SOCK_DGRAM, "UDP"),
    ],
)
def test_a_port_in_use_is_named_with_the_option_that_helps(
    field: str, kind: socket.SocketKind, protocol: str
) -> None:
    with bind(kind, HOST, 0) as holder:
        port = holder.getsockname()[1]
        with pytest.raises(ResourceError) as refused:
            claim(scenario(**{field: port}), search=False)
    line = str(refused.value)
    assert line.startswith(f"{protocol} port {port} on {HOST}: Address already in use; --port-offset 1000")
    assert "--port-offset auto" in line


def test_two_claims_at_once_get_different_ports(request: pytest.FixtureRequest) -> None:
    def closed(listeners: list[socket.socket]) -> Callable[[], None]:
        return lambda: [listener.close() for listener in listeners] and None

    given = scenario(simulator_tcp=free_port(socket.SOCK_STREAM), gcs_remote_udp=14_550)
    first, listeners, _ = claim(given, search=True)
    request.addfinalizer(closed(listeners))
    assert first == given  # free: the scenario's
    assert [each.getsockname()[1] for each in listeners] == [given.ports.simulator_tcp + i for i in (0, 1)]
    second, others, _ = claim(given, search=True)
    request.addfinalizer(closed(others))
    offset = second.ports.simulator_tcp - given.ports.simulator_tcp
    assert offset > 0
    assert offset % 1_000 == 0
    assert second.ports == given.ports.raised(offset, AGENTS)  # all by the same, 0 stays
    assert msgspec.structs.replace(second, ports=given.ports) == given


def test_no_port_stays_bound_after_an_error() -> None:
    base = free_port(socket.SOCK_STREAM)
    with bind(socket.SOCK_DGRAM, HOST, 0) as holder:
        taken = scenario(simulator_tcp=base, gcs_local_udp=holder.getsockname()[1])
        with pytest.raises(ResourceError):
            claim(taken, search=False)
    bind(socket.SOCK_STREAM, HOST, base).close()


def test_an_address_that_is_not_of_this_machine_is_no_reason_to_search() -> None:
    elsewhere = scenario()
    elsewhere = msgspec.structs.replace(
        elsewhere, ports=msgspec.structs.replace(elsewhere.ports, host="192.0.2.1")
    )
    with pytest.raises(ResourceError, match=r"TCP port 0 on 192\.0\.2\.1: Cannot assign") as refused:
        claim(elsewhere, search=True)
    assert "--port-offset" not in str(refused.value)
