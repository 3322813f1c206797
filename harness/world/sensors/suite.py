"""All sensors of all vehicles: converts the truth after a step to sensor readings."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numba import njit
from numpy.typing import NDArray

from autopilot.estimation import atmosphere
from autopilot.parameters.config import Site
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.types import Array
from harness.world.active_faults import Faults
from harness.world.physics.bodies import in_body_axes
from harness.world.physics.truth import Truth
from harness.world.sensors.config import PROFILES, GpsModel, SensorErrorModel, SensorsConfig
from harness.world.sensors.errors import SensorError

HPA_PER_PA = 0.01
LEAST_EPH_M = 0.01
"""Least accuracy that a receiver reports; also the resolution of HIL_GPS."""
MOST_SENSED_M, LEAST_SENSED_M = (atmosphere.altitude_m(pressure_pa) for pressure_pa in (1_000.0, 120_000.0))
"""Altitudes of the 10 and 1200 hPa between which barometers of this kind (MS5611) measure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GpsFixes:
    """One fix of each of n receivers, for the instant ``delay_s`` before its arrival."""

    lat_deg: Array
    """(n,)"""
    lon_deg: Array
    alt_m: Array
    """(n,) above mean sea level"""
    vel_ned_m_s: Array
    """(n, 3)"""
    eph_m: float
    """One sigma of each horizontal axis, of the sum of slow and white errors"""
    epv_m: float
    lost: NDArray[np.bool_] | None = None
    """(n,) receivers without a fix, whose other fields are invalid; None: all have one"""


class BaroSamples(NamedTuple):
    """One sample of each of n barometers."""

    pressure_hpa: Array
    """(n,)"""
    temperature_degc: Array
    """(n,)"""


class SensorFrame(Struct, frozen=True, kw_only=True):
    """Sensor readings for n vehicles at ``time_us``; None if a sensor has no new sample."""

    time_us: int
    accel_frd_m_s2: Array
    """(n, 3) specific force, mean of the step"""
    gyro_frd_rad_s: Array
    """(n, 3) mean of the step"""
    mag_frd_gauss: Array | None
    """(n, 3)"""
    baro: BaroSamples | None
    gps: GpsFixes | None


