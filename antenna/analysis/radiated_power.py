"""Radiated power of point currents in closed form.

The intensity in a direction r is |sum_n I_n (u_n - (u_n.r) r) exp(j k r.p_n)|^2. Its mean over the sphere
follows from mean(exp(j x.r)) = j0(x) and, by the second derivatives of that,
mean(r_i r_j exp(j x.r)) = delta_ij j1(x)/x - x_i x_j / x^2 j2(x).
"""

import numpy as np
from scipy.special import spherical_jn

from antenna.model.geometry import Array, Complex


def mean_intensity(places_m: Array, axes: Array, currents: Complex, k_rad_m: float) -> float:
    """Return the mean intensity over the sphere, in squared current, of dipoles (N, 3) with axes (N, 3)."""
    apart_m = places_m[:, None] - places_m
    distance_m = np.linalg.norm(apart_m, axis=-1)
    x = np.maximum(k_rad_m * distance_m, 1e-6)  # j1(x)/x is 1/3 there to 1e-13, without a division by 0
    towards = apart_m / np.maximum(distance_m, 1e-12)[..., None]
    along = np.einsum("mi,mni->mn", axes, towards) * np.einsum("ni,mni->mn", axes, towards)
    level = axes @ axes.T
    # mean of u.v - (u.r)(v.r): the identity less the second moment
    coupling = level * (spherical_jn(0, x) - spherical_jn(1, x) / x) + along * spherical_jn(2, x)
    return float((currents.conj() @ coupling @ currents).real)
