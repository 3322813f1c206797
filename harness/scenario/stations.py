"""Ground stations on the emulated channel, ``[[stations]]``: places, antennas, numbers, checks.

To the emulator a ground station is a guest whose program is a process of the run (`harness.ground_station`).
"""

import re
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from autopilot.mavlink.radio_carrier import TELEMETRY_PORT
from autopilot.parameters.config import AutopilotConfig, LinksConfig
from autopilot.parameters.onboard_config import OnboardConfig
from netsim.model.config import (
    GainDbi,
    GuestConfig,
    Metres,
    ModelName,
    PowerDbm,
    RadioConfig,
    RadioModel,
    StationConfig,
)

MOST_STATIONS = 8
_VEHICLE_NAME = re.compile(r"uav-[0-9]+")


class GroundStation(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A ground station with a radio at a fixed place: one of ``[[stations]]``.

    Used with ``links.telemetry = "radio"`` and "serial-radio"; the first one then has modems in place of the
    radio, and others are not used. Its station number follows those of the vehicles and of
    ``[[radio.guests]]``.
    """

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,39}$")]
    """Name in messages and captures, different from those of other stations and guests."""
    pos_ned_m: tuple[Metres, Metres, Metres]
    """Foot of the antenna in the site's NED frame, metres."""
    antenna_height_m: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 2.0
    """Height of the antenna above its foot, metres."""
    antenna: ModelName | RadioModel | None = None
    """Antenna pattern, as ``radio.antenna``, which is the default."""
    antenna_gain_dbi: GainDbi | None = None
    """Peak gain; default: that of ``[radio]``, or of ``[serial_radio]`` for its modems."""
    tx_power_dbm: PowerDbm | None = None
    """Transmit power at the antenna port; default: that of ``[radio]``."""

    def guest(self) -> GuestConfig:
        """Return the station as the emulator places it."""
        north_m, east_m, down_m = self.pos_ned_m
        return GuestConfig(name=self.name, pos_ned_m=(north_m, east_m, down_m - self.antenna_height_m))

    def overrides(self, number: int) -> StationConfig | None:
        """Return the settings of the radio that differ from ``[radio]``; None: there are none."""
        own = StationConfig(
            station=number,
            tx_power_dbm=self.tx_power_dbm,
            antenna=self.antenna,
            antenna_gain_dbi=self.antenna_gain_dbi,
        )
        return None if own == StationConfig(station=number) else own


GroundStations = Annotated[tuple[GroundStation, ...], Meta(max_length=MOST_STATIONS)]


def numbers(stations: GroundStations, radio: RadioConfig, agents: int) -> dict[str, int]:
    """Return the station numbers by name."""
    return {each.name: number for number, each in enumerate(stations, start=agents + len(radio.guests))}


def channel(radio: RadioConfig, stations: GroundStations, agents: int) -> RadioConfig:
    """Return the settings of the channel with the ground stations as the last guests."""
    if not stations:
        return radio
    own = zip(stations, numbers(stations, radio, agents).values(), strict=True)
    overrides = [each.overrides(number) for each, number in own]
    return msgspec.structs.replace(
        radio,
        guests=(*radio.guests, *(each.guest() for each in stations)),
        stations=(*radio.stations, *filter(None, overrides)),
    )


def check(
    stations: GroundStations,
    *,
    radio: RadioConfig,
    links: LinksConfig,
    onboard: OnboardConfig,
    autopilot: AutopilotConfig,
    agents: int,
) -> None:
    """Raise ValueError, which begins with the field's path, for settings that contradict each other."""
    names = {guest.name: f"radio.guests[{number}]" for number, guest in enumerate(radio.guests)}
    overridden = {each.station: f"radio.stations[{number}]" for number, each in enumerate(radio.stations)}
    of_stations = numbers(stations, radio, agents)
    for number, each in enumerate(stations):
        path = f"stations[{number}]"
        if _VEHICLE_NAME.fullmatch(each.name):
            raise ValueError(f"{path}.name: {each.name} is the name of a vehicle; expected another")
        if each.name in names:
            raise ValueError(f"{path}.name: {names[each.name]} is called {each.name} too")
        names[each.name] = path
        other = overridden.get(of_stations[each.name])
        if other is not None and each.overrides(0) != StationConfig(station=0) and links.telemetry != "wire":
            raise ValueError(
                f"{other}.station: {of_stations[each.name]} is the ground station {each.name}; expected its "
                f"antenna and power in {path}"
            )
    if links.telemetry == "wire":
        return
    if not stations:
        raise ValueError(
            f'links.telemetry: "{links.telemetry}" needs a ground station at a place; expected a table '
            "[[stations]] with name and pos_ned_m"
        )
    is_serial = links.telemetry == "serial-radio"
    if is_serial and stations[0].tx_power_dbm is not None:
        raise ValueError(
            "stations[0].tx_power_dbm: it is that of an 802.11 radio; "
            'expected serial_radio.tx_power_dbm with links.telemetry = "serial-radio"'
        )
    external = next((i for i in range(agents) if autopilot.is_external(i)), None)
    if external is not None:
        raise ValueError(
            f'links.telemetry: "{links.telemetry}" is for coflight\'s own autopilots; UAV {external} is '
            f'flown by {autopilot.kind_of(external)}, whose MAVLink is UDP: expected "wire"'
        )
    if is_serial or not onboard.enabled:
        return
    ports = {"onboard.port": onboard.port}
    ports |= {f"onboard.programs[{number}].port": each.port for number, each in enumerate(onboard.programs)}
    for path, port in ports.items():
        if port == TELEMETRY_PORT:
            raise ValueError(
                f'{path}: {port} is that of MAVLink with links.telemetry = "radio"; expected another'
            )
