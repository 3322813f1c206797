"""Feeds of an array: phases for a main lobe along +y, and the weights of maximum gain.

Amplitudes are uniform, except for the optimum. Positions are (n, 3) in the antenna's frame: of the ideal
formation, or the true or estimated positions of the vehicles.
"""

import numpy as np

from antenna.model.geometry import Array, Complex, Voltages

ROW_APART_LAMBDA = 0.05
"""Places closer to each other along y belong to one row."""


def end_fire(positions_m: Array, wavelength_m: float) -> Voltages:
    """Return exp(-j k y), (n,): all contributions are in phase along +y."""
    voltages: Voltages = np.exp(-2j * np.pi / wavelength_m * positions_m[:, 1])
    return voltages


def hansen_woodyard(positions_m: Array, wavelength_m: float, places_m: Array | None = None) -> Voltages:
    """Return end-fire voltages (n,) with an additional lag of 2.92 / N rad from each of N rows to the next.

    Rows and their spacing are those of the formation's places (n, 3), by default the positions; with noisy
    positions rows cannot be identified. W. W. Hansen and J. R. Woodyard, "A new principle in directional
    antenna design", Proc. IRE 26 (1938). Raises ValueError for a single row.
    """
    places_m = positions_m if places_m is None else places_m
    along_m = np.sort(places_m[:, 1])
    rows = 1 + int((np.diff(along_m) > ROW_APART_LAMBDA * wavelength_m).sum())
    if rows < 2:
        raise ValueError("Hansen-Woodyard phases need two rows or more along the end-fire axis")
    between_m = float(along_m[-1] - along_m[0]) / (rows - 1)
    lag_rad = 2.92 / rows * (positions_m[:, 1] - along_m[0]) / between_m
    voltages: Voltages = end_fire(positions_m, wavelength_m) * np.exp(-1j * lag_rad)
    return voltages


def optimum(conductance_s: Array, towards: Complex) -> Voltages:
    """Return the voltages (n,) of maximum gain in a direction.

    Gain is v^H B v / v^H G v with G (n, n) the real part of the admittance matrix, symmetric, and B = F^H F
    of the far fields F (2, n) of 1 V at each element in that direction, in two polarisations. The maximum is
    the greatest eigenvalue of G^-1 B, equal to that of the 2 x 2 matrix F G^-1 F^H. (R. F. Harrington, Field
    computation by moment methods, 1968, chapter 10.)
    """
    spread = np.linalg.solve(conductance_s, towards.conj().T)
    _, vectors = np.linalg.eigh(towards @ spread)
    weights = spread @ vectors[:, -1]
    voltages: Voltages = weights * (np.sqrt(len(weights)) / np.linalg.norm(weights))
    return voltages
