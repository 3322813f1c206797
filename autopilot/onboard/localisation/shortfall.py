"""Why a formation is not localised, in the words of the message to the ground station."""

import numpy as np

from autopilot.onboard.predicted_shape import Flags, is_near_line, width_m
from foundation.types import Array


def shortfall(
    *, own: int, present: Flags, measured: Flags, located: Flags, places_ned_m: Array, shape_std_m: float,
    limit_m: float, gps_std_m: float,
) -> str:  # fmt: skip
    """Return what the UAV ``own`` lacks of what determines the shape, the first of: beacons, distances, fit.

    Flags are (N,) over the UAVs with places (N, 3), except ``measured`` (N, N), symmetric, the pairs with a
    distance: ``present`` UAVs have sent a beacon of late, ``located`` ones have an estimate. With all of
    these the cause is the geometry, as near a line, or the accuracy of the distances; ``shape_std_m`` is then
    the expected error of the shape. ``gps_std_m`` is one sigma of GPS per horizontal axis.
    """
    others = len(places_ned_m) - 1
    received = int(present.sum()) - int(present[own])
    if received < others:
        return f"beacons of {received} of {others} other UAVs received"
    measured = measured & ~np.eye(others + 1, dtype=bool)
    ranged = int(measured[own].sum())
    if ranged < others:
        return f"distances to {ranged} of {others} other UAVs measured"
    pairs = others * (others + 1) // 2
    pairs_ranged = int(measured.sum()) // 2
    if not located.all():
        found = f"distances fit {int(located.sum())} of {others + 1} UAVs"
        return found if pairs_ranged == pairs else f"{found}, {pairs_ranged} of {pairs} pairs measured"
    found = f"ranging determines its shape to {shape_std_m:.2f} m, not {limit_m:g} m"
    if is_near_line(places_ned_m, gps_std_m=gps_std_m, limit_m=limit_m):
        found += f" (places within {width_m(places_ned_m):.1f} m of a line)"
    return found
