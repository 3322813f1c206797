"""Settings of the estimator, in the units of the PX4 parameters that they are named after."""

import math
from typing import Annotated

from msgspec import Meta, Struct

from autopilot.parameters.config import Site, Vector

PositiveSmall = Annotated[float, Meta(gt=0.0, le=10.0)]
Gate = Annotated[float, Meta(ge=1.0, le=100.0)]

PX4_FILTER_PERIOD_S = 0.01
"""EKF2_PREDICT_US: PX4 states its process noises as rms of one filter period's mean."""


class EstimatorParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the filter assumes of the vehicle's sensors and site.

    Process noises are PX4's numbers: the rms of a 10 ms mean, so white noise of density value x sqrt(10 ms).
    The defaults fit the simulated Iris, its white noises with a margin of about two for what no model says.
    """

    gyro_noise_rad_s: PositiveSmall = 0.015
    """EKF2_GYR_NOISE"""
    accel_noise_m_s2: PositiveSmall = 0.15
    """EKF2_ACC_NOISE"""
    gyro_bias_noise_rad_s2: PositiveSmall = 1e-3
    """EKF2_GYR_B_NOISE"""
    accel_bias_noise_m_s3: PositiveSmall = 0.01
    """EKF2_ACC_B_NOISE: as fast as the range lets it follow the consumer part's drift (PX4: 0.003)"""
    accel_bias_init_m_s2: PositiveSmall = 0.1
    """EKF2_ABIAS_INIT: one sigma per axis at switch-on (PX4: 0.2); the consumer part has 0.09, of which 0.05
    turn-on. A wider one lets a hover, which cannot tell bias from tilt, learn what is neither"""
    gyro_bias_limit_rad_s: PositiveSmall = 0.15
    """EKF2_GYR_B_LIM, per axis"""
    accel_bias_limit_m_s2: PositiveSmall = 0.4
    """EKF2_ABL_LIM, per axis"""

    gps_delay_us: Annotated[int, Meta(ge=0, le=300_000)] = 120_000
    """EKF2_GPS_DELAY (there in ms): age of a fix when it arrives, and so the lag of the filter's horizon"""
    gps_pos_noise_m: PositiveSmall = 0.5
    """EKF2_GPS_P_NOISE: least horizontal noise, whatever ``eph_m`` says"""
    gps_vel_noise_m_s: PositiveSmall = 0.2
    """EKF2_GPS_V_NOISE, per horizontal axis; the vertical axis is taken as 1.5 times as noisy, as in PX4"""
    gps_pos_gate: Gate = 5.0
    """EKF2_GPS_P_GATE, standard deviations"""
    gps_vel_gate: Gate = 5.0
    """EKF2_GPS_V_GATE, standard deviations"""
    gps_required_eph_m: PositiveSmall = 5.0
    """EKF2_REQ_EPH: a fix worse than this neither sets the origin nor is fused"""
    gps_required_satellites: Annotated[int, Meta(ge=4, le=12)] = 6
    """EKF2_REQ_NSATS: likewise"""
    baro_noise_m: PositiveSmall = 0.35
    """EKF2_BARO_NOISE, of readings as often as SENS_BARO_RATE has them"""
    baro_gate: Gate = 5.0
    """EKF2_BARO_GATE, standard deviations"""
    mag_noise_gauss: PositiveSmall = 0.014
    """EKF2_MAG_NOISE, per axis, of readings as often as SENS_MAG_RATE has them"""
    heading_gate: Gate = 2.6
    """EKF2_HDG_GATE, standard deviations"""
    magnetic_field_ned_gauss: Vector = Site().magnetic_field_ned_gauss
    """Of the site: declination (EKF2_MAG_DECL) and inclination; its horizontal part must not vanish."""

    mag_check: Annotated[int, Meta(ge=0, le=3)] = 1
    """EKF2_MAG_CHECK: what of the field must be the site's: 1 its strength, 2 its inclination, 3 both"""
    mag_check_strength_gauss: PositiveSmall = 0.2
    """EKF2_MAG_CHK_STR: a field that is stronger or weaker by more is of something near, and not used"""
    mag_check_inclination_rad: Annotated[float, Meta(gt=0.0, le=math.pi)] = math.radians(20.0)
    """EKF2_MAG_CHK_INC (there in degrees): likewise of its angle below the horizon"""

    no_aid_timeout_us: Annotated[int, Meta(ge=500_000, le=10_000_000)] = 5_000_000
    """EKF2_NOAID_TOUT: dead reckoning longer than this invalidates velocity and position"""
    no_aid_noise_m: Annotated[float, Meta(ge=0.5, le=50.0)] = 10.0
    """EKF2_NOAID_NOISE: how firmly the last known position is then held, which keeps tilt bounded"""

    @property
    def process_noise_psd(self) -> tuple[float, float, float, float]:
        """Power spectral densities: gyro, accelerometer, gyro bias's and accelerometer bias's walk."""
        return (
            self.gyro_noise_rad_s**2 * PX4_FILTER_PERIOD_S,
            self.accel_noise_m_s2**2 * PX4_FILTER_PERIOD_S,
            self.gyro_bias_noise_rad_s2**2 * PX4_FILTER_PERIOD_S,
            self.accel_bias_noise_m_s3**2 * PX4_FILTER_PERIOD_S,
        )

    @property
    def heading_noise_rad(self) -> float:
        """One sigma of the heading of one magnetometer sample."""
        return self.mag_noise_gauss / math.hypot(*self.magnetic_field_ned_gauss[:2])
