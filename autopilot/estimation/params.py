"""Settings of the estimator, in the units of the corresponding PX4 parameters."""

import math
from typing import Annotated

from msgspec import Meta, Struct

from autopilot.parameters.config import Site, Vector

PositiveSmall = Annotated[float, Meta(gt=0.0, le=10.0)]
Gate = Annotated[float, Meta(ge=1.0, le=100.0)]

PX4_FILTER_PERIOD_S = 0.01
"""EKF2_PREDICT_US: PX4 states process noises as the rms of the mean over one filter period."""


class EstimatorParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Noises, gates and limits of the filter.

    Process noises are PX4's: the rms of a 10 ms mean, so white noise of density value x sqrt(10 ms). The
    defaults fit the simulated Iris; its white noises have a margin of about two for unmodelled errors.
    """

    gyro_noise_rad_s: PositiveSmall = 0.015
    """EKF2_GYR_NOISE: gyro process noise"""
    accel_noise_m_s2: PositiveSmall = 0.15
    """EKF2_ACC_NOISE: accelerometer process noise"""
    gyro_bias_noise_rad_s2: PositiveSmall = 1e-3
    """EKF2_GYR_B_NOISE: process noise of the gyro bias"""
    accel_bias_noise_m_s3: PositiveSmall = 0.01
    """EKF2_ACC_B_NOISE: process noise of the accelerometer bias, the greatest allowed, for the drift of the
    consumer-grade sensor (PX4: 0.003)"""
    accel_bias_init_m_s2: PositiveSmall = 0.1
    """EKF2_ABIAS_INIT: initial standard deviation of the accelerometer bias, per axis (PX4: 0.2). The
    consumer-grade sensor has 0.09, of which 0.05 turn-on bias. In hover, bias and tilt are not separately
    observable; a greater value lets both drift"""
    gyro_bias_limit_rad_s: PositiveSmall = 0.15
    """EKF2_GYR_B_LIM: limit of the gyro bias, per axis"""
    accel_bias_limit_m_s2: PositiveSmall = 0.4
    """EKF2_ABL_LIM: limit of the accelerometer bias, per axis"""

    gps_delay_us: Annotated[int, Meta(ge=0, le=300_000)] = 120_000
    """EKF2_GPS_DELAY (there in ms): age of a fix when it arrives, equal to the delay of the filter's
    horizon"""
    gps_pos_noise_m: PositiveSmall = 0.5
    """EKF2_GPS_P_NOISE: least horizontal noise of a position, also if ``eph_m`` is smaller"""
    gps_vel_noise_m_s: PositiveSmall = 0.2
    """EKF2_GPS_V_NOISE: velocity noise per horizontal axis; 1.5 times as large on the vertical axis, as in
    PX4"""
    gps_pos_gate: Gate = 5.0
    """EKF2_GPS_P_GATE: innovation gate of the position, standard deviations"""
    gps_vel_gate: Gate = 5.0
    """EKF2_GPS_V_GATE: innovation gate of the velocity, standard deviations"""
    gps_required_eph_m: PositiveSmall = 5.0
    """EKF2_REQ_EPH: a less accurate fix is not used, neither for the origin nor for fusion"""
    gps_required_satellites: Annotated[int, Meta(ge=4, le=12)] = 6
    """EKF2_REQ_NSATS: a fix with fewer satellites is not used"""
    baro_noise_m: PositiveSmall = 0.35
    """EKF2_BARO_NOISE: noise of barometer readings at SENS_BARO_RATE"""
    baro_gate: Gate = 5.0
    """EKF2_BARO_GATE: innovation gate of the barometer, standard deviations"""
    mag_noise_gauss: PositiveSmall = 0.014
    """EKF2_MAG_NOISE: noise per axis of magnetometer readings at SENS_MAG_RATE"""
    heading_gate: Gate = 2.6
    """EKF2_HDG_GATE: innovation gate of the heading, standard deviations"""
    magnetic_field_ned_gauss: Vector = Site().magnetic_field_ned_gauss
    """Magnetic field of the site: declination (EKF2_MAG_DECL) and inclination; its horizontal part must not
    be zero."""

    mag_check: Annotated[int, Meta(ge=0, le=3)] = 1
    """EKF2_MAG_CHECK: properties of the field that must match the site's: 1 strength, 2 inclination, 3
    both"""
    mag_check_strength_gauss: PositiveSmall = 0.2
    """EKF2_MAG_CHK_STR: a field whose strength differs by more is disturbed and not used"""
    mag_check_inclination_rad: Annotated[float, Meta(gt=0.0, le=math.pi)] = math.radians(20.0)
    """EKF2_MAG_CHK_INC (there in degrees): a field whose inclination differs by more is not used"""

    no_aid_timeout_us: Annotated[int, Meta(ge=500_000, le=10_000_000)] = 5_000_000
    """EKF2_NOAID_TOUT: duration of dead reckoning after which velocity and position are invalid"""
    no_aid_noise_m: Annotated[float, Meta(ge=0.5, le=50.0)] = 10.0
    """EKF2_NOAID_NOISE: noise with which the last known position is then fused, to bound the tilt error"""

    @property
    def process_noise_psd(self) -> tuple[float, float, float, float]:
        """Power spectral densities: gyro, accelerometer, random walks of gyro and accelerometer bias."""
        return (
            self.gyro_noise_rad_s**2 * PX4_FILTER_PERIOD_S,
            self.accel_noise_m_s2**2 * PX4_FILTER_PERIOD_S,
            self.gyro_bias_noise_rad_s2**2 * PX4_FILTER_PERIOD_S,
            self.accel_bias_noise_m_s3**2 * PX4_FILTER_PERIOD_S,
        )

    @property
    def heading_noise_rad(self) -> float:
        """Standard deviation of the heading of one magnetometer sample."""
        return self.mag_noise_gauss / math.hypot(*self.magnetic_field_ned_gauss[:2])
