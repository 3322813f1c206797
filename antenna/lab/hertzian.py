"""Closed-form directivity of Hertzian dipoles with given currents, exact for short dipoles.

Over perfect ground images are added, which account for half of the power.
"""

import numpy as np

from antenna.analysis.patterns import Pattern, directions_deg, make_pattern
from antenna.analysis.radiated_power import mean_intensity
from antenna.model.geometry import Array, Snapshot


def hertzian_pattern(
    snapshot: Snapshot, wavelength_m: float, *, grid_deg: float, image: bool = False
) -> Pattern:
    """Return the pattern of dipoles along the elements' z, with currents proportional to the voltages."""
    places_m, axes, currents = snapshot.centres_m, snapshot.axes, snapshot.voltages
    if image:
        mirror = np.array([1.0, 1.0, -1.0])
        places_m = np.concatenate([places_m, places_m * mirror])
        axes, currents = np.concatenate([axes, -axes * mirror]), np.tile(currents, 2)
    k_rad_m = 2.0 * np.pi / wavelength_m
    radiated = mean_intensity(places_m, axes, currents, k_rad_m) * (0.5 if image else 1.0)

    def partial_gains(theta_deg: Array, phi_deg: Array) -> Array:
        theta, phi = np.radians(theta_deg), np.radians(phi_deg)
        x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
        phase = k_rad_m * np.stack([x, y, z], -1) @ places_m.T
        moment = (np.exp(1j * phase) * currents) @ axes
        along = moment[..., 0] * np.cos(phi) + moment[..., 1] * np.sin(phi)
        across = moment[..., 1] * np.cos(phi) - moment[..., 0] * np.sin(phi)
        fields = np.stack([along * np.cos(theta) - moment[..., 2] * np.sin(theta), across])
        return np.asarray(np.abs(fields) ** 2 / radiated)

    def gain_at(theta_deg: Array, phi_deg: Array) -> Array:
        return np.asarray(10.0 * np.log10(np.maximum(partial_gains(theta_deg, phi_deg).sum(axis=0), 1e-99)))

    theta_deg, phi_deg = np.meshgrid(*directions_deg(grid_deg), indexing="ij")
    gain_theta, gain_phi = partial_gains(theta_deg, phi_deg) * ((theta_deg <= 90.0 + 1e-9) | (not image))
    return make_pattern(gain_theta, gain_phi, gain_at, snapshot, wavelength_m, "hertzian", grounded=image)
