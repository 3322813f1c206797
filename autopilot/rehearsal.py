"""A short flight on the table.

Runs every numerical kernel of a vehicle once, so that all are compiled and on disk.

Two vehicles stand still on the ground with perfect sensors and a perfect radio between them, find their
formation and start their rotors. Nothing moves; what they compute is of no interest, only that they compute
it.
"""

import math
from collections.abc import Iterable

from pymavlink.dialects.v20 import common

from autopilot.config import VehicleConfig
from autopilot.estimation.atmosphere import pressure_pa
from autopilot.vehicle import Vehicle
from netsim.wire.messages import Broadcast, Delivery, FtmResult, RxItem, TxItem

LIMIT_US = 20_000_000
STEPS_AFTER_TAKEOFF = 500
_IMU, _MAG, _BARO = 0x3F, 0x1C0, 0x1A00
_GPS_PERIOD_US = 200_000
_GRAVITY_M_S2 = 9.8066


class RehearsalError(RuntimeError):
    """The vehicles did not start their rotors; something is wrong with the autopilot."""


def rehearse() -> None:
    """Fly on the table until both vehicles have worked in offboard for a while. Raises RehearsalError."""
    places_ned_m = ((0.0, 0.0, -10.0), (0.0, 8.5, -10.0))
    configs = [
        VehicleConfig(run_id="rehearsal", instance=i, seed=0, places_ned_m=places_ned_m) for i in range(2)
    ]
    vehicles = [Vehicle(config) for config in configs]
    distance_m = math.dist(*places_ned_m)
    inboxes: list[list[RxItem]] = [[], []]
    armed_steps = 0
    step_us = configs[0].step_us
    for time_us in range(step_us, LIMIT_US, step_us):
        sent: list[tuple[TxItem, ...]] = []
        for config, vehicle in zip(configs, vehicles, strict=True):
            sensors = _sensors(config, time_us, place_ned_m=places_ned_m[config.instance])
            sent.append(vehicle.step(sim_messages=sensors, radio_items=inboxes[config.instance]).radio)
        inboxes = [
            _arrivals(sent[1 - i], sent[i], other=1 - i, time_us=time_us, distance_m=distance_m)
            for i in range(2)
        ]
        armed_steps += all(vehicle.commander.armed for vehicle in vehicles)
        if armed_steps > STEPS_AFTER_TAKEOFF:
            return
    raise RehearsalError("the vehicles of the rehearsal did not start their rotors")


def _sensors(
    config: VehicleConfig, time_us: int, *, place_ned_m: tuple[float, float, float]
) -> list[common.MAVLink_message]:
    """Give what a vehicle feels that stands level below its place, heading north."""
    site = config.site
    messages = []
    if time_us % _GPS_PERIOD_US == 0:
        east_deg = math.degrees(place_ned_m[1] / 6.378e6) / math.cos(math.radians(site.latitude_deg))
        messages.append(
            common.MAVLink_hil_gps_message(
                time_us,
                common.GPS_FIX_TYPE_3D_FIX,
                round(site.latitude_deg * 1e7),
                round((site.longitude_deg + east_deg) * 1e7),
                round(site.altitude_m * 1e3),
                100,
                100,
                0,
                0,
                0,
                0,
                65_535,
                10,
            )
        )
    pressure_hpa = pressure_pa(site.altitude_m) / 100.0
    accel, gyro = (0.0, 0.0, -_GRAVITY_M_S2), (0.0, 0.0, 0.0)
    baro = (pressure_hpa, 0.0, site.altitude_m, 15.0)
    fields = _IMU | _MAG | _BARO
    messages.append(
        common.MAVLink_hil_sensor_message(
            time_us, *accel, *gyro, *site.magnetic_field_ned_gauss, *baro, fields, 0
        )
    )
    return messages


def _arrivals(
    theirs: Iterable[TxItem], own: Iterable[TxItem], *, other: int, time_us: int, distance_m: float
) -> list[RxItem]:
    """Deliver the other's broadcasts and answer the own ranging requests, at once and without error."""
    at_ns = time_us * 1000
    arrivals: list[RxItem] = [
        Delivery(source=other, seq=item.seq, received_ns=at_ns, rssi_dbm=-60.0, payload=item.payload)
        for item in theirs
        if isinstance(item, Broadcast)
    ]
    arrivals += [
        FtmResult(
            peer=item.peer,
            seq=item.seq,
            status="ok",
            measured_ns=at_ns,
            distance_m=distance_m,
            distance_std_m=0.1,
            rssi_dbm=-60.0,
            round_trips=7,
        )
        for item in own
        if not isinstance(item, Broadcast)
    ]
    return arrivals
