"""Directivity along +y of arrays with given currents, and currents of the feeding policies, without wires.

With currents v it is |f v|^2 / (v^H C v): f (n,) are the phases exp(j k y) with which the elements arrive in
direction +y, and C (n, n), symmetric, is the mean over the sphere of what each two of them send together.
That is sin(kd) / (kd) for isotropic elements (C. A. Balanis, Antenna Theory, 4th ed., chapter 6).
"""

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import spherical_jn

from antenna.analysis.radiated_power import mean_intensity
from antenna.model.excitation import end_fire, hansen_woodyard, optimum
from antenna.model.geometry import Array, Voltages

LEAST_STEP_RAD = 0.05
"""Lag by which a search for the best one begins."""


def isotropic_coupling(places_m: Array, wavelength_m: float) -> Array:
    """(n, n) C of elements that send alike everywhere."""
    distance_m = np.linalg.norm(places_m[:, None] - places_m, axis=-1)
    return np.asarray(spherical_jn(0, 2.0 * np.pi / wavelength_m * distance_m))


def hertzian_coupling(places_m: Array, wavelength_m: float) -> Array:
    """(n, n) C of upright Hertzian dipoles, of their mean intensity q: (q(i + k) - q(i - k)) / 4."""
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
    """Along +y, of currents in the ratio of the voltages."""
    arriving = end_fire(places_m, wavelength_m).conj()
    power = float((voltages.conj() @ coupling @ voltages).real)
    return float(10.0 * np.log10(abs(arriving @ voltages) ** 2 / power))


def policy_voltages(policy: str, coupling: Array, places_m: Array, wavelength_m: float) -> Voltages:
    """(n,) voltages of ``end_fire``, ``hansen_woodyard``, ``best_step`` or ``optimum`` without mutual wires.

    ``best_step`` has the lag from row to row, uniform, that is best along +y.
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
    """End-fire phases, and this much more lag from each row to the next."""
    _, rows = np.unique(np.round(places_m[:, 1], 9), return_inverse=True)
    voltages: Voltages = end_fire(places_m, wavelength_m) * np.exp(-1j * lag_rad * rows)
    return voltages


def _best_lag_rad(coupling: Array, places_m: Array, wavelength_m: float) -> float:
    """The best of a coarse search over half a turn, then exactly about it."""

    def loss(lag_rad: float) -> float:
        return -directivity_dbi(_lagging(lag_rad, places_m, wavelength_m), coupling, places_m, wavelength_m)

    coarse = np.arange(0.0, np.pi, LEAST_STEP_RAD)
    about = float(coarse[np.argmin([loss(lag_rad) for lag_rad in coarse.tolist()])])
    found = minimize_scalar(
        loss, bounds=(about - LEAST_STEP_RAD, about + LEAST_STEP_RAD), method="bounded",
        options={"xatol": 1e-7},
    )  # fmt: skip
    return float(found.x)
