"""The article's array without a flight: ideal by every solver, tilted, and with random position errors.

Places, elements, grid and solver are those of the flown scenario.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import structs
from scipy.spatial.transform import Rotation

from antenna.analysis.patterns import Pattern, from_dbi
from antenna.analysis.statistics import GainStatistics, gain_density, gain_statistics
from antenna.lab.formations import Disorder, draws
from antenna.model.array_deck import write_deck
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Snapshot
from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.parallel import compute_patterns
from antenna.solvers.ports import MAIN_LOBE_DEG
from foundation.types import Array
from harness.report.flown_array import upright_snapshot
from harness.scenario.scenario import Scenario
from harness.scenario.scenario_file import load
from studies.article.plan import SCENARIO, WAVELENGTH

WIND_PHIS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)
"""Wind directions of the sweep; the wind blows towards phi."""
SIGMAS_M = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8, 1.0, 1.4)
"""Standard deviations of independent Gaussian errors on each axis."""
WAVELENGTHS_M = (5.0, 10.0, 15.0, 20.0)
Solver = Literal["batch", "nec2", "nec2c"]
BACKENDS: tuple[Solver, ...] = ("batch", "nec2", "nec2c")
_SEED = 1


@dataclass(frozen=True, slots=True)
class Drawn:
    """Maximum gain of many random formations."""

    statistics: GainStatistics
    peak_per_db: float
    """Highest probability density."""
    mean_gain: float
    """Mean linear gain."""
    mean_gain_error: float
    """Its standard error."""
    axis_gain: float
    """Mean linear gain in the direction of the ideal maximum."""


def array_of(wavelength_m: float, scenario: Path = SCENARIO) -> tuple[Snapshot, AntennaConfig]:
    """Return the array of all vehicles upright in their places at a wavelength, and its configuration."""
    loaded = load(scenario, (f"{WAVELENGTH}={float(wavelength_m)!r}",))
    return upright_array(loaded), loaded.antenna


def upright_array(scenario: Scenario) -> Snapshot:
    """Return the array of all vehicles upright in their initial places, in the antenna's frame.

    Raises `ElementsTouch`, `NoFeed`.
    """
    heading_rad = math.radians(scenario.formation.heading_deg)
    return upright_snapshot(scenario.places_ned_m(), heading_rad, scenario.antenna)


def frequency_mhz(wavelength_m: float, scenario: Path = SCENARIO) -> float:
    """Return the frequency in the array's deck at a wavelength, MHz."""
    snapshot, config = array_of(wavelength_m, scenario)
    deck = write_deck(snapshot, config)
    card = next(line.split() for line in deck.splitlines() if line.startswith("FR "))
    return float(card[5])


def ideal_gains(wavelengths_m: Sequence[float], scenario: Path = SCENARIO) -> dict[str, dict[float, Pattern]]:
    """Solve the article's formation in its places by all installed solvers; by solver and wavelength."""
    found: dict[str, dict[float, Pattern]] = {}
    arrays = {wavelength_m: array_of(wavelength_m, scenario) for wavelength_m in wavelengths_m}
    for name in BACKENDS:
        with contextlib.suppress(BackendUnavailable):
            found[name] = {
                wavelength_m: _solve(structs.replace(config, backend=name), snapshot)
                for wavelength_m, (snapshot, config) in arrays.items()
            }
    return found


def _solve(config: AntennaConfig, snapshot: Snapshot) -> Pattern:
    (pattern,) = compute_patterns(config, [snapshot])
    if not isinstance(pattern, Pattern):
        raise pattern
    return pattern


def tilted(
    wavelength_m: float, tilt_rad: float, wind_phi_deg: float, grid_deg: float, scenario: Path = SCENARIO
) -> Pattern:
    """Solve the formation in its places, all vehicles leaning against a wind that blows towards phi."""
    upright, config = array_of(wavelength_m, scenario)
    phi = np.radians(wind_phi_deg)
    turn = Rotation.from_rotvec(tilt_rad * np.array([np.sin(phi), -np.cos(phi), 0.0]))  # its top moves upwind
    leaning = Snapshot(upright.centres_m, turn.as_matrix() @ upright.rotations, upright.voltages)
    return _solve(structs.replace(config, grid_deg=grid_deg), leaning)


def draw(
    samples: int,
    *,
    sigmas_m: Sequence[float] = SIGMAS_M,
    wavelengths_m: Sequence[float] = WAVELENGTHS_M,
    scenario: Path = SCENARIO,
    done: Callable[[int, int], None] = lambda _done, _total: None,
) -> dict[tuple[float, float], Drawn]:
    """Draw and solve ``samples`` formations for each error and wavelength, by (sigma_m, wavelength_m).

    The vehicles are upright. ``done`` is called with the number of finished pairs and their total.
    """
    found: dict[tuple[float, float], Drawn] = {}
    for wavelength_m in wavelengths_m:
        ideal, config = array_of(wavelength_m, scenario)
        for sigma_m in sigmas_m:
            disorder = Disorder(sigma_m=sigma_m, seed=_SEED)
            drawn = list(islice(draws(ideal.centres_m, config, disorder), samples))
            results = compute_patterns(config, drawn)
            patterns = [each for each in results if isinstance(each, Pattern)]
            found[sigma_m, wavelength_m] = summarise(
                np.array([each.max_gain_dbi for each in patterns]),
                np.array([_gain_towards(each, *MAIN_LOBE_DEG) for each in patterns]),
            )
            done(len(found), len(sigmas_m) * len(wavelengths_m))
    return found


def _gain_towards(pattern: Pattern, theta_deg: float, phi_deg: float) -> float:
    """Return the linear gain in the grid direction nearest to the given one."""
    row = int(np.abs(pattern.theta_deg - theta_deg).argmin())
    return float(pattern.gain[row, int(np.abs(pattern.phi_deg - phi_deg).argmin())])


def summarise(max_gain_dbi: Array, axis_gain: Array) -> Drawn:
    """Summarise maximum gains (K,) and linear gains (K,) towards the ideal maximum; K is at least 2.

    The highest density is infinite if all maximum gains are equal.
    """
    gain, kernel_per_db = np.asarray(from_dbi(max_gain_dbi)), gain_density(max_gain_dbi).kernel_per_db
    return Drawn(
        statistics=gain_statistics(max_gain_dbi),
        peak_per_db=float(kernel_per_db.max()) if len(kernel_per_db) else np.inf,
        mean_gain=float(gain.mean()), mean_gain_error=float(gain.std(ddof=1) / np.sqrt(len(gain))),
        axis_gain=float(axis_gain.mean()),
    )  # fmt: skip