class SensorSuite:
    """Sensors of one profile in every vehicle, sampled once per physics step.

    Every kind of sensor has its own random stream and draws at fixed times for all vehicles at once, so the
    state of one vehicle does not affect the errors of others. A sensor whose period is no multiple of the
    step reports at the first step after it is due. The GPS delay is rounded to whole steps; the first fix
    comes after this delay. ``temperature_offset_k`` is the air temperature minus the standard atmosphere's;
    the barometers' thermometers report it, but the pressure remains the standard's.
    """

    def __init__(
        self,
        *,
        config: SensorsConfig,
        site: Site,
        vehicles: int,
        step_us: int,
        seed: np.random.SeedSequence,
        temperature_offset_k: float = 0.0,
    ) -> None:
        profile = PROFILES[config.profile]
        self._gps_model: GpsModel = config.gps_model()
        self._site = site
        self._step_us = step_us
        self._zero_degc_k = 273.15 - temperature_offset_k
        self._mag_period_us = round(1e6 / profile.mag_rate_hz)
        self._baro_period_us = round(1e6 / profile.baro_rate_hz)
        self._gps_period_us = round(1e6 / self._gps_model.rate_hz)
        self._field_ned_gauss = np.array(site.magnetic_field_ned_gauss)

        axes, step_s = (vehicles, 3), step_us * 1e-6
        mag_interval_s, baro_interval_s = self._mag_period_us * 1e-6, self._baro_period_us * 1e-6
        gps_interval_s = self._gps_period_us * 1e-6
        horizontal_std_m = self._gps_model.horizontal_bias_std_m
        vertical_std_m = self._gps_model.vertical_bias_std_m
        gps_position = SensorErrorModel(
            white_std=self._gps_model.white_std_m,
            drift_std=(horizontal_std_m, horizontal_std_m, vertical_std_m),
            drift_time_constant_s=self._gps_model.bias_time_constant_s,
        )
        gps_velocity = SensorErrorModel(white_std=self._gps_model.velocity_std_m_s)
        models = (
            (profile.accel_m_s2.at_interval(step_s), axes, step_s),
            (profile.gyro_rad_s.at_interval(step_s), axes, step_s),
            (profile.mag_gauss.at_interval(mag_interval_s), axes, mag_interval_s),
            (profile.baro_pa, (vehicles,), baro_interval_s),
            (gps_position, axes, gps_interval_s),
            (gps_velocity, axes, gps_interval_s),
        )
        self._errors = [
            SensorError(model, shape=shape, interval_s=interval_s, rng=np.random.default_rng(stream))
            for (model, shape, interval_s), stream in zip(models, seed.spawn(len(models)), strict=True)
        ]
        self._accel_error, self._gyro_error, self._mag_error, self._baro_error_pa = self._errors[:4]
        self._gps_position_error_m, self._gps_velocity_error_m_s = self._errors[4:]
        self._eph_m = max(float(np.hypot(horizontal_std_m, self._gps_model.white_std_m)), LEAST_EPH_M)
        self._epv_m = max(float(np.hypot(vertical_std_m, self._gps_model.white_std_m)), LEAST_EPH_M)
        delay_steps = round(self._gps_model.delay_s * 1e6 / step_us)
        self._recent: deque[Truth] = deque(maxlen=delay_steps + 1)
        self._last_baro: BaroSamples | None = None
        self._no_offset_m = np.zeros(vehicles)
        self._no_faults = Faults((), (0,) * vehicles, np.random.default_rng(0))

    def sample(self, time_us: int, truth: Truth, faults: Faults | None = None) -> SensorFrame:
        """Sample all sensors at the end of a step with state ``truth`` at ``time_us``.

        ``faults``, advanced to ``time_us``, are added to the sensors' own errors, which do not depend on
        them.
        """
        self._recent.append(truth)
        faults = faults if faults is not None else self._no_faults
        accel_frd_m_s2, gyro_frd_rad_s = inertial_samples(
            truth.rows, self._accel_error.next(), self._gyro_error.next()
        )
        if faults.accel_offset_frd_m_s2 is not None:
            accel_frd_m_s2 += faults.accel_offset_frd_m_s2
        if faults.gyro_offset_frd_rad_s is not None:
            gyro_frd_rad_s += faults.gyro_offset_frd_rad_s
        mag_due, baro_due, gps_due = (
            self._is_due(time_us, period_us)
            for period_us in (self._mag_period_us, self._baro_period_us, self._gps_period_us)
        )
        return SensorFrame(
            time_us=time_us,
            accel_frd_m_s2=accel_frd_m_s2,
            gyro_frd_rad_s=gyro_frd_rad_s,
            mag_frd_gauss=self._magnetometers(truth, faults) if mag_due else None,
            baro=self._barometers(truth, faults) if baro_due else None,
            gps=self._receivers(faults) if gps_due else None,
        )

    def draw_ahead(self) -> None:
        """Draw the random numbers of the next `sample` in advance. Changes no sample."""
        for error in self._errors:
            error.draw_ahead()

    def _is_due(self, time_us: int, period_us: int) -> bool:
        """Whether a multiple of the period lies in the step that ends now."""
        return time_us // period_us != (time_us - self._step_us) // period_us

    def _magnetometers(self, truth: Truth, faults: Faults) -> Array:
        field_frd_gauss = in_body_axes(truth.rows, self._field_ned_gauss)
        if faults.heading_error_rad is not None:
            for vehicle in np.flatnonzero(faults.heading_error_rad):
                field_ned_gauss = _turned(self._field_ned_gauss, -faults.heading_error_rad[vehicle])
                own = slice(vehicle, vehicle + 1)
                field_frd_gauss[own] = in_body_axes(truth.rows[own], field_ned_gauss)
        field_frd_gauss += self._mag_error.next()
        if faults.mag_offset_frd_gauss is not None:
            field_frd_gauss += faults.mag_offset_frd_gauss
        return field_frd_gauss

    def _barometers(self, truth: Truth, faults: Faults) -> BaroSamples:
        samples = BaroSamples(
            *barometer_samples(
                truth.rows,
                self._site.altitude_m,
                self._no_offset_m if faults.baro_offset_m is None else faults.baro_offset_m,
                self._baro_error_pa.next(),
                self._zero_degc_k,
            )
        )
        if faults.baro_frozen is not None and self._last_baro is not None:
            frozen, last = faults.baro_frozen, self._last_baro
            samples = BaroSamples(
                np.where(frozen, last.pressure_hpa, samples.pressure_hpa),
                np.where(frozen, last.temperature_degc, samples.temperature_degc),
            )
        self._last_baro = samples
        return samples

    def _receivers(self, faults: Faults) -> GpsFixes | None:
        position_error_ned_m = self._gps_position_error_m.next()
        velocity_error_ned_m_s = self._gps_velocity_error_m_s.next()
        if len(self._recent) != self._recent.maxlen:
            return None
        then = self._recent[0]
        errors = faults.gps_errors()
        if errors is not None:
            position_error_ned_m = position_error_ned_m + errors[0]
            velocity_error_ned_m_s = velocity_error_ned_m_s + errors[1]
        lat_deg, lon_deg, alt_m = ned_to_geodetic(
            then.pos_ned_m + position_error_ned_m,
            origin_lat_deg=self._site.latitude_deg,
            origin_lon_deg=self._site.longitude_deg,
            origin_alt_m=self._site.altitude_m,
        )
        return GpsFixes(
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_m=alt_m,
            vel_ned_m_s=then.vel_ned_m_s + velocity_error_ned_m_s,
            eph_m=self._eph_m,
            epv_m=self._epv_m,
            lost=faults.gps_lost,
        )


