"""Settings of the sensors: a scenario's ``[sensors]`` table and its profiles.

- ``ideal``: no errors, at the same rates and delays.
- ``gazebo``: the effective errors of PX4's Gazebo-classic plugins, with an almost perfect GPS.
- ``consumer``: the same short-term noise, with the biases of calibrated low-cost parts and a metre-level
  GPS.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, structs

from harness.world.obstacles import Box
from netsim.model.config import ModelName

MOST_NAME = 32
"""Characters of the name of a sensor, and of its values, in tables."""
PositionStd = Annotated[float, Meta(ge=0.0, le=1000.0)]


class GpsOverrides(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[sensors.gps]`` table; None: the profile's value."""

    horizontal_bias_std_m: PositionStd | None = None
    """Stationary standard deviation, per axis, of the slow error (first-order Gauss-Markov)."""
    vertical_bias_std_m: PositionStd | None = None
    """The same of the vertical axis."""
    bias_time_constant_s: Annotated[float, Meta(gt=0.0, le=1e6)] | None = None
    """Correlation time of the slow error, seconds."""
    white_std_m: PositionStd | None = None
    """White error per axis and fix, in addition to the slow error."""
    velocity_std_m_s: Annotated[float, Meta(ge=0.0, le=50.0)] | None = None
    """White error of the velocity per axis and fix."""
    rate_hz: Annotated[float, Meta(ge=0.1, le=50.0)] | None = None
    """Fixes per second."""
    delay_s: Annotated[float, Meta(ge=0.0, le=0.3)] | None = None
    """Age of a fix when it arrives."""


