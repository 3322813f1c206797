"""Helpers for plan tests: a flying vehicle, and a ground station that uploads plans over MAVLink."""

import math

from msgspec.structs import replace
from pymavlink.dialects.v20 import common
from vehicle_world import Flight, vehicle_config

from autopilot.mavlink.dialect import MissionCount
from autopilot.navigation.plan_store import PlanType, WireItem
from autopilot.services.plan_wire import encode_item
from foundation.geometry.geodesy import ned_to_geodetic

RELATIVE = common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
NO_FRAME = common.MAV_FRAME_MISSION


def flight_of(params=None, **autopilot):
    config = vehicle_config(
        params={"CF_DOB_EN": 1, "COM_DISARM_LAND": 0.3, "NAV_ACC_RAD": 1.0, **(params or {})}
    )
    return Flight(replace(config, autopilot=replace(config.autopilot, **autopilot)))


def make_ready(flight):
    """Wait until the vehicle has a home position, and arm it."""
    assert flight.run(20.0, until=lambda: flight.vehicle.flight.home is not None)
    assert flight.run(
        20.0,
        until=lambda: flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == common.MAV_RESULT_ACCEPTED,
    )


def of_site(north_m, east_m, site):
    """Return latitude and longitude, 1e-7 degrees, of a place in metres from the site's origin."""
    lat, lon, _ = ned_to_geodetic(
        [north_m, east_m, 0.0], origin_lat_deg=site.latitude_deg, origin_lon_deg=site.longitude_deg,
        origin_alt_m=site.altitude_m,
    )  # fmt: skip
    return round(float(lat) * 1e7), round(float(lon) * 1e7)


def act(command, *params):
    return WireItem(
        command=command, frame=NO_FRAME, params=(*params, 0.0, 0.0, 0.0, 0.0)[:4], x=0, y=0, z=0.0
    )


def place(flight, command, north_m, east_m, height_m, *params):
    x, y = of_site(north_m, east_m, flight.vehicle.config.site)
    given = (*params, 0.0, 0.0, 0.0)[:3]
    return WireItem(command=command, frame=RELATIVE, params=(*given, math.nan), x=x, y=y, z=height_m)


def upload(flight, items, kind=PlanType.MISSION):
    """Upload a plan as ground stations do; returns the MAV_MISSION_RESULT."""
    answered = len(flight.received)
    flight.send(MissionCount(1, 1, len(items), int(kind)))
    for _ in range(40 * (len(items) + 10)):
        flight.step()
        received, answered = flight.received[answered:], len(flight.received)
        for _, message in received:
            if message.get_type() == "MISSION_REQUEST_INT":
                item = items[message.seq]
                flight.send(
                    encode_item(
                        item,
                        kind=kind,
                        seq=message.seq,
                        current=message.seq == 0,
                        target=(1, 1),
                        in_integers=True,
                    )
                )
            elif message.get_type() == "MISSION_ACK" and message.mission_type == kind:
                return message.type
    raise AssertionError("no acknowledgement")


def said(flight, name):
    """Return all messages of a name that the vehicle sent to the ground station."""
    return [message for _, message in flight.received if message.get_type() == name]


def reached(flight):
    """Return the items reported as reached, in order, without repetitions."""
    order = []
    for message in said(flight, "MISSION_ITEM_REACHED"):
        if not order or order[-1] != message.seq:
            order.append(message.seq)
    return order
