"""Which position error gives which density: random formations without a flight, by the lab's draws."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Literal

import numpy as np

from antenna.backend import BackendUnavailable, make_backend
from antenna.config import AntennaConfig
from antenna.geometry import Snapshot, along, grid
from antenna.lab.formations import Disorder, draws, ideal
from antenna.patterns import Pattern
from antenna.statistics import GainStatistics, gain_density, gain_statistics
from harness.flight import Array

WIND_PHIS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)
"""Towards which wind blows where its direction is gone through."""
SIGMAS_M = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8, 1.0, 1.4)
"""On each axis, independent and Gaussian."""
WAVELENGTHS_M = (5.0, 10.0, 15.0, 20.0)
COLUMNS, ROWS, BROADSIDE, ENDFIRE = 4, 2, 0.85, 0.25
"""The article's formation; spacings in wavelengths."""
Solver = Literal["batch", "nec2", "nec2c"]
BACKENDS: tuple[Solver, ...] = ("batch", "nec2", "nec2c")
_SEED = 1


@dataclass(frozen=True, slots=True)
class Drawn:
    """Maximum gain of many random formations."""

    statistics: GainStatistics
    peak_per_db: float
    """Highest probability density."""


def ideal_gains(wavelengths_m: Sequence[float]) -> dict[str, dict[float, Pattern]]:
    """Solve the article's formation in its places by every solver there is; by its name and wavelength."""
    found: dict[str, dict[float, Pattern]] = {}
    for name in BACKENDS:
        with contextlib.suppress(BackendUnavailable):
            found[name] = {wavelength_m: _ideal(name, wavelength_m) for wavelength_m in wavelengths_m}
    return found


def _ideal(backend: Solver, wavelength_m: float) -> Pattern:
    config = AntennaConfig(wavelength_m=wavelength_m, backend=backend)
    (pattern,) = make_backend(config).patterns([ideal(_places_m(wavelength_m), config)])
    if not isinstance(pattern, Pattern):
        raise pattern
    return pattern


def tilted(wavelength_m: float, tilt_rad: float, wind_phi_deg: float, grid_deg: float) -> Pattern:
    """Solve the formation in its places, all vehicles leaning against a wind that blows towards phi."""
    config, phi = AntennaConfig(wavelength_m=wavelength_m, grid_deg=grid_deg), np.radians(wind_phi_deg)
    axis = np.array([-np.sin(tilt_rad) * np.cos(phi), -np.sin(tilt_rad) * np.sin(phi), np.cos(tilt_rad)])
    upright = ideal(_places_m(wavelength_m), config)
    leaning = Snapshot(upright.centres_m, along(np.tile(axis, (COLUMNS * ROWS, 1))), upright.voltages)
    (pattern,) = make_backend(config).patterns([leaning])
    if not isinstance(pattern, Pattern):
        raise pattern
    return pattern


def draw(
    samples: int,
    *,
    sigmas_m: Sequence[float] = SIGMAS_M,
    wavelengths_m: Sequence[float] = WAVELENGTHS_M,
    done: Callable[[int, int], None] = lambda _done, _total: None,
) -> dict[tuple[float, float], Drawn]:
    """Draw and solve ``samples`` formations for each error and wavelength, by (sigma_m, wavelength_m).

    The vehicles are upright. ``done`` is told how many of the pairs are through, and of how many.
    """
    found: dict[tuple[float, float], Drawn] = {}
    for wavelength_m in wavelengths_m:
        config = AntennaConfig(wavelength_m=wavelength_m)
        backend, places_m = make_backend(config), _places_m(wavelength_m)
        for sigma_m in sigmas_m:
            disorder = Disorder(sigma_m=sigma_m, seed=_SEED)
            results = backend.patterns(list(islice(draws(places_m, config, disorder), samples)))
            gains = [each.max_gain_dbi for each in results if isinstance(each, Pattern)]
            found[sigma_m, wavelength_m] = summarise(np.array(gains))
            done(len(found), len(sigmas_m) * len(wavelengths_m))
    return found


def summarise(max_gain_dbi: Array) -> Drawn:
    """Give moments and highest density of (K,) gains that differ."""
    return Drawn(gain_statistics(max_gain_dbi), float(gain_density(max_gain_dbi).kernel_per_db.max()))


def _places_m(wavelength_m: float) -> Array:
    return grid(COLUMNS * ROWS, COLUMNS, BROADSIDE * wavelength_m, ENDFIRE * wavelength_m)