class ExtraSensor(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A sensor in addition to those of the profile, which has no effect on them."""

    model: ModelName
    """``range_finder``, ``uwb_tag``, ``package.module:Class``, or the name of an entry point of the group
    ``coflight.sensors`` (docs/how-to/sensors-and-faults.md)."""
    name: Annotated[str, Meta(pattern=r"^([A-Za-z][A-Za-z0-9_]{0,31})?$")] = ""
    """Name in tables, and cut to ten characters in messages; "": that of the model."""
    uavs: Literal["all"] | tuple[Annotated[int, Meta(ge=0)], ...] = "all"
    """Numbers of the vehicles that have it, from 0."""
    settings: dict[str, Any] = {}
    """Settings of the model, checked against its own type."""
    folder: str = ""
    """Folder where the module is looked up first and to which paths in the settings are relative; "": that of
    the scenario's file."""

    @property
    def title(self) -> str:
        """The name, or that of the model without its module."""
        return self.name or self.model.rpartition(":")[2][:MOST_NAME]

    def vehicles(self, count: int) -> tuple[int, ...]:
        """Return the vehicles of ``count`` that have it, in increasing order."""
        return tuple(range(count)) if self.uavs == "all" else tuple(sorted(set(self.uavs)))


class SensorsConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[sensors]`` table."""

    profile: Literal["consumer", "gazebo", "ideal"] = "consumer"
    """Error models of all sensors: low-cost parts, those of Gazebo-classic, or none."""
    gps: GpsOverrides = GpsOverrides()
    """Settings of the GPS receiver that differ from the profile: the table ``[sensors.gps]``."""
    extra: tuple[ExtraSensor, ...] = ()
    """Sensors in addition: tables ``[[sensors.extra]]``."""
    boxes: tuple[Box, ...] = ()
    """Walls and buildings for the sensors in addition: tables ``[[sensors.boxes]]``. Vehicles and the radio
    do not meet them."""

    def gps_model(self) -> "GpsModel":
        """Return the profile's receiver with the scenario's overrides."""
        return PROFILES[self.profile].gps.overridden(self.gps)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorErrorModel:
    """Error of one sensor, equal for all axes: independent constant, slow and white parts."""

    white_std: float = 0.0
    """Standard deviation of the white part per sample"""
    turn_on_std: float = 0.0
    """Standard deviation of the constant part, drawn once"""
    drift_std: float | tuple[float, float, float] = 0.0
    """Stationary standard deviation of a first-order Gauss-Markov process; a tuple if the axes differ"""
    drift_time_constant_s: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class InertialErrorModel:
    """`SensorErrorModel` in the units of data sheets, independent of the sampling rate."""

    noise_density: float = 0.0
    """White noise, unit/sqrt(Hz)"""
    turn_on_std: float = 0.0
    random_walk: float = 0.0
    """Density of the noise that drives the drift, unit sqrt(Hz)"""
    correlation_s: float = 1.0
    """Time constant of the drift"""

    def at_interval(self, interval_s: float) -> SensorErrorModel:
        """Return the error model of samples ``interval_s`` apart.

        A Gauss-Markov process of time constant τ driven by white noise of density d has variance d² τ / 2.
        """
        return SensorErrorModel(
            white_std=self.noise_density / interval_s**0.5,
            turn_on_std=self.turn_on_std,
            drift_std=self.random_walk * (self.correlation_s / 2.0) ** 0.5,
            drift_time_constant_s=self.correlation_s,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class GpsModel:
    """The fields of `GpsOverrides`, all with values."""

    horizontal_bias_std_m: float = 0.0
    vertical_bias_std_m: float = 0.0
    bias_time_constant_s: float = 60.0
    white_std_m: float = 0.0
    velocity_std_m_s: float = 0.0
    rate_hz: float = 5.0
    delay_s: float = 0.12

    def overridden(self, overrides: GpsOverrides) -> "GpsModel":
        """Return the model with the scenario's overrides."""
        values = {name: value for name, value in structs.asdict(overrides).items() if value is not None}
        return replace(self, **values)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorProfile:
    """One vehicle's sensors."""

    accel_m_s2: InertialErrorModel = InertialErrorModel()
    gyro_rad_s: InertialErrorModel = InertialErrorModel()
    mag_gauss: InertialErrorModel = InertialErrorModel()
    baro_pa: SensorErrorModel = SensorErrorModel()
    gps: GpsModel = GpsModel()
    mag_rate_hz: float = 50.0
    baro_rate_hz: float = 50.0


_GAZEBO_ACCEL_DENSITY = 6.37e-3
_GAZEBO_GYRO_DENSITY = 8.726646e-4
_GAZEBO_MAG = InertialErrorModel(noise_density=4e-4, random_walk=6.4e-6, correlation_s=600.0)

PROFILES: dict[str, SensorProfile] = {
    "ideal": SensorProfile(),
    "gazebo": SensorProfile(
        accel_m_s2=InertialErrorModel(noise_density=_GAZEBO_ACCEL_DENSITY),
        gyro_rad_s=InertialErrorModel(noise_density=_GAZEBO_GYRO_DENSITY),
        mag_gauss=_GAZEBO_MAG,
        baro_pa=SensorErrorModel(white_std=1.0),
        # The GPS plugin runs every dt = 4 ms: its bias changes by 2.0 sqrt(dt) dt (vertical 4.0) and decays
        # by 1/60 each time, so its rms is 5.06e-4 m x sqrt(60/2) and its time constant 60 dt; its
        # white noises are 2e-4 sqrt(dt) m and 0.2 sqrt(dt) m/s.
        gps=GpsModel(
            horizontal_bias_std_m=2.8e-3,
            vertical_bias_std_m=5.5e-3,
            bias_time_constant_s=0.24,
            white_std_m=1.3e-5,
            velocity_std_m_s=1.26e-2,
        ),
    ),
    "consumer": SensorProfile(
        # Gazebo's densities represent the part and the airframe's vibration. Drift: ADIS16448, which Gazebo
        # modelled before. Turn-on: of the gyro from the same part; of the accelerometer the residual of a
        # six-sided calibration at 0.5 mg/K over 10 K. Drift and turn-on together: 0.09 m/s^2.
        accel_m_s2=InertialErrorModel(
            noise_density=_GAZEBO_ACCEL_DENSITY, turn_on_std=0.05, random_walk=6e-3, correlation_s=300.0
        ),
        gyro_rad_s=InertialErrorModel(
            noise_density=_GAZEBO_GYRO_DENSITY,
            turn_on_std=8.73e-3,
            random_walk=3.879e-5,
            correlation_s=1000.0,
        ),
        # 2 mgauss of hard iron after calibration: half a degree of heading with 0.215 gauss horizontally
        mag_gauss=replace(_GAZEBO_MAG, turn_on_std=2e-3),
        # absolute accuracy of a phone-grade part +-50 Pa, interpreted as 2 sigma; 2 Pa (17 cm) of slow drift
        baro_pa=SensorErrorModel(white_std=1.0, turn_on_std=25.0, drift_std=2.0, drift_time_constant_s=300.0),
        gps=GpsModel(
            horizontal_bias_std_m=1.5,
            vertical_bias_std_m=2.5,
            bias_time_constant_s=60.0,
            white_std_m=0.1,
            velocity_std_m_s=0.1,
        ),
    ),
}
