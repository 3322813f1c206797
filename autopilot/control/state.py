"""One record with the settings and states of a vehicle's controllers.

Compiled code receives one array instead of forty, each of which would have to be unboxed, and the data of one
step are adjacent. The controllers in Python hold its nested records.
"""

from typing import Annotated

from autopilot.control.allocation import Allocation
from autopilot.control.attitude import Attitude
from autopilot.control.disturbance import Disturbance
from autopilot.control.hover_thrust import HoverThrust
from autopilot.control.position import Position
from autopilot.control.rates import Rates
from foundation.types import Array


class CascadeState:
    """Record of the cascade; the first fields, up to ``flies``, are the inputs of one sample."""

    yaw_rad: float
    """Heading setpoint, clockwise from north."""
    yaw_rate_rad_s: float
    climb_max_m_s: float
    """Limit of the take-off ramp."""
    dt_s: float
    """Since the last sample."""
    velocity_valid: bool
    idles: bool
    """In the ground phase of the take-off."""
    landed: bool
    flies: bool
    """In the flying phase of the take-off."""
    by_tilt: bool
    """Apply only the component of the thrust along the present axis, none while upside down."""
    updates: int
    """Number of samples with a trajectory setpoint since the last other one."""
    position_divider: int
    since_position_s: float
    """Time since the position loop ran."""
    disturbance: Disturbance
    hover: HoverThrust
    position: Position
    attitude: Attitude
    rates: Rates
    allocation: Allocation
    rate_setpoint_frd_rad_s: Annotated[Array, 3]
    """Of the last step, like the torque."""
    torque: Annotated[Array, 3]
    """Normalised, FRD."""
