"""Arrays of a flight or a formation, as computed by `harness.report.flown_array` before solving."""

import math

from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, Snapshot
from harness.records.flight import Flight
from harness.report.flown_array import NoFeed, snapshot_at, upright_snapshot
from harness.scenario.scenario import Scenario


def upright_array(scenario: Scenario) -> Snapshot:
    """Return the array of all vehicles upright in their initial places, in the antenna's frame.

    Raises `ElementsTouch`, `NoFeed`.
    """
    heading_rad = math.radians(scenario.formation.heading_deg)
    return upright_snapshot(scenario.places_ned_m(), heading_rad, scenario.antenna)


def snapshots_of(flight: Flight, config: AntennaConfig) -> dict[int, Snapshot]:
    """Return the feedable arrays of the flight at ``config.snapshot_rate_hz``, by time in us."""
    sampled = flight.sampled(config.snapshot_rate_hz)
    found: dict[int, Snapshot] = {}
    for t, time_us in enumerate(sampled.time_us.tolist()):
        try:
            found[time_us] = snapshot_at(sampled, t, config)
        except (ElementsTouch, NoFeed):
            continue
    return found
