"""A swarm's links to ground stations, for whoever looks for them or is one."""

import os
from collections.abc import Mapping
from ipaddress import IPv4Address
from typing import Any

from autopilot.config import VehiclePorts


def link_line(instance: int, local: Mapping[str, Any], ports: VehiclePorts) -> str:
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


def connect(host: str, port: int) -> Any:  # noqa: ANN401  pymavlink has no types
    """A pymavlink connection (`mavutil`) to a vehicle's port, as a ground station that has said hello.

    ``host`` is what the vehicle's links are bound to.
    """
    if IPv4Address(host).is_unspecified:
        host = "127.0.0.1"
    os.environ.setdefault("MAVLINK20", "1")  # read when pymavlink is imported: it would send MAVLink 1
    from pymavlink import mavutil  # noqa: PLC0415, TID251  an edge; few programs need it

    link = mavutil.mavlink_connection(
        f"udpout:{host}:{port}", source_system=255, source_component=190, dialect="common"
    )
    link.mav.heartbeat_send(
        mavutil.mavlink.MAV_TYPE_GCS,
        mavutil.mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mavutil.mavlink.MAV_STATE_ACTIVE,
    )
    return link
