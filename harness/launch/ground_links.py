"""A swarm's MAVLink links to ground stations: their addresses, and a pymavlink connection."""

import os
from collections.abc import Mapping
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any

from autopilot.mavlink import dialect  # noqa: F401  # registers the messages that vehicles send
from autopilot.mavlink.signing import key_of
from autopilot.parameters.config import LinksConfig, VehiclePorts
from foundation.processes.child_protocol import Ready
from harness.launch.process_commands import ground_station, uav
from harness.launch.run_messages import SwarmError
from harness.scenario.scenario import Scenario


def link_lines(scenario: Scenario, ready: Mapping[str, Ready]) -> tuple[str, ...]:
    """Return a line per vehicle with its MAVLink addresses; ``ready`` are the reports of the processes."""
    stations = {each.name: ready[ground_station(each.name)].details for each in scenario.ground_stations}
    return tuple(
        _link_line(i, ready[uav(i)].details, scenario.vehicle_ports(i), stations)
        for i in range(scenario.agents)
    )


def local_port(
    scenario: Scenario, ready: Mapping[str, Ready], instance: int, station: str | None = None
) -> int:
    """Return the UDP port of this machine at which a ground station program reaches a vehicle.

    With ground stations on the radio it is that of the one called ``station``, by default the first. Raises
    SwarmError if there is none of that name.
    """
    names = [each.name for each in scenario.ground_stations]
    if station is not None and station not in names:
        has = f"its ground stations: {', '.join(names)}" if names else "its telemetry is by wire"
        raise SwarmError(f"there is no ground station {station} on the radio; {has}")
    if not names:
        return int(ready[uav(instance)].details["gcs_local_udp"])
    return int(ready[ground_station(station or names[0])].details["gcs_local_udp"][instance])


def _link_line(
    instance: int, local: Mapping[str, Any], ports: VehiclePorts, stations: Mapping[str, Mapping[str, Any]]
) -> str:
    """Return a vehicle's MAVLink addresses: the local ports that were reported, and remote ports."""
    ends = [
        (
            f"ground station {name} by radio, UDP {details['gcs_local_udp'][instance]}",
            details["gcs_remote_udp"],
        )
        for name, details in stations.items()
    ]
    if not ends:
        ends = [(f"ground station UDP {local.get('gcs_local_udp', 'its own')}", ports.gcs_remote_udp)]
    ends.append((f"companion UDP {local.get('companion_local_udp', 'its own')}", ports.companion_remote_udp))
    links = [link + (f" -> {remote}" if remote else "") for link, remote in ends]
    return f"uav {instance}, system {instance + 1}: {', '.join(links)}"


def connect(links: LinksConfig, port: int) -> Any:  # noqa: ANN401  pymavlink has no types
    """Return a pymavlink connection (`mavutil`) to a vehicle's port, as a ground station.

    A first heartbeat has been sent. ``links`` are the vehicle's; if they have a key, the connection signs and
    accepts signed messages only. Raises OSError for a missing key file, SigningKeyError for one that contains
    no valid key.
    """
    host = links.host
    if IPv4Address(host).is_unspecified:
        host = "127.0.0.1"
    os.environ.setdefault("MAVLINK20", "1")  # read at pymavlink's import; the default is MAVLink 1
    from pymavlink import mavutil  # noqa: PLC0415, TID251  an I/O module; rarely needed

    link = mavutil.mavlink_connection(
        f"udpout:{host}:{port}", source_system=255, source_component=190, dialect="common"
    )
    if links.signing_key_file is not None:
        # pymavlink gives each connection a link id of its own
        link.setup_signing(key_of(Path(links.signing_key_file).read_bytes()), sign_outgoing=True)
    link.mav.heartbeat_send(
        mavutil.mavlink.MAV_TYPE_GCS,
        mavutil.mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mavutil.mavlink.MAV_STATE_ACTIVE,
    )
    return link
