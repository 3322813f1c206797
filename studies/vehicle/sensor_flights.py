"""Prescribed flights with noisy sensors: truth in closed form, samples of an Iris's sensors, replay.

There is no physics and no controller: the path is prescribed, and the attitude follows from the thrust it
requires. The estimator is thus compared with exact truth under exactly known noises.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from autopilot.estimation import atmosphere
from autopilot.estimation.estimator import Estimator
from autopilot.parameters.config import Site
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.types import Array, EstimatorState, GpsFix, ImuSample

STEP_US = 4_000
STEP_S = STEP_US * 1e-6
GPS_STEPS = 50
SLOW_STEPS = 10
"""Steps between samples of magnetometer and barometer, as in a vehicle."""
GPS_DELAY_S = 0.12
SITE = Site()
FIELD_NED_GAUSS = np.array(SITE.magnetic_field_ned_gauss)
Path = Callable[[Array], tuple[Array, Array]]
"""Maps times (n,) to NED positions (n, 3) and yaw (n,); at rest for the first 5 s."""


def ramp(time_s: Array) -> Array:
    """Return the path parameter in seconds: 0 before the start, then with a rate that rises smoothly to 1."""
    start_s, rise_s = 5.0, 4.0
    u = np.clip((time_s - start_s) / rise_s, 0.0, 1.0)
    motion: Array = rise_s * (2.5 * u**4 - 3.0 * u**5 + u**6) + np.maximum(0.0, time_s - start_s - rise_s)
    return motion


def rest(time_s: Array) -> tuple[Array, Array]:
    """Stay at the origin."""
    return np.zeros((time_s.size, 3)), np.full(time_s.size, 0.7)


def circle(time_s: Array) -> tuple[Array, Array]:
    """5 m/s on a radius of 5 m: 5 m/s^2, 27 degrees of tilt, constant yaw."""
    phase = ramp(time_s)
    pos_m = np.stack((5.0 * np.sin(phase), 5.0 - 5.0 * np.cos(phase), -0.5 * phase), axis=-1)
    return pos_m, np.full(time_s.size, 0.7)


def figure_eight(time_s: Array) -> tuple[Array, Array]:
    """Up to 6 m/s and 5 m/s^2, with climbs, descents and varying yaw."""
    phase = ramp(time_s)
    pos_m = np.stack(
        (8.0 * np.sin(0.55 * phase), 4.0 * np.sin(1.1 * phase), -3.0 + 3.0 * np.cos(0.4 * phase)), axis=-1
    )
    return pos_m, 0.7 + 1.5 * np.sin(0.3 * phase)


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Standard deviations of each sensor; the defaults are those of the Iris with a GPS bias of 1.5 m."""

    gyro_rad_s: float = 0.0138
    accel_m_s2: float = 0.1
    gyro_bias_rad_s: Array = field(default_factory=lambda: np.array([0.008, -0.006, 0.004]))
    """Initial value, not a standard deviation"""
    accel_bias_m_s2: Array = field(default_factory=lambda: np.array([0.05, -0.04, 0.12]))
    """Initial value, not a standard deviation"""
    gyro_bias_walk_rad_s: float = 0.0
    """After 1 s, growing with the root of time; like the next field"""
    accel_bias_walk_m_s2: float = 0.0
    mag_gauss: float = 0.004
    baro_pa: float = 1.0
    gps_bias_m: float = 1.5
    gps_bias_time_s: float = 60.0
    gps_pos_m: float = 0.1
    gps_vel_m_s: float = 0.1
    """Horizontal"""
    gps_vel_down_ratio: float = 1.0
    """Ratio of the vertical to the horizontal velocity noise"""
    gps_eph_m: float = 1.5


@dataclass(frozen=True, kw_only=True)
class SimulatedFlight:
    """Truth and sensor samples at times (n,); row k is the step that ends at ``time_us[k]``."""

    time_us: NDArray[np.int64]
    pos_ned_m: Array
    vel_ned_m_s: Array
    rotations_ned_frd: Rotation
    gyro_rad_s: Array
    accel_m_s2: Array
    field_gauss: Array
    pressure_pa: Array
    fixes: dict[int, GpsFix]
    """By step"""
    gps_bias_ned_m: Array
    """(n, 3) bias of the fix that arrives at the step"""
    gyro_bias_rad_s: Array
    """(n, 3), like the next field"""
    accel_bias_m_s2: Array


