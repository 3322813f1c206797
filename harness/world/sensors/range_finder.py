"""Range finder along a body axis: DISTANCE_SENSOR to the autopilot.

The received power of a diffuse (Lambertian) surface that is larger than the beam is proportional to
cos(incidence) / distance^2; ``max_m`` is the distance at which it is just sufficient at normal
incidence. So the range is max_m sqrt(cos(incidence)), and the quality is 1 minus the ratio of sufficient to
received power. Rays meet the ground and the scenario's boxes, not other vehicles.
"""

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from foundation.geometry.rotations import quat_rotate
from harness.world.interfaces import Reading, WorldContext, WorldInputs

Direction = Literal["down", "up", "forward", "backward", "left", "right"]
Offset = Annotated[float, Meta(ge=-10.0, le=10.0)]
AXES = {
    "down": ((0.0, 0.0, 1.0), common.MAV_SENSOR_ROTATION_PITCH_270),
    "up": ((0.0, 0.0, -1.0), common.MAV_SENSOR_ROTATION_PITCH_90),
    "forward": ((1.0, 0.0, 0.0), common.MAV_SENSOR_ROTATION_NONE),
    "backward": ((-1.0, 0.0, 0.0), common.MAV_SENSOR_ROTATION_PITCH_180),
    "left": ((0.0, -1.0, 0.0), common.MAV_SENSOR_ROTATION_YAW_270),
    "right": ((0.0, 1.0, 0.0), common.MAV_SENSOR_ROTATION_YAW_90),
}
"""Axis in FRD and MAVLink's orientation, which PX4 takes as the same direction."""
INVALID, FULL = 1, 100
"""MAVLink's signal quality; 0 would be an unknown one."""
UNKNOWN_VARIANCE = 255
MOST_DISTANCE_M = 655.0
"""Capacity of the message's field."""
_CM_PER_M = 100.0


class RangeFinderSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a range finder; the defaults are those of a small laser."""

    direction: Direction = "down"
    """Axis of the body along which it measures."""
    position_frd_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """Of the sensor, from the centre of mass."""
    min_m: Annotated[float, Meta(ge=0.0, le=600.0)] = 0.1
    """Shortest distance."""
    max_m: Annotated[float, Meta(gt=0.0, le=600.0)] = 40.0
    """Longest distance at normal incidence."""
    noise_std_m: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.02
    """Standard deviation of the white noise."""
    noise_fraction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.002
    """Standard deviation of more white noise, as a fraction of the distance."""
    rate_hz: Annotated[float, Meta(ge=0.1, le=250.0)] = 20.0
    """Readings per second."""
    delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01
    """Age of a reading when it arrives."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.min_m >= self.max_m:
            raise ValueError("min_m: expected a distance below max_m")


class RangeFinder:
    """See `harness.world.interfaces.AutopilotSensor`."""

    Settings = RangeFinderSettings
    columns = ("distance_m", "quality_fraction")

    def __init__(self, context: WorldContext, settings: RangeFinderSettings) -> None:
        self._context, self._settings = context, settings
        self._axis_frd, self._orientation = np.array(AXES[settings.direction][0]), AXES[settings.direction][1]
        self._position_frd_m = np.array(settings.position_frd_m)
        self.period_us, self.delay_us = round(1e6 / settings.rate_hz), round(1e6 * settings.delay_s)

    def sample(self, inputs: WorldInputs) -> tuple[float | None, float]:
        """Return distance and quality; without a return they are None and 0."""
        settings, white = self._settings, float(self._context.rng.standard_normal())
        hit = self._context.obstacles.ray(
            inputs.pos_ned_m + quat_rotate(inputs.q_ned_frd, self._position_frd_m),
            quat_rotate(inputs.q_ned_frd, self._axis_frd),
        )
        if hit.distance_m >= settings.max_m * math.sqrt(hit.incidence_cos):
            return None, 0.0
        measured_m = hit.distance_m + self._std_m(hit.distance_m) * white
        if not settings.min_m <= measured_m <= settings.max_m:
            return None, 0.0
        return measured_m, 1.0 - (hit.distance_m / settings.max_m) ** 2 / hit.incidence_cos

    def message(self, reading: Reading) -> Message:
        """Return DISTANCE_SENSOR; without a return the distance is 1 cm more than the greatest valid one.

        A PX4 uses a reading only if its distance is within the limits and its quality is not 0.
        """
        settings, (distance_m, quality) = self._settings, reading.values
        greatest_cm = round(_CM_PER_M * settings.max_m)
        distance_cm, variance_cm2, quality_percent = greatest_cm + 1, UNKNOWN_VARIANCE, INVALID
        if not math.isnan(distance_m + quality):
            # limits: a fault may have changed the values
            distance_cm = round(_CM_PER_M * min(max(distance_m, 0.0), MOST_DISTANCE_M))
            variance_cm2 = math.ceil((_CM_PER_M * self._std_m(distance_m)) ** 2)
            quality_percent = INVALID + round((FULL - INVALID) * min(max(quality, 0.0), 1.0))
        return common.MAVLink_distance_sensor_message(
            reading.measured_us // 1_000,
            round(_CM_PER_M * settings.min_m),
            greatest_cm,
            distance_cm,
            common.MAV_DISTANCE_SENSOR_LASER,
            self._context.number,
            self._orientation,
            min(variance_cm2, UNKNOWN_VARIANCE),
            signal_quality=quality_percent,
        )

    def _std_m(self, distance_m: float) -> float:
        return math.hypot(self._settings.noise_std_m, self._settings.noise_fraction * distance_m)
