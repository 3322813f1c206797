"""Arrays of a flight or a formation, as computed by `harness.report.flown_array` before solving."""

import math

import numpy as np

from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, Snapshot
from harness.records.flight import Flight
from harness.report.flown_array import NoFeed, antenna_snapshot, snapshot_at
from harness.scenario.scenario import Scenario


def upright_array(scenario: Scenario) -> Snapshot:
    """Return the array of all vehicles upright in their initial places, in the antenna's frame.

    Raises `ElementsTouch`, `NoFeed`.
    """
    places_ned_m = scenario.places_ned_m()
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(places_ned_m), 1))
    heading_rad = math.radians(scenario.formation.heading_deg)
    return antenna_snapshot(
        places_ned_m, level, places_ned_m, heading_rad, scenario.antenna, believed_pos_ned_m=places_ned_m
    )


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