def _kinematics(path: Path, time_s: Array) -> tuple[Array, Array, Array, Rotation]:
    """Return position, velocity, acceleration and the attitude with its -z axis along the specific force."""
    h_s = 1e-3
    (before_m, _), (pos_m, yaw_rad), (after_m, _) = path(time_s - h_s), path(time_s), path(time_s + h_s)
    vel_m_s = (after_m - before_m) / (2.0 * h_s)
    acc_m_s2 = (after_m - 2.0 * pos_m + before_m) / h_s**2
    force_m_s2 = acc_m_s2 - [0.0, 0.0, atmosphere.GRAVITY_M_S2]
    z_axis = -force_m_s2 / np.linalg.norm(force_m_s2, axis=1, keepdims=True)
    nose = np.stack((np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)), axis=-1)
    y_axis = np.cross(z_axis, nose)
    y_axis /= np.linalg.norm(y_axis, axis=1, keepdims=True)
    dcms = np.stack((np.cross(y_axis, z_axis), y_axis, z_axis), axis=-1)
    return pos_m, vel_m_s, acc_m_s2, Rotation.from_matrix(dcms)


def _walk(rng: np.random.Generator, start: Array, walk: float, steps: int) -> Array:
    """Return a bias with random walk, (n, 3); nothing is drawn if ``walk`` is 0."""
    if walk == 0.0:
        return np.tile(start, (steps, 1))
    bias: Array = start + walk * np.sqrt(STEP_S) * np.cumsum(rng.standard_normal((steps, 3)), axis=0)
    return bias


def _fixes(
    path: Path, time_s: Array, rng: np.random.Generator, noise: Noise
) -> tuple[dict[int, GpsFix], Array]:
    """Return the fixes by step, and the bias (k, 3) of each."""
    steps = np.arange(GPS_STEPS, time_s.size, GPS_STEPS)
    pos_m, vel_m_s, _, _ = _kinematics(path, time_s[steps] - GPS_DELAY_S)
    decay = np.exp(-GPS_STEPS * STEP_S / noise.gps_bias_time_s)
    bias_m = np.zeros((steps.size, 3))
    bias_m[0] = noise.gps_bias_m * rng.standard_normal(3)
    for k in range(1, steps.size):
        bias_m[k] = decay * bias_m[k - 1] + noise.gps_bias_m * np.sqrt(1 - decay**2) * rng.standard_normal(3)
    measured_m = pos_m + bias_m + noise.gps_pos_m * rng.standard_normal(bias_m.shape)
    vel_std_m_s = noise.gps_vel_m_s * np.array([1.0, 1.0, noise.gps_vel_down_ratio])
    measured_m_s = vel_m_s + vel_std_m_s * rng.standard_normal(bias_m.shape)
    lat_deg, lon_deg, alt_m = ned_to_geodetic(
        measured_m,
        origin_lat_deg=SITE.latitude_deg,
        origin_lon_deg=SITE.longitude_deg,
        origin_alt_m=SITE.altitude_m,
    )
    fixes = {
        int(step): GpsFix(
            time_us=round(time_s[step] * 1e6), fix_type=3, lat_deg=float(lat_deg[k]),
            lon_deg=float(lon_deg[k]), alt_m=float(alt_m[k]), vel_ned_m_s=measured_m_s[k],
            eph_m=noise.gps_eph_m, epv_m=2.5, satellites=10,
        )
        for k, step in enumerate(steps)
    }  # fmt: skip
    return fixes, bias_m


