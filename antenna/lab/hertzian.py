"""Closed-form directivity of Hertzian dipoles with given currents, exact for short dipoles.

Over perfect ground images are added, which account for half of the power.
"""

import numpy as np
from scipy.special import spherical_jn

from antenna.analysis.patterns import Pattern, directions_deg, make_pattern
from antenna.model.geometry import Array, Complex, Snapshot


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


def mean_intensity(places_m: Array, axes: Array, currents: Complex, k_rad_m: float) -> float:
    """Return the mean intensity over the sphere, in squared current, of dipoles (N, 3) with axes (N, 3).

    The intensity in a direction r is |sum_n I_n (u_n - (u_n.r) r) exp(j k r.p_n)|^2. Its mean follows from
    mean(exp(j x.r)) = j0(x) and, by the second derivatives of that,
    mean(r_i r_j exp(j x.r)) = delta_ij j1(x)/x - x_i x_j / x^2 j2(x).
    """
    apart_m = places_m[:, None] - places_m
    distance_m = np.linalg.norm(apart_m, axis=-1)
    x = np.maximum(k_rad_m * distance_m, 1e-6)  # j1(x)/x is 1/3 there to 1e-13, without a division by 0
    towards = apart_m / np.maximum(distance_m, 1e-12)[..., None]
    along = np.einsum("mi,mni->mn", axes, towards) * np.einsum("ni,mni->mn", axes, towards)
    level = axes @ axes.T
    # mean of u.v - (u.r)(v.r): the identity less the second moment
    coupling = level * (spherical_jn(0, x) - spherical_jn(1, x) / x) + along * spherical_jn(2, x)
    return float((currents.conj() @ coupling @ currents).real)
