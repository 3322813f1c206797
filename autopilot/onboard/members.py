"""What the localisation keeps of every UAV that it localises: a row of one array each.

Tracks, receivers and trust each have their columns of it, and compiled code is given the whole: what a beacon
or a distance touches of a UAV then lies together, and is one argument.
"""

import numpy as np
from numpy.typing import NDArray

MEMBER = np.dtype(
    [
        ("active", "u1"),  # there is GPS of it
        ("located", "u1"),  # its distances are fused
        ("distrusted", "u1"),  # the distances that it measures are to be left out
        # odometry (`tracks`): the newest position and velocity, NED, and when that was, -1 before the first
        ("newest_us", "i8"),
        ("newest", "f8", 6),
        # GPS (`receivers`): the newest fix that was taken, and those of which there is no mean yet
        ("fix_us", "i8"),
        ("first_us", "i8"),
        ("late_us", "i8"),
        ("fixes", "i8"),
        ("sum_ned_m", "f8", 3),
        # the last mean, less the odometry of its time: of how many, their mean time, from first to last
        ("less_odometry_ned_m", "f8", 3),
        ("mean_fixes", "i8"),
        ("mean_us", "i8"),
        ("span_us", "i8"),
        ("misfits", "i8"),
        # what the receiver states, and what is made of it
        ("stated_us", "i8"),
        ("stated_var_m2", "f8"),
        ("vertical_var_m2", "f8"),
        ("worst_var_m2", "f8"),
        ("bias_var_m2", "f8"),
        # shares of badly fitting distances (`trust`)
        ("as_end", "f8"),
        ("measured", "f8"),
        ("of_it", "f8"),
    ],
    align=True,
)
Members = NDArray[np.void]
"""(N,) of `MEMBER`"""


def new_members(count: int) -> Members:
    """Rows of UAVs of whom nothing is known."""
    members: Members = np.zeros(count, MEMBER)
    for name in ("newest_us", "fix_us", "stated_us"):
        members[name] = -1
    return members