@njit(cache=True)
def inertial_samples(truth: NDArray[np.void], accel_error: Array, gyro_error: Array) -> tuple[Array, Array]:
    """Return samples of accelerometers and gyroscopes, (n, 3) each, from `TRUTH` (n,) and errors (n, 3)."""
    accel_frd_m_s2, gyro_frd_rad_s = np.empty((len(truth), 3)), np.empty((len(truth), 3))
    for i in range(len(truth)):
        for axis in range(3):
            accel_frd_m_s2[i, axis] = truth[i]["specific_force_frd_m_s2"][axis] + accel_error[i, axis]
            gyro_frd_rad_s[i, axis] = truth[i]["mean_omega_frd_rad_s"][axis] + gyro_error[i, axis]
    return accel_frd_m_s2, gyro_frd_rad_s


@njit(cache=True)
def barometer_samples(
    truth: NDArray[np.void], ground_altitude_m: float, offset_m: Array, error_pa: Array, zero_degc_k: float
) -> tuple[Array, Array]:
    """Return pressures (n,) in hPa and temperatures (n,) in degC for `TRUTH` (n,).

    The pressure is that at an altitude higher by ``offset_m`` (n,), plus ``error_pa`` (n,).
    """
    pressure_hpa, temperature_degc = np.empty(len(truth)), np.empty(len(truth))
    for i in range(len(truth)):
        altitude_m = ground_altitude_m - truth[i]["pos_ned_m"][2]
        sensed_m = min(max(altitude_m + offset_m[i], LEAST_SENSED_M), MOST_SENSED_M)
        pressure_hpa[i] = HPA_PER_PA * (atmosphere.pressure_pa(sensed_m) + error_pa[i])
        temperature_degc[i] = atmosphere.temperature_k(altitude_m) - zero_degc_k
    return pressure_hpa, temperature_degc


def _turned(vector_ned: Array, angle_rad: float) -> Array:
    """Rotate a vector (3,) clockwise seen from above."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    north, east, down = vector_ned
    return np.array([c * north - s * east, s * north + c * east, down])
