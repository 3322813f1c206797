"""Ultra-wideband tag: ranges to anchors at fixed places and to other vehicles' tags, for the application.

A range is the distance of the antennas plus a constant error of the pair and white noise. Where a box of the
scenario is between them, an exponentially distributed excess is added, since the first path that is detected
is a detour, and more ranges are missing. Every sample draws the same number of random values.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from foundation.geometry.rotations import quat_rotate
from foundation.types import Array
from harness.world.interfaces import WorldContext, WorldInputs
from harness.world.obstacles import Metres

Std = Annotated[float, Meta(ge=0.0, le=100.0)]
Probability = Annotated[float, Meta(ge=0.0, le=1.0)]
Offset = Annotated[float, Meta(ge=-10.0, le=10.0)]


class UwbTagSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a tag."""

    anchors_ned_m: tuple[tuple[Metres, Metres, Metres], ...] = ()
    """Positions of the anchors, from the site's origin."""
    vehicles: bool = False
    """Whether it also measures the ranges to all other vehicles, whose antennas are at their centres of
    mass."""
    position_frd_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """Of the antenna, from the centre of mass."""
    max_m: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 100.0
    """Greatest distance."""
    noise_std_m: Std = 0.1
    """Standard deviation of the white noise of a range."""
    bias_std_m: Std = 0.05
    """Standard deviation of the constant error of a pair, drawn once."""
    loss_fraction: Probability = 0.02
    """Fraction of the ranges that are missing."""
    obstructed_excess_m: Std = 0.5
    """Mean of the excess of an obstructed range."""
    obstructed_loss_fraction: Probability = 0.3
    """Fraction of the obstructed ranges that are missing."""
    rate_hz: Annotated[float, Meta(ge=0.1, le=250.0)] = 10.0
    """Samples per second, of all ranges at once."""
    delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.02
    """Age of a sample when it arrives."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if not self.anchors_ned_m and not self.vehicles:
            raise ValueError("anchors_ned_m: expected anchors, or vehicles = true")


class UwbTag:
    """See `harness.world.interfaces.Sensor`; columns are ``anchor_0_m`` and so on, then ``uav_1_m``."""

    Settings = UwbTagSettings

    def __init__(self, context: WorldContext, settings: UwbTagSettings) -> None:
        self._context, self._settings = context, settings
        self._anchors_ned_m = np.array(settings.anchors_ned_m, float).reshape(-1, 3)
        others = [i for i in range(context.vehicles) if settings.vehicles and i != context.uav]
        self._others = np.array(others, dtype=np.intp)
        self._position_frd_m = np.array(settings.position_frd_m)
        self.columns = [f"anchor_{i}_m" for i in range(len(self._anchors_ned_m))]
        self.columns += [f"uav_{i}_m" for i in others]
        self._bias_m = settings.bias_std_m * context.rng.standard_normal(len(self.columns))
        self.period_us, self.delay_us = round(1e6 / settings.rate_hz), round(1e6 * settings.delay_s)

    def sample(self, inputs: WorldInputs) -> list[float | None]:
        """Return the ranges in metres, None for those that are missing."""
        settings, rng, count = self._settings, self._context.rng, len(self.columns)
        white, excess, chance = rng.standard_normal(count), rng.standard_exponential(count), rng.random(count)
        own_ned_m = inputs.pos_ned_m + quat_rotate(inputs.q_ned_frd, self._position_frd_m)
        peers_ned_m: Array = np.concatenate((self._anchors_ned_m, inputs.all_pos_ned_m[self._others]))
        distances_m = np.linalg.norm(peers_ned_m - own_ned_m, axis=1)
        obstructed = np.array([self._context.obstacles.is_between(own_ned_m, peer) for peer in peers_ned_m])
        ranges_m = distances_m + self._bias_m + settings.noise_std_m * white
        ranges_m += obstructed * settings.obstructed_excess_m * excess
        lost = chance < np.where(obstructed, settings.obstructed_loss_fraction, settings.loss_fraction)
        silent = np.concatenate((np.zeros(len(self._anchors_ned_m), bool), ~inputs.alive[self._others]))
        missing = lost | silent | (distances_m > settings.max_m)
        return [
            None if is_missing else max(range_m, 0.0)
            for range_m, is_missing in zip(ranges_m.tolist(), missing.tolist(), strict=True)
        ]
