"""Position hold in wind: position error about the setpoint and estimation error.

The conditions are those of the measurement of a real PX4, and those of the article's scenario.
"""

import math
from typing import Literal

import numpy as np
from msgspec import Struct

from foundation.airframe.files import DEFAULT, load
from foundation.types import Array
from harness.world.sensors.config import GpsOverrides, SensorsConfig
from harness.world.wind import WindConfig
from studies.vehicle.solo import PLAIN, Solo, Track, solo_config

HEIGHT_M = 5.0
SETTLE_S = 12.0
"""From the switch to offboard to the start of the measurement."""
MEASURE_S = 60.0
TRACE_EVERY = 25
"""Steps between the samples of a result's trace: 10 Hz."""

PX4_ESTIMATOR = {
    "EKF2_ACC_NOISE": 0.35,
    "EKF2_GYR_NOISE": 0.015,
    "EKF2_ACC_B_NOISE": 0.003,
    "EKF2_GYR_B_NOISE": 0.001,
    "EKF2_GPS_V_NOISE": 0.3,
    "EKF2_GPS_P_NOISE": 0.5,
    "EKF2_BARO_NOISE": 3.5,
    "EKF2_MAG_NOISE": 0.05,
}
"""PX4's default noises, larger than this autopilot's; they make the estimate as noisy as PX4's. Those of
accelerometer, GPS velocity, barometer and compass are from a recent PX4 source, not from v1.17."""

WITHOUT_OBSERVER = {"CF_DOB_EN": 0.0}
"""Turns the disturbance observer off: PX4's default cascade and gains."""

Sensors = Literal["table", "gazebo", "consumer"]
SENSORS: dict[Sensors, SensorsConfig] = {
    "table": SensorsConfig(profile="gazebo", gps=GpsOverrides(rate_hz=10.0, delay_s=0.008)),
    "gazebo": SensorsConfig(profile="gazebo"),
    "consumer": SensorsConfig(profile="consumer"),
}
"""``table``: as in the PX4 measurement: Gazebo's noise, near-perfect GPS at 10 Hz, 10 ms old (two steps)."""


class Hover(Struct, frozen=True, kw_only=True):
    """Conditions of one flight."""

    seed: int
    mean_n: float
    gust_rms_n: float
    """Per horizontal axis, vertical 0.3 of it; time constant 2 s"""
    imu_noise: float = 1.0
    """Scale of the inertial sensor's errors"""
    plant: Literal["plain", "iris"] = "iris"
    sensors: Sensors = "table"
    observer: bool = True
    px4_estimator: bool = False
    measure_s: float = MEASURE_S
    airframe: str = DEFAULT
    """Name of a packaged airframe"""
    stopped_motor: int | None = None
    """Motor that stops when the measurement begins"""


class HoverResult(Struct, frozen=True, kw_only=True):
    """Root mean squares of one flight, metres and degrees."""

    axes_m: tuple[float, float, float]
    """About the setpoint: north, east, down"""
    total_m: float
    """About the setpoint, as a vector"""
    controlled_m: float
    """Estimated position about the setpoint, as a vector: the error of the controller"""
    estimate_m: float
    """Estimated about true position, as a vector"""
    attitude_deg: float
    """Angle between estimated and true attitude"""
    tilt_deg: float
    """Angle between estimated and true vertical"""
    trace_m: tuple[float, ...] = ()
    """Distance from the setpoint over time, every `TRACE_EVERY` steps"""


def fly_hover(hover: Hover) -> HoverResult:
    """Take off, hold offboard at 5 m, and measure for `Hover.measure_s` after `SETTLE_S`."""
    return measure(track_hover(hover))


def track_hover(hover: Hover) -> Track:
    """Fly and return the measured part of the flight."""
    sensors = SENSORS[hover.sensors]
    config = solo_config(
        params=(PX4_ESTIMATOR if hover.px4_estimator else {}) | ({} if hover.observer else WITHOUT_OBSERVER),
        seed=hover.seed,
        gps_delay_s=sensors.gps_model().delay_s,
        airframe=load(hover.airframe),
    )
    wind = WindConfig(
        mean_n=hover.mean_n, gust_rms_fraction=hover.gust_rms_n / hover.mean_n if hover.mean_n > 0.0 else 0.0
    )
    with Solo(
        config,
        plant=PLAIN if hover.plant == "plain" else None,
        sensors=sensors,
        wind=wind,
        seed=np.random.SeedSequence([hover.seed, 1]),
        imu_noise=hover.imu_noise,
    ) as solo:
        solo.take_off(HEIGHT_M)
        solo.set_position(0.0, 0.0, -HEIGHT_M)
        solo.offboard()
        solo.run(SETTLE_S)
        start_s = solo.now_s
        if hover.stopped_motor is not None:
            solo.rotors_stopped[0, hover.stopped_motor] = True
        solo.run(hover.measure_s)
        return solo.track.after(start_s)


def measure(track: Track) -> HoverResult:
    """Return root mean squares about the setpoint, `HEIGHT_M` above the start."""
    setpoint_ned_m = np.array((0.0, 0.0, -HEIGHT_M))
    error = track.pos_ned_m - setpoint_ned_m
    north, east, down = np.sqrt((error**2).mean(axis=0)).tolist()
    distance = np.sqrt((error**2).sum(axis=1))
    return HoverResult(
        axes_m=(north, east, down),
        total_m=vector_rms(error),
        controlled_m=vector_rms(track.own_pos_ned_m - setpoint_ned_m),
        estimate_m=vector_rms(track.estimated_pos_ned_m - track.pos_ned_m),
        attitude_deg=math.degrees(vector_rms(track.attitude_error_rad[:, None])),
        tilt_deg=math.degrees(vector_rms(track.tilt_error_rad[:, None])),
        trace_m=tuple(distance[::TRACE_EVERY].tolist()),
    )


def vector_rms(vectors: Array) -> float:
    """Return the root mean square length of (T, k) vectors."""
    return math.sqrt(float((vectors**2).sum(axis=1).mean()))
