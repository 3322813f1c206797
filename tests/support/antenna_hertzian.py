"""Exact far field of Hertzian dipoles with given currents: a reference without common code with the solvers.

A Hertzian dipole's field in direction r is proportional to its moment's part across r, so the intensity is
|sum_n I_n (u_n - (u_n.r) r) exp(j k r.p_n)|^2. Its mean over the sphere has a closed form: by
mean(exp(j x.r)) = j0(x) and mean(r_i r_j exp(j x.r)) = delta_ij j1(x)/x - x_i x_j/x^2 j2(x).
"""

import numpy as np
from scipy.special import spherical_jn

from antenna.analysis.patterns import directions_deg, make_pattern
from antenna.model.geometry import Array, Snapshot


def gain_dbi(snapshot: Snapshot, wavelength_m: float, theta_deg: Array, phi_deg: Array) -> Array:
    """Return the directivity in the directions of two broadcastable arrays of angles."""
    theta_gain, phi_gain = partial_gains(snapshot, wavelength_m, theta_deg, phi_deg)
    return 10.0 * np.log10(np.maximum(theta_gain + phi_gain, 1e-30))


def partial_gains(
    snapshot: Snapshot, wavelength_m: float, theta_deg: Array, phi_deg: Array
) -> tuple[Array, Array]:
    """Return the linear directivity in the theta and phi polarisations."""
    theta, phi = np.broadcast_arrays(np.radians(theta_deg), np.radians(phi_deg))
    r = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    theta_hat = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)], axis=-1)
    phi_hat = np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=-1)
    phases = np.exp(2j * np.pi / wavelength_m * (r @ snapshot.centres_m.T)) * snapshot.voltages
    moment = phases @ snapshot.axes
    mean = mean_intensity(snapshot, wavelength_m)
    along = (np.einsum("...i,...i->...", moment, hat) for hat in (theta_hat, phi_hat))
    theta_gain, phi_gain = (np.abs(part) ** 2 / mean for part in along)
    return theta_gain, phi_gain


def mean_intensity(snapshot: Snapshot, wavelength_m: float) -> float:
    p, u, currents = snapshot.centres_m, snapshot.axes, snapshot.voltages
    apart_m = p[:, np.newaxis] - p
    distance_m = np.linalg.norm(apart_m, axis=-1)
    x = np.maximum(2.0 * np.pi / wavelength_m * distance_m, 1e-6)
    towards = apart_m / np.maximum(distance_m, 1e-12)[..., np.newaxis]
    along = np.einsum("mi,mni->mn", u, towards) * np.einsum("ni,mni->mn", u, towards)
    coupling = (u @ u.T) * (spherical_jn(0, x) - spherical_jn(1, x) / x) + along * spherical_jn(2, x)
    return float((currents.conj() @ coupling @ currents).real)


def exact_patterns(snapshots, wavelength_m, step_deg=5.0):
    """Return the patterns of a backend without errors."""
    theta_deg, phi_deg = directions_deg(step_deg)
    return [
        make_pattern(
            *partial_gains(one, wavelength_m, theta_deg[:, np.newaxis], phi_deg),
            lambda theta, phi, one=one: gain_dbi(one, wavelength_m, theta, phi),
            one, wavelength_m, "exact",
        )
        for one in snapshots
    ]  # fmt: skip
