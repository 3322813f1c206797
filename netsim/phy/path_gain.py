"""Total gain of path loss, antennas and shadowing from many positions to many, as arrays.

A gain is a linear power ratio, relative to isotropic antennas in free space at the reference distance of
`netsim.phy.path_loss`. Transmit power, ``radio.antenna_gain_dbi`` at both ends, extra attenuation, blocked
lines of sight and fading are applied by `netsim.phy.propagation`.
"""

import numpy as np

from netsim.model.config import RadioConfig
from netsim.phy.antenna import (
    Dipole,
    direct_coupling,
    pattern_gain_db,
    reflected_coupling,
    unpolarised_source_coupling,
)
from netsim.phy.interfaces import AntennaPattern, PathLoss
from netsim.phy.mixed_antennas import MixedAntennas
from netsim.phy.models import RadioModels
from netsim.phy.path_loss import (
    REFERENCE_DISTANCE_M,
    Doubles,
    PowerLaw,
    TwoRay,
    friis_loss_db,
    ground_ray,
    reflection,
    two_ray_gain,
)

ALL = slice(None)
"""Selects all stations as sources."""


class PathGain:
    """Product of the models of path loss, antennas and shadowing."""

    def __init__(self, config: RadioConfig, models: RadioModels) -> None:
        self._loss = models.path_loss
        self._shadowing = models.shadowing
        self._dipole = isinstance(models.antenna, Dipole)
        self._pattern: AntennaPattern | None = None if isinstance(models.antenna, Dipole) else models.antenna
        self._mixed = MixedAntennas(models.antenna, models.own_antennas) if models.own_antennas else None
        self.uses_attitudes = (
            models.antenna is not None if self._mixed is None else self._mixed.any_directional
        )
        """Whether gains depend on attitudes; budgets are then computed again when an attitude changes."""
        self._reference_db = friis_loss_db(REFERENCE_DISTANCE_M, config.frequency_mhz)

    @property
    def power_law_exponent(self) -> float | None:
        """Exponent e if every gain is max(distance, 1 m)^-e: a kernel then replaces `between_stations`.

        None: `between_stations` is called.
        """
        plain = self._shadowing is None and not self.uses_attitudes
        return self._loss.exponent if plain and isinstance(self._loss, PowerLaw) else None

    def between_stations(
        self, sources: slice, pos_ned_m: Doubles, rotations: Doubles | None
    ) -> tuple[Doubles, Doubles]:
        """Return gains and distances in metres, both (m, n), from the m ``sources`` to all n stations.

        ``sources`` is `ALL` or a slice of station numbers; ``pos_ned_m`` (n, 3); ``rotations`` (n, 3, 3) from
        FRD to NED, None unless `uses_attitudes`. Entries of a station to itself have no meaning.
        """
        from_ned_m = pos_ned_m if sources == ALL else pos_ned_m[sources]
        away_m = pos_ned_m - from_ned_m[:, None]
        distances_m = np.sqrt(np.einsum("ijk,ijk->ij", away_m, away_m))
        if self._mixed is not None and rotations is not None:
            gains = self._between_mixed(self._mixed, sources, pos_ned_m, rotations, distances_m)
            return self._shadowed(gains, from_ned_m, pos_ned_m, distances_m), distances_m
        axes_ned: Doubles | None = None
        if self._dipole and rotations is not None:
            axes_ned = np.ascontiguousarray(rotations[:, :, 2])
        gains = self._coupled(sources, pos_ned_m, distances_m, axes_ned)
        if self._pattern is not None and rotations is not None:
            directions = _directions(away_m, distances_m)
            towards_db = pattern_gain_db(self._pattern, directions, rotations[sources])
            if sources == ALL:
                back_db = towards_db.T
            else:
                back_db = pattern_gain_db(self._pattern, -directions.swapaxes(0, 1), rotations).T
            gains = gains * 10.0 ** ((towards_db + back_db) / 10.0)
        return self._shadowed(gains, from_ned_m, pos_ned_m, distances_m), distances_m

    def _coupled(
        self, sources: slice, pos_ned_m: Doubles, distances_m: Doubles, axes_ned: Doubles | None
    ) -> Doubles:
        """Return the gains (m, n) of the path loss between isotropic antennas or dipoles.

        ``axes_ned`` (n, 3) are the dipoles' axes; None: isotropic.
        """
        from_ned_m = pos_ned_m if sources == ALL else pos_ned_m[sources]
        loss = self._loss
        if isinstance(loss, TwoRay):
            gains = _two_rays(loss, from_ned_m, pos_ned_m, distances_m, sources, axes_ned)
        else:
            gains = self._direct(loss, from_ned_m, pos_ned_m, distances_m)
            if axes_ned is not None:
                away_m = pos_ned_m - from_ned_m[:, None]
                directions = away_m / np.maximum(distances_m, 1e-9)[..., None]
                field, beside = direct_coupling(directions, axes_ned[sources], axes_ned)
                gains = (field * field + beside) * gains
        return gains

    def _between_mixed(
        self, mixed: MixedAntennas, sources: slice, pos_ned_m: Doubles, rotations: Doubles,
        distances_m: Doubles,
    ) -> Doubles:  # fmt: skip
        """Return the gains (m, n) of path loss and antennas that differ."""
        numbers = np.arange(len(pos_ned_m))
        directions = _directions(pos_ned_m - pos_ned_m[sources][:, None], distances_m)
        gains = self._coupled(sources, pos_ned_m, distances_m, None)
        gains = gains * mixed.gains(directions, rotations[sources], numbers[sources])
        gains = gains * mixed.gains(-directions.swapaxes(0, 1), rotations, numbers).T
        dipoles = mixed.dipoles(len(numbers))
        pairs = dipoles[sources][:, None] & dipoles
        if pairs.any():
            axes_ned = np.ascontiguousarray(rotations[:, :, 2])
            gains = np.where(pairs, self._coupled(sources, pos_ned_m, distances_m, axes_ned), gains)
        return gains

    def from_others(
        self, from_ned_m: Doubles, to_ned_m: Doubles, to_rotations: Doubles | None
    ) -> tuple[Doubles, Doubles]:
        """Return gains and distances in metres, both (m, n), from m interferers to n stations.

        ``from_ned_m`` (m, 3); ``to_ned_m`` and ``to_rotations`` as in `between_stations`. The sources'
        antennas are isotropic, of unknown polarisation.
        """
        away_m = to_ned_m - from_ned_m[:, None]
        distances_m = np.sqrt(np.einsum("ijk,ijk->ij", away_m, away_m))
        loss = self._loss
        if isinstance(loss, TwoRay):
            gains = _two_rays(loss, from_ned_m, to_ned_m, distances_m, ALL, None)
        else:
            gains = self._direct(loss, from_ned_m, to_ned_m, distances_m)
        if self._mixed is not None and to_rotations is not None:
            back = -_directions(away_m, distances_m).swapaxes(0, 1)
            gains = gains * self._mixed.gains(back, to_rotations, np.arange(len(to_ned_m))).T
        elif self._dipole and to_rotations is not None:
            directions = away_m / np.maximum(distances_m, 1e-9)[..., None]
            axes_ned = np.ascontiguousarray(to_rotations[:, :, 2])
            gains = gains * unpolarised_source_coupling(directions, axes_ned)
        elif self._pattern is not None and to_rotations is not None:
            back = -_directions(away_m, distances_m).swapaxes(0, 1)
            gains = gains * 10.0 ** (pattern_gain_db(self._pattern, back, to_rotations).T / 10.0)
        return self._shadowed(gains, from_ned_m, to_ned_m, distances_m), distances_m

    def _direct(
        self, loss: PathLoss | PowerLaw, from_ned_m: Doubles, to_ned_m: Doubles, distances_m: Doubles
    ) -> Doubles:
        """Return the gains (m, n) of a path loss."""
        limited_m = np.maximum(distances_m, REFERENCE_DISTANCE_M)
        if isinstance(loss, PowerLaw):
            return np.asarray(limited_m**-loss.exponent)
        losses_db = loss.loss_db(from_ned_m, to_ned_m, limited_m)
        return np.asarray(10.0 ** ((self._reference_db - losses_db) / 10.0))

    def _shadowed(
        self, gains: Doubles, from_ned_m: Doubles, to_ned_m: Doubles, distances_m: Doubles
    ) -> Doubles:
        if self._shadowing is None:
            return gains
        shadowing_db = self._shadowing.gain_db(from_ned_m, to_ned_m, distances_m)
        return np.asarray(gains * 10.0 ** (shadowing_db / 10.0))


