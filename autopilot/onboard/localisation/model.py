"""What the localisation assumes of its inputs."""

from dataclasses import dataclass

CLOCK_TOLERANCE_US = 10_000
"""A time stamp may be this far in the future; beyond, it is wrong."""
SILENCE_US = 3_000_000
"""Who has not been heard of for this long is not waited for, and has no part in the geometry."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalisationModel:
    """What the filter assumes of its inputs; standard deviations are one sigma."""

    gps_bias_std_m: float = 1.5
    """Per horizontal axis; a receiver that states a worse accuracy is taken at its word."""
    gps_bias_vertical_std_m: float = 2.5
    gps_bias_time_constant_s: float = 60.0
    gps_white_std_m: float = 0.2
    """Per horizontal axis, of one fix."""
    odometry_drift_m_sqrt_s: float = 0.1
    """Horizontal, per axis, after one second; grows with the root of time."""
    height_std_m: float = 0.2
    height_time_constant_s: float = 100.0
    range_floor_std_m: float = 0.05
    """What averaging within a session does not reduce; added in squares to what the session states."""
    gather_s: float = 2.5
    """How long distances are gathered for those who do not answer before the others are solved for."""
