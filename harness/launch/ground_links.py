"""A swarm's links to ground stations, for whoever looks for them or is one."""

import os
from collections.abc import Mapping, Sequence
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any

from autopilot.mavlink import dialect  # noqa: F401  # a connection knows all that a vehicle says
from autopilot.mavlink.signing import key_of
from autopilot.parameters.config import LinksConfig, VehiclePorts
from harness.scenario.scenario import Scenario


def link_lines(scenario: Scenario, local: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Where each vehicle of a swarm speaks MAVLink, a line each; ``local`` are the details of its `Ready`."""
    vehicles = [
        scenario.vehicle(i, run_id="", radio_endpoint=None, log_path=None) for i in range(scenario.agents)
    ]
    return tuple(_link_line(i, local[i], vehicle.ports) for i, vehicle in enumerate(vehicles))


def _link_line(instance: int, local: Mapping[str, Any], ports: VehiclePorts) -> str:
    """Where a vehicle speaks MAVLink: its own ports as its process said them, and whom it calls."""
    calls = {
        "ground station": ("gcs_local_udp", ports.gcs_remote_udp),
        "companion": ("companion_local_udp", ports.companion_remote_udp),
    }
    links = [
        f"{link} UDP {local.get(name, 'its own')}" + (f" -> {remote}" if remote else "")
        for link, (name, remote) in calls.items()
    ]
    return f"uav {instance}, system {instance + 1}: {', '.join(links)}"


def connect(links: LinksConfig, port: int) -> Any:  # noqa: ANN401  pymavlink has no types
    """A pymavlink connection (`mavutil`) to a vehicle's port, as a ground station that has said hello.

    ``links`` are the vehicle's; where these have a key it signs, and hears only what is signed.
    Raises OSError for a key file that is gone, SigningKeyError for one that has no key any more.
    """
    host = links.host
    if IPv4Address(host).is_unspecified:
        host = "127.0.0.1"
    os.environ.setdefault("MAVLINK20", "1")  # read when pymavlink is imported: it would send MAVLink 1
    from pymavlink import mavutil  # noqa: PLC0415, TID251  an edge; few programs need it

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
