"""Arrays shared by the antenna tests: the article's array, ideal and disturbed."""

import numpy as np

from antenna.model.excitation import end_fire
from antenna.model.geometry import Snapshot, along, grid, upright


def vertical_snapshot(places_m, wavelength_m):
    """Return upright elements at positions (n, 3), fed as an ordinary end-fire array."""
    return upright(places_m, end_fire(places_m, wavelength_m))


def ideal(wavelength_m, count=8):
    """Return the article's 4 x 2 array, or its first ``count`` elements."""
    return vertical_snapshot(grid(count, 4, 0.85 * wavelength_m, 0.25 * wavelength_m), wavelength_m)


def perturbed(rng, wavelength_m, sigma_m=0.5, tilt_rad=0.1, count=8):
    """Return the array with Gaussian position errors per axis and random tilts."""
    array = ideal(wavelength_m, count)
    axes = array.axes + rng.normal(0.0, tilt_rad, (count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return Snapshot(array.centres_m + rng.normal(0.0, sigma_m, (count, 3)), along(axes), array.voltages)
