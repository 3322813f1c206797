"""Values exchanged between the parts of the autopilot.

Frames: NED (local, from the estimator's origin) and FRD (body). Quaternions are Hamilton, wxyz, and
``q_ned_frd`` maps FRD to NED. Arrays are float64 and owned by their creator: a receiver that stores one must
copy it. Values created at every step are msgspec Structs, which are cheaper than frozen dataclasses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
"""Vector as a tuple, where array operations would cost more than the arithmetic."""
Triple = Sequence[float] | Array
"""Three numbers that are read one by one"""


class Course(Enum):
    """Phase of an autonomous flight mode relative to the ground."""

    TAKE_OFF = "take off"
    LANDING = "landing"
    OTHER = "other"


class ImuSample(Struct, frozen=True, kw_only=True):
    """One inertial sample: mean over the interval that ends at ``time_us``."""

    time_us: int
    accel_frd_m_s2: Triple
    """(3,) specific force: (0, 0, -9.81) at rest and level."""
    gyro_frd_rad_s: Triple
    """(3,)"""


@dataclass(frozen=True, slots=True, kw_only=True)
class GpsFix:
    """One GPS solution, valid at ``time_us - delay``, where the delay is a parameter."""

    time_us: int
    """Time of arrival."""
    fix_type: int
    """GPS_FIX_TYPE; 3 or more is a 3-D fix."""
    lat_deg: float
    lon_deg: float
    alt_m: float
    """Above mean sea level."""
    vel_ned_m_s: Array
    """(3,)"""
    eph_m: float
    epv_m: float
    satellites: int


@dataclass(slots=True, kw_only=True)
class EstimatorState:
    """State estimate at the time of `Clock.estimate_us`, relative to ``origin``, the first good fix.

    Not frozen, since the estimator updates one in place: see `Estimator.live`. Its vectors are copies of the
    arguments and views of ``estimate``, so that compiled code can use one array.
    """

    q_ned_frd: Array
    """(4,) wxyz"""
    vel_ned_m_s: Array
    pos_ned_m: Array
    omega_frd_rad_s: Array
    """(3,) body rates less the estimated gyro bias"""
    acc_ned_m_s2: Array
    """(3,) acceleration of the body over ground, gravity removed"""
    gyro_bias_rad_s: Array
    accel_bias_m_s2: Array
    pos_std_m: Array
    """(3,) one sigma, NED"""
    vel_std_m_s: Array
    attitude_std_rad: Array
    """(3,) about NED axes"""
    origin_lat_deg: float
    origin_lon_deg: float
    origin_alt_m: float
    attitude_valid: bool
    velocity_valid: bool
    position_valid: bool
    """Horizontal position and origin are known."""
    height_valid: bool
    reset_counter: int
    """Incremented when position, velocity or heading is reset, that is, changes not by fusion."""
    navigation_failed: bool = False
    """Velocity and position of all fixes were rejected for 1 s; neither is valid then."""
    pos_reset_counter: int = 0
    """Resets of the horizontal position among ``reset_counter``; likewise the next three."""
    height_reset_counter: int = 0
    vel_reset_counter: int = 0
    yaw_reset_counter: int = 0
    pos_reset_delta_ned_m: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) change of position in the step of the last reset of any kind: new minus old."""
    vel_reset_delta_ned_m_s: Array = field(default_factory=lambda: np.zeros(3))
    yaw_reset_delta_rad: float = 0.0
    """Change of yaw, about down, in the last reset, in [-pi, pi]"""
    estimate: Array = field(init=False)
    """(31,) vectors in the layout of `autopilot.estimation`"""

    def __post_init__(self) -> None:
        """Copy the vectors into a new ``estimate``."""
        self.use_memory(np.concatenate([getattr(self, name) for name, _ in _LAID_OUT]))

    def use_memory(self, estimate: Array) -> None:
        """Make the vectors views of another estimate (31,)."""
        self.estimate, at = estimate, 0
        for name, size in _LAID_OUT:
            setattr(self, name, estimate[at : at + size])
            at += size


_LAID_OUT = (
    ("q_ned_frd", 4), ("vel_ned_m_s", 3), ("pos_ned_m", 3), ("gyro_bias_rad_s", 3), ("accel_bias_m_s2", 3),
    ("acc_ned_m_s2", 3), ("omega_frd_rad_s", 3), ("attitude_std_rad", 3), ("vel_std_m_s", 3),
    ("pos_std_m", 3),
)  # fmt: skip
"""The vectors of an `EstimatorState`, in the order of its ``estimate``, and their sizes."""


class TrajectorySetpoint(Struct, frozen=True, kw_only=True):
    """Trajectory setpoint: for each axis a position, else a velocity, else an acceleration.

    None means that the group is not controlled. With a position, velocity and acceleration are feed-forward.
    ``pos_axes``, ``vel_axes`` and ``acc_axes`` limit a group to some of its axes (north, east, down), for
    example to hold a position and descend at a speed. A vector may be a tuple, which is cheaper than an
    array.
    """

    pos_ned_m: Triple | None = None
    vel_ned_m_s: Triple | None = None
    acc_ned_m_s2: Triple | None = None
    pos_axes: tuple[bool, bool, bool] = (True, True, True)
    vel_axes: tuple[bool, bool, bool] = (True, True, True)
    acc_axes: tuple[bool, bool, bool] = (True, True, True)
    yaw_rad: float | None = None
    """None keeps the present yaw setpoint."""
    yaw_rate_rad_s: float = 0.0


class AttitudeSetpoint(Struct, frozen=True, kw_only=True):
    """Setpoint of the attitude controller."""

    q_ned_frd: Array
    """(4,) wxyz"""
    yaw_rate_rad_s: float
    """Feed-forward yaw rate about NED down"""
    thrust: float
    """Collective thrust, 0..1, along -z of the body"""


class RateSetpoint(Struct, frozen=True, kw_only=True):
    """Setpoint of the rate controller, within its limits; the attitude is not controlled."""

    rate_frd_rad_s: Array
    """(3,)"""
    thrust: float
    """As in `AttitudeSetpoint`"""


Setpoint = TrajectorySetpoint | AttitudeSetpoint | RateSetpoint
"""Setpoint of the flight controller"""
