"""Calls of the kernels that the flight of two UAVs near each other does not use."""

import numpy as np

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.localisation.common_frame import CommonFrame
from autopilot.onboard.localisation.localisation import CooperativeLocalisation
from autopilot.onboard.localisation.model import LocalisationModel
from autopilot.onboard.radio.beacon import GpsError
from autopilot.onboard.radio.neighbour_table import NeighbourTable
from autopilot.onboard.radio.neighbourhood import Neighbourhood


def warm_up() -> None:
    """Align the frames of two neighbours, as in a formation with several neighbourhoods.

    The variance of a distance is computed only to select measurements.
    """
    near = Neighbourhood(0, np.array(((0.0, 0.0, -10.0), (0.0, 5.0, -10.0), (0.0, 20.0, -10.0))), 1)
    localisation = CooperativeLocalisation(
        own=near.own, places_ned_m=np.zeros((len(near.members), 3)), model=LocalisationModel()
    )
    neighbours = NeighbourTable(station=0, stations=3, period_us=100_000, gps_std_m=1.0, near=near)
    frame = CommonFrame(near.members, neighbours)
    for row, station in enumerate(near.members.tolist()):
        localisation.on_odometry(row, 1_000, (0.0, float(row), 0.0), (0.0, 0.0, 0.0))
        localisation.located[row] = True
        neighbours.note_fix(station, Fix(1, (0.0, float(row), 0.0)), GpsError((0.0, 0.0, 0.0), 1.0), 1_000)
    frame.update(2_000, localisation)
    localisation.distance_variance_m2(1, 2_000)
    neighbours.pages.put(1, b"no beacon")
    neighbours.read(2_000)  # the path without localisation
    neighbours.all_held(np.arange(3), 1_000)
