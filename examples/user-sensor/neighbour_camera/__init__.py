"""A camera along the nose: azimuth and elevation of the nearest UAV in its field of view."""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from coflight import WorldContext, WorldInputs
from foundation.geometry.rotations import quat_rotate_inverse


class CameraSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``settings`` of ``[[sensors.extra]]``."""

    field_of_view_deg: Annotated[float, Meta(gt=0.0, lt=180.0)] = 90.0
    """Full angle of the cone that it sees."""
    max_m: Annotated[float, Meta(gt=0.0)] = 30.0
    """Distance from which on UAVs are too small."""
    noise_std_rad: Annotated[float, Meta(ge=0.0)] = 0.005
    rate_hz: Annotated[float, Meta(ge=1.0, le=50.0)] = 10.0
    delay_s: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.05


class NeighbourCamera:
    """See `coflight.Sensor`."""

    Settings = CameraSettings
    columns = ("uav", "azimuth_rad", "elevation_rad")

    def __init__(self, context: WorldContext, settings: CameraSettings) -> None:
        self._context, self._settings = context, settings
        self._least_cos = math.cos(math.radians(settings.field_of_view_deg) / 2.0)
        self.period_us, self.delay_us = round(1e6 / settings.rate_hz), round(1e6 * settings.delay_s)

    def sample(self, inputs: WorldInputs) -> tuple[float, float, float] | None:
        """Return the number of the UAV and its direction; azimuth to the right, elevation upwards."""
        noise_rad = self._settings.noise_std_rad * self._context.rng.standard_normal(2)
        nearest, nearest_m = None, self._settings.max_m
        for uav, pos_ned_m in enumerate(inputs.all_pos_ned_m):
            distance_m = float(np.linalg.norm(pos_ned_m - inputs.pos_ned_m))
            if uav == self._context.uav or not inputs.alive[uav] or not 0.0 < distance_m < nearest_m:
                continue
            if self._context.obstacles.is_between(inputs.pos_ned_m, pos_ned_m):
                continue
            towards_frd = quat_rotate_inverse(inputs.q_ned_frd, pos_ned_m - inputs.pos_ned_m) / distance_m
            if towards_frd[0] >= self._least_cos:
                nearest, nearest_m, (forward, right, down) = uav, distance_m, towards_frd
        if nearest is None:
            return None
        azimuth_rad = math.atan2(right, forward) + noise_rad[0]
        return float(nearest), azimuth_rad, math.asin(-down) + noise_rad[1]
