"""Total gain of path loss, antennas and shadowing from many positions to many, as arrays.

Gains are relative to isotropic antennas in free space at the reference distance of `netsim.phy.path_loss`.
"""

import numpy as np

from netsim.model.config import RadioConfig
from netsim.model.random_streams import RandomStreams
from netsim.phy.antenna import direct_coupling, reflected_coupling, unpolarised_source_coupling
from netsim.phy.path_loss import (
    REFERENCE_DISTANCE_M,
    Complexes,
    Doubles,
    GroundRay,
    ground_permittivity,
    ground_ray,
    reflection,
    two_ray_gain,
)
from netsim.phy.shadowing import Shadowing

ALL = slice(None)
"""Selects all stations as sources."""


class PathGain:
    """The built-in propagation models, as selected by the settings."""

    def __init__(self, config: RadioConfig, streams: RandomStreams) -> None:
        self._frequency_mhz = config.frequency_mhz
        self._bandwidth_mhz = config.bandwidth_mhz
        self._two_ray = config.path_loss == "two_ray"
        self._exponent = 2.0 if config.path_loss == "friis" else config.path_loss_exponent
        """Exponent of the power law, if that is the path loss."""
        self.uses_attitudes = config.antenna == "dipole"
        """See `netsim.phy.interfaces.Propagation`."""
        self._permittivity = ground_permittivity(config.frequency_mhz)
        self._shadowing: Shadowing | None = None
        if config.shadowing_std_db > 0.0:
            self._shadowing = Shadowing(config.shadowing_std_db, config.shadowing_distance_m, streams)

    @property
    def power_law_exponent(self) -> float | None:
        """See `netsim.phy.interfaces.Propagation`."""
        plain = not (self._two_ray or self.uses_attitudes or self._shadowing is not None)
        return self._exponent if plain else None

    def between_stations(
        self, sources: slice, pos_ned_m: Doubles, axes_ned: Doubles | None
    ) -> tuple[Doubles, Doubles]:
        """See `netsim.phy.interfaces.Propagation`; without ``axes_ned`` antennas are isotropic."""
        from_ned_m = pos_ned_m if sources == ALL else pos_ned_m[sources]
        away_m = pos_ned_m - from_ned_m[:, None]
        distances_m = np.sqrt(np.einsum("ijk,ijk->ij", away_m, away_m))
        field: Doubles | float = 1.0
        beside: Doubles | float = 0.0
        if axes_ned is not None:
            directions = away_m / np.maximum(distances_m, 1e-9)[..., None]
            field, beside = direct_coupling(directions, axes_ned[sources], axes_ned)
        if not self._two_ray:
            gains = (field * field + beside) * self._power_law(distances_m)
            return self._shadowed(gains, from_ned_m, pos_ned_m, distances_m), distances_m
        ray = ground_ray(from_ned_m, pos_ned_m, distances_m)
        vertical, horizontal = reflection(self._permittivity, ray)
        if axes_ned is None:
            gains = self._two_rays(distances_m, ray, field, vertical)
        else:
            vertical_field, horizontal_field, reflected_beside = reflected_coupling(
                ray, axes_ned[sources], axes_ned
            )
            polarised = vertical * vertical_field + horizontal * horizontal_field
            # the unpolarised parts are incoherent: powers add
            kept = 0.5 * (np.abs(vertical) ** 2 + np.abs(horizontal) ** 2)
            beside = beside / np.maximum(distances_m, REFERENCE_DISTANCE_M) ** 2
            beside += reflected_beside * kept / np.maximum(ray.distance_m, REFERENCE_DISTANCE_M) ** 2
            gains = self._two_rays(distances_m, ray, field, polarised) + beside
        return self._shadowed(gains, from_ned_m, pos_ned_m, distances_m), distances_m

    def from_others(
        self, from_ned_m: Doubles, to_ned_m: Doubles, to_axes_ned: Doubles | None
    ) -> tuple[Doubles, Doubles]:
        """See `netsim.phy.interfaces.Propagation`; the sources' antennas are unknown."""
        away_m = to_ned_m - from_ned_m[:, None]
        distances_m = np.sqrt(np.einsum("ijk,ijk->ij", away_m, away_m))
        if self._two_ray:
            ray = ground_ray(from_ned_m, to_ned_m, distances_m)
            gains = self._two_rays(distances_m, ray, 1.0, reflection(self._permittivity, ray)[0])
        else:
            gains = self._power_law(distances_m)
        if to_axes_ned is not None:
            directions = away_m / np.maximum(distances_m, 1e-9)[..., None]
            gains = gains * unpolarised_source_coupling(directions, to_axes_ned)
        return self._shadowed(gains, from_ned_m, to_ned_m, distances_m), distances_m

    def _power_law(self, distances_m: Doubles) -> Doubles:
        return np.asarray(np.maximum(distances_m, REFERENCE_DISTANCE_M) ** -self._exponent)

    def _two_rays(
        self, distances_m: Doubles, ray: GroundRay, direct: Doubles | float, reflected: Complexes
    ) -> Doubles:
        return two_ray_gain(distances_m, ray, direct, reflected, self._frequency_mhz, self._bandwidth_mhz)

    def _shadowed(
        self, gains: Doubles, from_ned_m: Doubles, to_ned_m: Doubles, distances_m: Doubles
    ) -> Doubles:
        if self._shadowing is None:
            return gains
        return gains * 10.0 ** (self._shadowing.between_db(from_ned_m, to_ned_m, distances_m) / 10.0)
