"""One block of memory with the settings and states of a vehicle's controllers.

Compiled code receives one array instead of forty, each of which would have to be unboxed, and the data of one
step are adjacent. The controllers hold views of the block; a controller used separately has its own block.
"""

import numpy as np
from numpy.typing import NDArray

Block = NDArray[np.void]
"""(1,) array of `CASCADE`"""

CASCADE = np.dtype(
    [
        # inputs of one sample, which `FlightController` writes together
        ("turn", "f8", 3),  # heading, yaw rate and climb limit: `cascade.YAW` and the following
        ("dt_s", "f8"),  # since the last sample
        ("velocity_valid", "u1"),  # compiled code has no booleans in a block
        ("idles", "u1"),  # in the ground phase of the take-off
        ("landed", "u1"),
        ("flies", "u1"),  # in the flying phase of the take-off
        ("by_tilt", "u1"),  # see `inner_loop.InnerLoop.update`
        # setpoint: `PositionController.take` writes that of a trajectory
        ("setpoint", "f8", (3, 3)),
        ("mask", "u1", (3, 3)),
        # state of the position loop's divider
        ("updates", "i8"),
        ("position_divider", "i8"),
        ("since_position_s", "f8"),
        # settings and memory of each controller, in the layout of its kernel
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
    """Return a block of zeros."""
    return np.zeros(1, CASCADE)
