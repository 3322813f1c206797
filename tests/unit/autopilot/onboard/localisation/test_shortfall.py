"""The cause in the message of a take-off without localisation."""

import numpy as np
import pytest

from autopilot.onboard.localisation.shortfall import shortfall

LINE_M = np.array([(0.0, 8.5 * i, -10.0) for i in range(3)])
ALL = np.ones(3, bool)


def cause(*, present=ALL, unmeasured=(), located=ALL, places_ned_m=LINE_M):
    measured = np.ones((3, 3), bool)
    for i, j in unmeasured:
        measured[i, j] = measured[j, i] = False
    return shortfall(
        own=1, present=np.array(present), measured=measured, located=np.array(located),
        places_ned_m=places_ned_m, shape_std_m=0.866, limit_m=0.35, gps_std_m=1.5,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("lack", "text"),
    [
        ({"present": (False, True, False)}, "beacons of 0 of 2 other UAVs received"),
        ({"present": (False, False, False)}, "beacons of 0 of 2 other UAVs received"),
        ({"present": (True, True, False), "unmeasured": [(0, 1)]}, "beacons of 1 of 2 other UAVs received"),
        ({"unmeasured": [(0, 1), (0, 2)]}, "distances to 1 of 2 other UAVs measured"),
        (
            {"unmeasured": [(0, 2)], "located": (True, True, False)},
            "distances fit 2 of 3 UAVs, 2 of 3 pairs measured",
        ),
        ({"located": (True, True, False)}, "distances fit 2 of 3 UAVs"),
        ({}, "ranging determines its shape to 0.87 m, not 0.35 m (places within 0.0 m of a line)"),
    ],
)
def test_the_first_thing_that_lacks_is_named_with_numbers(lack, text):
    assert cause(**lack) == text


@pytest.mark.parametrize(("offset_m", "is_named"), [(0.1, True), (0.2, True), (2.0, False), (8.0, False)])
def test_a_line_is_named_only_if_accurate_distances_would_not_help(offset_m, is_named):
    """The UAV in the middle is beside the line; 5 cm along it are 5 cm * 8.5 m / offset across it."""
    places_ned_m = LINE_M + np.array([(0.0, 0.0, 0.0), (offset_m, 0.0, 0.0), (0.0, 0.0, 0.0)])
    assert ("of a line" in cause(places_ned_m=places_ned_m)) == is_named
