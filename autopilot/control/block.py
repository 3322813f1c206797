"""Where a vehicle's controllers keep what they go by and what they remember: one block of memory.

Compiled code is then given one array instead of forty, each of them an object to be looked into, and what a
step reads lies together. The controllers have views of it; one that is used alone has a block of its own.
"""

import numpy as np
from numpy.typing import NDArray

Block = NDArray[np.void]
"""(1,) of `CASCADE`"""

CASCADE = np.dtype(
    [
        # what is so in a sample, which `FlightController` lays out as a whole
        ("turn", "f8", 3),  # how it is to turn and may climb, as `cascade.YAW` and the rest have it
        ("dt_s", "f8"),  # since the last sample
        ("velocity_valid", "u1"),  # compiled code knows no truth values within a block
        ("idles", "u1"),  # on the ground
        ("landed", "u1"),
        ("flies", "u1"),  # neither that nor taking off
        # what is followed: `PositionController.take` lays out a trajectory's setpoint
        ("wanted", "f8", (3, 3)),
        ("mask", "u1", (3, 3)),
        # how far the position loop's divider is
        ("updates", "i8"),
        ("position_divider", "i8"),
        ("since_position_s", "f8"),
        # settings and memory of one controller after the other, as their kernels have them
        ("observer_settings", "f8", 3),
        ("observer", "f8", 4),
        ("hover_settings", "f8", 4),
        ("hover", "f8", 5),
        ("position_gains", "f8", (4, 3)),
        ("position_limits", "f8", 8),
        ("position", "f8", (2, 3)),
        ("decided", "f8", (4, 4)),
        ("attitude_gain", "f8", 3),
        ("yaw_weight", "f8"),
        ("rate_max_rad_s", "f8", 3),
        ("tilt_cosine", "f8"),
        ("rate_gains", "f8", (4, 3)),
        ("integral_max", "f8"),
        ("rate_cutoff_hz", "f8"),
        ("rate_state", "f8", (3, 3)),
        ("stages", "f8", (2, 3)),
        ("mix", "f8", (4, 3)),
        ("yaw_thrust_margin", "f8"),
        ("thrust_model_factor", "f8"),
        ("thrust", "f8"),
        ("unallocated", "f8", 3),
        ("controls", "f8", 4),
    ],
    align=True,
)


def new_block() -> Block:
    """Zeros."""
    return np.zeros(1, CASCADE)
