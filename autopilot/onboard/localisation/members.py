"""What the localisation keeps of every UAV that it localises, a row of one array each, and of itself.

Tracks, receivers and trust each have their columns of it, and compiled code is given the whole: what a beacon
or a distance touches of a UAV then lies together, and is one argument. So is what there is once: the model's
numbers, times and counts.
"""

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.localisation.model import LocalisationModel

DECAY_SHARE = 0.01
"""Of the shortest time constant: the stride in which slow errors are propagated."""

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
FILTER = np.dtype(
    [
        ("own", "i8"),  # row of the UAV that runs it
        ("time_us", "i8"),
        ("decay_owed_us", "i8"),  # since slow errors were propagated, and the stride in which they are
        ("decay_stride_us", "i8"),
        ("distances_hz", "f8"),  # of one UAV, either end
        ("own_range_us", "i8"),  # when the newest fused distance of the own UAV was measured; -1: none yet
        ("returned", "i8"),  # somebody has been heard of again
        ("step_ne_m", "f8", 2),  # of odometry that has jumped
        ("gps_var_m2", "f8"),  # of a GPS that has made a step: see `receivers.fuse_mean`
        # distances pending: how many, and while they are gone through, how many have been looked at, how
        # many of these stay, and odometry between the ends of the last
        ("pending", "i8"),
        ("done", "i8"),
        ("kept", "i8"),
        ("between_ned_m", "f8", 3),
        ("ranges_used", "i8"),
        ("ranges_downweighted", "i8"),
        ("ranges_too_late", "i8"),
        # of `LocalisationModel`
        ("gps_bias_std_m", "f8"),
        ("gps_bias_vertical_std_m", "f8"),
        ("gps_bias_time_constant_s", "f8"),
        ("gps_white_var_m2", "f8"),
        ("drift_m2_s", "f8"),
        ("height_var_m2", "f8"),
        ("height_time_constant_s", "f8"),
        ("range_floor_var_m2", "f8"),
    ]
)
"""The filter's numbers beside its state and covariance."""
Filter = NDArray[np.void]
"""(1,) of `FILTER`"""


def new_filter(own: int, model: LocalisationModel) -> Filter:
    """Row of a filter at UAV ``own`` that has heard nothing yet."""
    filter_row: Filter = np.zeros(1, FILTER)
    row = filter_row[0]
    row["own"], row["own_range_us"] = own, -1
    shortest_s = min(model.gps_bias_time_constant_s, model.height_time_constant_s)
    row["decay_stride_us"] = int(1e6 * DECAY_SHARE * shortest_s)
    for name in (
        "gps_bias_std_m", "gps_bias_vertical_std_m", "gps_bias_time_constant_s", "height_time_constant_s",
    ):  # fmt: skip
        row[name] = getattr(model, name)
    row["gps_white_var_m2"], row["drift_m2_s"] = model.gps_white_std_m**2, model.odometry_drift_m_sqrt_s**2
    row["height_var_m2"], row["range_floor_var_m2"] = model.height_std_m**2, model.range_floor_std_m**2
    return filter_row


def new_members(count: int) -> Members:
    """Rows of UAVs of whom nothing is known."""
    members: Members = np.zeros(count, MEMBER)
    for name in ("newest_us", "fix_us", "stated_us"):
        members[name] = -1
    return members
