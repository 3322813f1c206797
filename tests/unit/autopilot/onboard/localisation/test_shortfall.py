"""The cause in the message of a take-off without localisation."""

import numpy as np
import pytest

from autopilot.onboard.localisation.shortfall import shortfall

LINE_M = np.array([(0.0, 8.5 * i, -10.0) for i in range(3)])
ALL = np.ones(3, bool)


def cause(*, present=ALL, unmeasured=(), located=ALL):
    measured = np.ones((3, 3), bool)
    for i, j in unmeasured:
        measured[i, j] = measured[j, i] = False
    return shortfall(
        own=1, present=np.array(present), measured=measured, located=np.array(located),
        places_ned_m=LINE_M, shape_std_m=0.866, limit_m=0.35,
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
