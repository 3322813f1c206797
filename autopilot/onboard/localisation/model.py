"""Noise model and limits of the localisation."""

from dataclasses import dataclass

CLOCK_TOLERANCE_US = 10_000
"""A time stamp may be this far in the future; beyond that it is rejected."""
SILENCE_US = 3_000_000
"""A UAV without a beacon for this long is not waited for and not part of the geometry."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalisationModel:
    """Noise model of the filter's inputs; standard deviations are one sigma."""

    gps_bias_std_m: float = 1.5
    """Per horizontal axis; if a receiver states a worse accuracy, that is used."""
    gps_bias_vertical_std_m: float = 2.5
    gps_bias_time_constant_s: float = 60.0
    gps_white_std_m: float = 0.2
    """Per horizontal axis, of one fix."""
    odometry_drift_m_sqrt_s: float = 0.1
    """Horizontal, per axis, after one second; grows with the square root of time."""
    height_std_m: float = 0.2
    height_time_constant_s: float = 100.0
    range_floor_std_m: float = 0.05
    """Error that averaging within a session does not reduce; its square adds to the session's variance."""
    gather_s: float = 2.5
    """How long to wait for distances of UAVs that do not answer before solving for the others."""
