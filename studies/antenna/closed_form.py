"""Closed-form directivity along +y of arrays with given currents, and currents of the feeding policies.

With currents v it is |f v|^2 / (v^H C v): f (n,) are the phases exp(j k y) of the elements in direction +y,
and C (n, n), symmetric, is the mean over the sphere of the product of the fields of two elements. It is
sin(kd) / (kd) for isotropic elements (C. A. Balanis, Antenna Theory, 4th ed., chapter 6).
"""

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import spherical_jn

from antenna.lab.hertzian import mean_intensity
from antenna.model.excitation import end_fire, hansen_woodyard, optimum
from antenna.model.geometry import Array, Voltages

LEAST_STEP_RAD = 0.05
"""Step of the coarse search for the best lag."""


def isotropic_coupling(places_m: Array, wavelength_m: float) -> Array:
    """Return the matrix C (n, n) of isotropic elements."""
    distance_m = np.linalg.norm(places_m[:, None] - places_m, axis=-1)
    return np.asarray(spherical_jn(0, 2.0 * np.pi / wavelength_m * distance_m))


def hertzian_coupling(places_m: Array, wavelength_m: float) -> Array:
    """Return C (n, n) of upright Hertzian dipoles from their mean intensity q: (q(i + k) - q(i - k)) / 4."""
    n = len(places_m)
    axes, k_rad_m, one = np.tile([0.0, 0.0, 1.0], (n, 1)), 2.0 * np.pi / wavelength_m, np.eye(n)
    coupling = np.empty((n, n))
    for i in range(n):
        for k in range(n):
            together, against = (
                mean_intensity(places_m, axes, (one[i] + sign * one[k]).astype(complex), k_rad_m)
                for sign in (1.0, -1.0)
            )
            coupling[i, k] = (together - against) / 4.0
    return coupling


def directivity_dbi(voltages: Voltages, coupling: Array, places_m: Array, wavelength_m: float) -> float:
    """Return the directivity along +y of currents proportional to the voltages."""
    arriving = end_fire(places_m, wavelength_m).conj()
    power = float((voltages.conj() @ coupling @ voltages).real)
    return float(10.0 * np.log10(abs(arriving @ voltages) ** 2 / power))


def policy_voltages(policy: str, coupling: Array, places_m: Array, wavelength_m: float) -> Voltages:
    """Return the voltages (n,) of a policy, without mutual coupling of wires.

    Policies are ``end_fire``, ``hansen_woodyard``, ``best_step`` and ``optimum``; ``best_step`` has a uniform
    lag from row to row with the highest directivity along +y.
    """
    match policy:
        case "end_fire":
            return end_fire(places_m, wavelength_m)
        case "hansen_woodyard":
            return hansen_woodyard(places_m, wavelength_m)
        case "best_step":
            return _lagging(_best_lag_rad(coupling, places_m, wavelength_m), places_m, wavelength_m)
        case "optimum":
            return optimum(coupling, end_fire(places_m, wavelength_m).conj()[None])
    raise ValueError(f"no policy {policy!r}")


def _lagging(lag_rad: float, places_m: Array, wavelength_m: float) -> Voltages:
    """Return end-fire phases with an additional lag from each row to the next."""
    _, rows = np.unique(np.round(places_m[:, 1], 9), return_inverse=True)
    voltages: Voltages = end_fire(places_m, wavelength_m) * np.exp(-1j * lag_rad * rows)
    return voltages


def _best_lag_rad(coupling: Array, places_m: Array, wavelength_m: float) -> float:
    """Return the best lag: coarse search over half a turn, then a local optimisation."""

    def loss(lag_rad: float) -> float:
        return -directivity_dbi(_lagging(lag_rad, places_m, wavelength_m), coupling, places_m, wavelength_m)

    coarse = np.arange(0.0, np.pi, LEAST_STEP_RAD)
    about = float(coarse[np.argmin([loss(lag_rad) for lag_rad in coarse.tolist()])])
    found = minimize_scalar(
        loss, bounds=(about - LEAST_STEP_RAD, about + LEAST_STEP_RAD), method="bounded",
        options={"xatol": 1e-7},
    )  # fmt: skip
    return float(found.x)
