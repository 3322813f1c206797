"""Wind as a velocity of the air: a mean, optionally increasing with height, and turbulence."""

import math

import numpy as np

from foundation.types import Array
from harness.world.wind.config import WindConfig, direction_ned
from harness.world.wind.turbulence import FOOT_M, Turbulence, low_altitude_scales


class MovingAir:
    """Mean velocity plus turbulence with the strengths and lengths of one height.

    A vehicle's turbulence is ``sqrt(c)`` times a common series plus ``sqrt(1 - c)`` times its own, with
    correlation c: each has the full spectrum, and any two have the same coherence at every frequency and
    distance. Real coherence decreases with both, which is not modelled. The mean wind carries the pattern
    past the vehicles regardless of their own motion, which is correct for hovering vehicles. The height is
    ``formation_height_m`` unless the scenario sets another.
    """

    def __init__(
        self, config: WindConfig, vehicles: int, rng: np.random.Generator, *, formation_height_m: float
    ) -> None:
        self._model = model = config.velocity_model(formation_height_m)
        self._towards_ned = direction_ned(config.direction_deg, config.vertical_fraction)
        self._turbulence: Turbulence | None = None
        if model.turbulence != "none":
            heights_m = np.array((20.0 * FOOT_M, model.turbulence_height_m))
            wind_20ft_m_s, passing_speed_m_s = model.mean_speed_m_s(heights_m).tolist()
            if model.wind_20ft_m_s is not None:
                wind_20ft_m_s = model.wind_20ft_m_s
            self._turbulence = Turbulence(
                model.turbulence,
                low_altitude_scales(wind_20ft_m_s, model.turbulence_height_m),
                passing_speed_m_s=max(passing_speed_m_s, model.least_passing_speed_m_s),
                series=1 + vehicles,
                rng=rng,
            )
        direction_rad = math.radians(config.direction_deg)
        c, s = math.cos(direction_rad), math.sin(direction_rad)
        self._ned_from_axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self._weights = math.sqrt(model.correlation), math.sqrt(1.0 - model.correlation)

    def step(self, dt_s: float, height_m: Array) -> Array:
        """Return velocities (n, 3), m/s, NED, at heights (n,) above ground, ``dt_s`` after the last call."""
        air_vel_ned_m_s: Array = self._model.mean_speed_m_s(height_m)[:, None] * self._towards_ned
        if self._turbulence is not None:
            series_m_s = self._turbulence.step(dt_s)
            shared, own = self._weights
            air_vel_ned_m_s += (shared * series_m_s[:1] + own * series_m_s[1:]) @ self._ned_from_axes.T
        return air_vel_ned_m_s