def _directions(away_m: Doubles, distances_m: Doubles) -> Doubles:
    """Return unit vectors (m, n, 3) of displacements; north where there is none."""
    directions = away_m / np.maximum(distances_m, 1e-9)[..., None]
    directions[distances_m < 1e-9] = (1.0, 0.0, 0.0)
    return directions


def _two_rays(
    loss: TwoRay,
    from_ned_m: Doubles,
    to_ned_m: Doubles,
    distances_m: Doubles,
    sources: slice,
    axes_ned: Doubles | None,
) -> Doubles:
    """Return the gains (m, n) of direct and reflected rays between isotropic antennas or dipoles.

    ``axes_ned`` (n, 3) are the dipoles' axes, of which ``sources`` selects those of the m transmitters; None:
    isotropic.
    """
    ray = ground_ray(from_ned_m, to_ned_m, distances_m)
    vertical, horizontal = reflection(loss.permittivity, ray)
    if axes_ned is None:
        return two_ray_gain(distances_m, ray, 1.0, vertical, loss.frequency_mhz, loss.bandwidth_mhz)
    directions = (to_ned_m - from_ned_m[:, None]) / np.maximum(distances_m, 1e-9)[..., None]
    field, beside = direct_coupling(directions, axes_ned[sources], axes_ned)
    vertical_field, horizontal_field, reflected_beside = reflected_coupling(ray, axes_ned[sources], axes_ned)
    polarised = vertical * vertical_field + horizontal * horizontal_field
    # the unpolarised parts are incoherent: powers add
    kept = 0.5 * (np.abs(vertical) ** 2 + np.abs(horizontal) ** 2)
    beside = beside / np.maximum(distances_m, REFERENCE_DISTANCE_M) ** 2
    beside += reflected_beside * kept / np.maximum(ray.distance_m, REFERENCE_DISTANCE_M) ** 2
    gains = two_ray_gain(distances_m, ray, field, polarised, loss.frequency_mhz, loss.bandwidth_mhz)
    return np.asarray(gains + beside)
