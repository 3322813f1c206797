"""Ports of a run are claimed before it starts, raised if asked, or named in a one-line error."""

import contextlib
import socket
from collections.abc import Callable

import msgspec
import pytest
from external_swarms import free_base

from autopilot.parameters.config import AutopilotConfig
from harness.launch import ports as ports_module
from harness.launch import resources
from harness.launch.ports import claim
from harness.launch.resources import ResourceError, bind
from harness.scenario.scenario import PortsConfig, Scenario

AGENTS = 2
HOST = "127.0.0.1"


def free_port(kind: socket.SocketKind) -> int:
    with contextlib.closing(bind(kind, HOST, 0)) as sock:
        return int(sock.getsockname()[1])


def scenario(**ports: int) -> Scenario:
    """Return a scenario with these ports and others that are free, whose vehicles connect by TCP."""
    free = msgspec.structs.replace(PortsConfig(radio_link="tcp").free(), simulator_link="tcp")
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
    def closed(listeners: dict[int, socket.socket]) -> Callable[[], None]:
        return lambda: [listener.close() for listener in listeners.values()] and None

    given = scenario(simulator_tcp=free_base(AGENTS, socket.SOCK_STREAM), gcs_remote_udp=14_550)
    first, listeners, *_ = claim(given, search=True)
    request.addfinalizer(closed(listeners))
    assert first == given  # free: the scenario's
    assert {i: each.getsockname()[1] for i, each in listeners.items()} == {
        i: given.ports.simulator_tcp + i for i in range(AGENTS)
    }
    second, others, *_ = claim(given, search=True)
    request.addfinalizer(closed(others))
    offset = second.ports.simulator_tcp - given.ports.simulator_tcp
    assert offset > 0
    assert offset % 1_000 == 0
    assert second.ports == given.ports.raised(offset, AGENTS)  # all by the same, 0 stays
    assert msgspec.structs.replace(second, ports=given.ports) == given


def ardupilots(**ports: int) -> Scenario:
    """Return a scenario of an own vehicle and an ArduPilot."""
    autopilot = AutopilotConfig(kind="ardupilot", ardupilot_program="arducopter", ardupilot_vehicles=(1,))
    return msgspec.structs.replace(scenario(**ports), autopilot=autopilot)


def test_vehicles_with_inherited_sockets_have_no_listener_and_need_no_port() -> None:
    with bind(socket.SOCK_STREAM, HOST, 0) as holder:
        given = scenario(simulator_tcp=holder.getsockname()[1])
        ports = msgspec.structs.replace(given.ports, simulator_link="unix")
        claimed = claim(msgspec.structs.replace(given, ports=ports), search=False)
        assert claimed.sockets == ()
        mixed = msgspec.structs.replace(ardupilots(), ports=msgspec.structs.replace(ports, simulator_tcp=0))
        claimed = claim(mixed, search=False)
        with contextlib.ExitStack() as stack:
            for each in claimed.sockets:
                stack.enter_context(each)
            assert claimed.listeners.keys() == claimed.states.keys() == {1}


@pytest.mark.parametrize("field", ["gcs_local_udp", "companion_local_udp"])
def test_a_claimed_port_is_free_for_its_vehicle_while_other_swarms_search(field: str) -> None:
    base = free_base(AGENTS)
    given = scenario(**{field: base})
    given = msgspec.structs.replace(given, ports=msgspec.structs.replace(given.ports, simulator_link="unix"))
    with contextlib.closing(claim(given, search=False)), contextlib.ExitStack() as vehicles:
        for i in reversed(range(AGENTS)):  # in any order
            with pytest.raises(ResourceError, match=f"^UDP port {base} "):
                claim(given, search=False)
            vehicles.enter_context(bind(socket.SOCK_DGRAM, HOST, base + i))
    claim(given, search=False).close()


def test_other_swarms_do_not_bind_a_claimed_port_to_try_it(monkeypatch: pytest.MonkeyPatch) -> None:
    base, tried = free_base(AGENTS), list[int]()

    def trying(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
        tried.append(port)
        return bind(kind, host, port)

    given = scenario(gcs_local_udp=base)
    given = msgspec.structs.replace(given, ports=msgspec.structs.replace(given.ports, simulator_link="unix"))
    with contextlib.closing(claim(given, search=False)):
        monkeypatch.setattr(ports_module, "bind", trying)
        monkeypatch.setattr(resources, "bind", trying)
        with contextlib.closing(claim(given, search=True)) as other:
            assert other.scenario.ports.gcs_local_udp > base
    assert tried
    assert not {base, base + 1} & {*tried}


def test_an_ardupilots_states_have_the_number_of_its_listener() -> None:
    for given in (ardupilots(), ardupilots(simulator_tcp=free_base(AGENTS, socket.SOCK_STREAM))):
        claimed = claim(given, search=False)
        with contextlib.ExitStack() as stack:
            for each in claimed.sockets:
                stack.enter_context(each)
            assert claimed.states.keys() == {1}
            assert len(claimed.sockets) == AGENTS + 1
            assert claimed.states[1].getsockname() == claimed.listeners[1].getsockname()


def test_a_udp_port_in_use_with_the_number_of_an_ardupilots_listener_is_named() -> None:
    base = free_base(AGENTS, socket.SOCK_STREAM)
    with bind(socket.SOCK_DGRAM, HOST, base + 1):
        port, given = base + 1, ardupilots(simulator_tcp=base)
        with pytest.raises(
            ResourceError, match=rf"^UDP port {port} on {HOST}: Address already in use; --port"
        ):
            claim(given, search=False)
        raised = claim(given, search=True)
        for each in raised.sockets:
            each.close()
        offset = raised.scenario.ports.simulator_tcp - given.ports.simulator_tcp
        assert offset > 0
        assert raised.scenario.ports == given.ports.raised(offset, AGENTS)
    for each in claim(given, search=False).sockets:  # nothing stayed bound
        each.close()


def test_free_ports_are_tried_until_one_is_free_for_states_too(monkeypatch: pytest.MonkeyPatch) -> None:
    refusals = iter([True] * 5)

    def refusing(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
        if kind == socket.SOCK_DGRAM and port and next(refusals, False):
            raise ResourceError(f"UDP port {port} on {host}: in use", in_use=True)
        return bind(kind, host, port)

    monkeypatch.setattr(ports_module, "bind", refusing)
    given = ardupilots(simulator_tcp=0, companion_remote_udp=free_port(socket.SOCK_DGRAM))
    claimed = claim(given, search=False)
    for each in claimed.sockets:
        each.close()
    assert claimed.scenario == given


def test_the_port_of_an_ardupilots_application_must_be_free() -> None:
    with bind(socket.SOCK_DGRAM, HOST, 0) as holder:
        port = holder.getsockname()[1]
        with pytest.raises(ResourceError, match=f"^UDP port {port} "):
            claim(ardupilots(companion_remote_udp=port - 1), search=False)


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
