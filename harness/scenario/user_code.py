"""Code of the user that a scenario names: where it is looked up, and its checks when the scenario is read."""

from pathlib import Path

import msgspec

from autopilot.onboard.factory import layout_of
from autopilot.parameters.onboard_config import FORMATION
from autopilot.vehicle.extensions import load_extensions
from harness.scenario import world_checks
from harness.scenario.scenario import Scenario
from netsim.radio_models import registry
from netsim.serial_radio.hopping import centre_mhz
from netsim.uwb.link_budget import at_channel


def with_code(scenario: Scenario, folder: Path) -> Scenario:
    """Return the scenario with the folder in which its code and data are looked up first.

    All code is imported, and radio models, sensors and faults are tried. Raises ExtensionError, one line that
    begins with the field.
    """
    autopilot, onboard = scenario.autopilot, scenario.onboard
    if autopilot.has_code:
        autopilot = msgspec.structs.replace(autopilot, folder=str((folder / autopilot.folder).resolve()))
    if onboard.application != FORMATION or onboard.programs:
        onboard = msgspec.structs.replace(onboard, folder=str((folder / onboard.folder).resolve()))
    load_extensions(autopilot)
    layout_of(onboard)
    radio = registry.with_folder(scenario.radio, folder)
    stations = tuple(
        msgspec.structs.replace(each, antenna=registry.antenna_with_folder(each.antenna, folder))
        for each in scenario.stations
    )
    count = scenario.agents + len(radio.guests) + len(stations)
    registry.check_models(radio, count, scenario.places_ned_m())
    if scenario.serial_pairs is not None:
        at_modems = msgspec.structs.replace(radio, frequency_mhz=centre_mhz(scenario.serial_radio))
        registry.check_models(at_modems, count, scenario.places_ned_m())
    if scenario.uwb_radios is not None:
        registry.check_models(at_channel(radio, scenario.uwb), count, scenario.places_ned_m())
    for number, station in enumerate(stations):
        if station.antenna is not None:
            registry.check_antenna(radio, count, station.antenna, f"stations[{number}].antenna")
    sensors, faults = world_checks.with_folder(scenario.sensors, scenario.faults, folder)
    world_checks.check_models(
        sensors,
        faults,
        seed=scenario.run.seed,
        site=scenario.site,
        airframes=scenario.airframes(),
        places_ned_m=scenario.places_ned_m(),
        step_us=scenario.run.step_us,
        ardupilots=scenario.ardupilots,
    )
    return msgspec.structs.replace(
        scenario,
        autopilot=autopilot,
        onboard=onboard,
        radio=radio,
        stations=stations,
        sensors=sensors,
        faults=faults,
    )
