"""State arrays of the localisation: one row per localised UAV (`MEMBER`), one of the filter (`FILTER`).

`tracks`, `receivers` and `trust` each use their own columns. The data that a beacon or a distance changes for
one UAV are contiguous in memory.
"""

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.localisation.model import LocalisationModel

DECAY_SHARE = 0.01
"""Stride in which slow errors are propagated, as a share of the shortest time constant."""

MEMBER = np.dtype(
    [
        ("active", "u1"),  # initialised with its GPS
        ("located", "u1"),  # its distances are fused
        ("distrusted", "u1"),  # the distances that it measures are not fused
        # odometry (`tracks`): newest position and velocity, NED, and their time, -1 before the first
        ("newest_us", "i8"),
        ("newest", "f8", 6),
        # GPS (`receivers`): time of the newest fix, and the fixes that are not yet part of a mean
        ("fix_us", "i8"),
        ("first_us", "i8"),
        ("late_us", "i8"),
        ("fixes", "i8"),
        ("sum_ned_m", "f8", 3),
        # the last mean minus the odometry of its time: number of fixes, mean time, first to last
        ("less_odometry_ned_m", "f8", 3),
        ("mean_fixes", "i8"),
        ("mean_us", "i8"),
        ("span_us", "i8"),
        ("misfits", "i8"),
        # stated accuracy, and the variances derived from it
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
"""(N,) array of `MEMBER`."""
FILTER = np.dtype(
    [
        ("own", "i8"),  # row of the UAV that runs the filter
        ("time_us", "i8"),
        ("decay_owed_us", "i8"),  # time since slow errors were propagated, and their stride
        ("decay_stride_us", "i8"),
        ("distances_hz", "f8"),  # rate of distances per UAV, as either end
        ("own_range_us", "i8"),  # measurement time of the own UAV's newest fused distance; -1: none yet
        ("returned", "i8"),  # a silent UAV has sent odometry again
        ("step_ne_m", "f8", 2),  # size of the last odometry jump
        ("gps_var_m2", "f8"),  # variance after a GPS step: see `receivers.fuse_mean`
        # pending distances: their number; during an update those processed and those kept, and the odometry
        # between the ends of the last one
        ("pending", "i8"),
        ("done", "i8"),
        ("kept", "i8"),
        ("between_ned_m", "f8", 3),
        ("ranges_used", "i8"),
        ("ranges_downweighted", "i8"),
        ("ranges_too_late", "i8"),
        # copies of `LocalisationModel`
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
"""Scalars of the filter, besides its state and covariance."""
Filter = NDArray[np.void]
"""(1,) array of `FILTER`."""


def new_filter(own: int, model: LocalisationModel) -> Filter:
    """Return the initial row of a filter that runs at UAV ``own``."""
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
    """Return initial rows of ``count`` UAVs, without any measurement."""
    members: Members = np.zeros(count, MEMBER)
    for name in ("newest_us", "fix_us", "stated_us"):
        members[name] = -1
    return members