def simulate(
    path: Path, duration_s: float, rng: np.random.Generator, noise: Noise | None = None
) -> SimulatedFlight:
    """Simulate sensors on a path: IMU 250 Hz, magnetometer and barometer 25 Hz, GPS 5 Hz, 0.12 s late."""
    noise = noise or Noise()
    steps = round(duration_s / STEP_S)
    time_s = STEP_S * np.arange(1.0, steps + 1.0)
    pos_m, vel_m_s, _, rotations = _kinematics(path, time_s)
    *_, before = _kinematics(path, time_s - STEP_S)
    gyro_rad_s = (before.inv() * rotations).as_rotvec() / STEP_S
    accel_m_s2 = np.zeros((steps, 3))
    for node in (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)):  # Gauss's mean over the interval
        _, _, acc_m_s2, inside = _kinematics(path, time_s - node * STEP_S)
        accel_m_s2 += 0.5 * inside.inv().apply(acc_m_s2 - [0.0, 0.0, atmosphere.GRAVITY_M_S2])
    fixes, gps_bias_m = _fixes(path, time_s, rng, noise)
    gyro_bias_rad_s = _walk(rng, noise.gyro_bias_rad_s, noise.gyro_bias_walk_rad_s, steps)
    accel_bias_m_s2 = _walk(rng, noise.accel_bias_m_s2, noise.accel_bias_walk_m_s2, steps)
    pressure_pa = atmosphere.pressure_pa(SITE.altitude_m - pos_m[:, 2])
    return SimulatedFlight(
        time_us=np.round(time_s * 1e6).astype(np.int64),
        pos_ned_m=pos_m,
        vel_ned_m_s=vel_m_s,
        rotations_ned_frd=rotations,
        gyro_rad_s=gyro_rad_s + gyro_bias_rad_s + noise.gyro_rad_s * rng.standard_normal((steps, 3)),
        accel_m_s2=accel_m_s2 + accel_bias_m_s2 + noise.accel_m_s2 * rng.standard_normal((steps, 3)),
        field_gauss=rotations.inv().apply(FIELD_NED_GAUSS)
        + noise.mag_gauss * rng.standard_normal((steps, 3)),
        pressure_pa=pressure_pa + noise.baro_pa * rng.standard_normal(steps),
        fixes=fixes,
        gps_bias_ned_m=gps_bias_m[np.clip((np.arange(steps) - GPS_STEPS) // GPS_STEPS, 0, None)],
        gyro_bias_rad_s=gyro_bias_rad_s,
        accel_bias_m_s2=accel_bias_m_s2,
    )


def feed(estimator: Estimator, flight: SimulatedFlight, on_step: Callable[[int, Estimator], None]) -> None:
    """Feed a flight's samples to an estimator and call ``on_step`` after each step."""
    for k, time_us in enumerate(flight.time_us.tolist()):
        if k in flight.fixes:
            estimator.on_gps(flight.fixes[k])
        if k % SLOW_STEPS == 0:
            estimator.on_baro(time_us, flight.pressure_pa[k] * 0.01, 15.0)
            estimator.on_mag(time_us, flight.field_gauss[k])
        estimator.on_imu(
            ImuSample(
                time_us=time_us, accel_frd_m_s2=flight.accel_m_s2[k], gyro_frd_rad_s=flight.gyro_rad_s[k]
            )
        )
        on_step(k, estimator)


def replay(
    estimator: Estimator, flight: SimulatedFlight, *, on_step: Callable[[int, Estimator], None] | None = None
) -> list[EstimatorState]:
    """Feed a flight to an estimator and return its state after every step."""
    states = []

    def keep(k: int, estimator: Estimator) -> None:
        states.append(estimator.state)
        if on_step is not None:
            on_step(k, estimator)

    feed(estimator, flight, keep)
    return states


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Estimate less truth, (n, 3) each."""

    attitude_ned_rad: Array
    vel_m_s: Array
    pos_m: Array
    """Relative to the start; the estimator's origin is displaced from it by the error of the first fixes"""


def errors(flight: SimulatedFlight, states: list[EstimatorState]) -> Errors:
    """Return the errors of a replay's states."""
    estimated = Rotation.from_quat(np.array([state.q_ned_frd for state in states]), scalar_first=True)
    return Errors(
        attitude_ned_rad=(estimated * flight.rotations_ned_frd.inv()).as_rotvec(),
        vel_m_s=np.array([state.vel_ned_m_s for state in states]) - flight.vel_ned_m_s,
        pos_m=np.array([state.pos_ned_m for state in states]) - flight.pos_ned_m,
    )
