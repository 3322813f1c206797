"""Implementation of the commands: solve formations, evaluate patterns, write files, return reports."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from msgspec import Struct
from rich.console import Console
from rich.progress import track

from antenna.analysis.dataset import to_dataset, write_dataset
from antenna.analysis.features import features, has_one_maximum
from antenna.analysis.gain_figures import cuts_figure, envelope_figure, gain_density_figure, patterns_figure
from antenna.analysis.patterns import Pattern, directions_deg
from antenna.analysis.statistics import (
    HISTOGRAM_BYTES,
    RunningEnvelope,
    gain_statistics,
    gain_towards_dbi,
    pointing_errors_deg,
    pointing_statistics,
)
from antenna.lab.formations import Disorder, draws, ideal
from antenna.lab.hertzian import hertzian_pattern
from antenna.model.array_deck import deck_of
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Array, ElementsTouch, Snapshot
from antenna.solvers.interface import Backend
from antenna.solvers.parallel import compute_patterns
from antenna.solvers.ports import MAIN_LOBE_DEG
from antenna.solvers.selection import make_backend

SHORT_LAMBDA = 0.1
"""Longest dipole, in wavelengths, with the pattern of a Hertzian dipole within 0.01 dB."""
AT_A_TIME = 512
"""Most patterns in memory, unless they are written to a file."""
LOT_BYTES = 200_000_000
"""Most memory of these patterns, unless a single one needs more."""
MOST_KEPT_BYTES = 4_000_000_000
"""Most memory of patterns for one file, or of an envelope's histograms."""
EXACT_GRID_DEG = 1.0
"""Least step of the grid on which the closed form's maximum is searched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Files:
    """Paths of the files to write; None: not written."""

    figure: Path | None = None
    cuts: Path | None = None
    envelope: Path | None = None
    deck: Path | None = None
    netcdf: Path | None = None


class PatternReport(Struct, frozen=True, kw_only=True):
    """Report on one pattern; None where not defined."""

    max_gain_dbi: float
    theta_deg: float
    phi_deg: float
    """Direction of the maximum, with theta."""
    backend: str
    accuracy: str
    average_gain: float
    azimuth_width_deg: float | None
    elevation_width_deg: float | None
    side_lobe_dbi: float | None
    back_dbi: float
    null_dbi: float
    towards_dbi: float
    """Gain along +y, the nominal direction of the main lobe."""
    pointing_error_deg: float | None
    """Angle of the maximum from +y; None if the maximum is ambiguous (`has_one_maximum`)."""
    exact_directivity_dbi: float | None
    """Directivity of Hertzian dipoles with currents proportional to the voltages; for short dipoles."""
    elements: int
    grid_deg: float


class Spread(Struct, frozen=True, kw_only=True):
    """Statistics of decibels."""

    mean_dbi: float
    std_db: float
    quantiles: dict[str, float]


class Pointing(Struct, frozen=True, kw_only=True):
    """Statistics of the angles between the maxima and +y."""

    mean_deg: float
    rms_deg: float
    max_deg: float
    quantiles: dict[str, float]


class StatisticsReport(Struct, frozen=True, kw_only=True):
    """Report on many patterns; statistics are over those whose elements do not touch."""

    mean_dbi: float
    """Mean of the maximum gains in decibels; likewise ``std_db`` and ``quantiles``, dBi by probability."""
    std_db: float
    min_dbi: float
    max_dbi: float
    quantiles: dict[str, float]
    ideal_dbi: float | None
    """Maximum gain of the ideal formation; None if it has no pattern, for example if elements touch."""
    samples: int
    missing: int
    """Samples without a pattern, because elements touch or are too close for the solver."""
    first_missing: str | None
    towards: Spread
    """Gain along +y."""
    pointing: Pointing
    mean_pattern_max_dbi: float
    """Maximum of the mean pattern (mean of linear gains) on the grid."""
    backend: str
    accuracy: str
    elements: int


def one_pattern(places_m: Array, config: AntennaConfig, disorder: Disorder, files: Files) -> PatternReport:
    """Solve the ideal formation, or the first random one; raises `ElementsTouch`."""
    backend = make_backend(config)
    drawn = disorder.sigma_m > 0.0 or disorder.tilt_rad > 0.0
    snapshot = next(draws(places_m, config, disorder)) if drawn else ideal(places_m, config)
    pattern = _solved(backend, snapshot)
    found = features(pattern)
    if files.deck is not None:
        _in_folder(files.deck).write_text(deck_of(snapshot, config, pattern), encoding="ascii")
    if files.netcdf is not None:
        write_dataset(to_dataset([pattern], config, accuracy=backend.accuracy), _in_folder(files.netcdf))
    if files.figure is not None or files.cuts is not None:
        panels = {f"Seed {disorder.seed}" if drawn else "Ideal": pattern}
        if drawn and (perfect := _ideal_pattern(backend, places_m, config)) is not None:
            panels = {"Ideal": perfect, **panels}
        _save(files.figure, lambda: patterns_figure(panels))
        _save(files.cuts, lambda: cuts_figure(panels))
    error_deg = float(pointing_errors_deg([pattern], *MAIN_LOBE_DEG)[0])
    return PatternReport(
        max_gain_dbi=pattern.max_gain_dbi, theta_deg=pattern.max_theta_deg, phi_deg=pattern.max_phi_deg,
        backend=backend.name, accuracy=str(backend.accuracy), average_gain=pattern.average_gain,
        azimuth_width_deg=found.azimuth_width_deg, elevation_width_deg=found.elevation_width_deg,
        side_lobe_dbi=found.side_lobe_dbi, back_dbi=found.back_dbi, null_dbi=found.null_dbi,
        towards_dbi=float(gain_towards_dbi([pattern], *MAIN_LOBE_DEG)[0]),
        pointing_error_deg=error_deg if has_one_maximum(pattern) else None,
        exact_directivity_dbi=exact_directivity_dbi(snapshot, config),
        elements=len(places_m), grid_deg=float(pattern.theta_deg[1]),
    )  # fmt: skip


def many_patterns(
    places_m: Array, config: AntennaConfig, disorder: Disorder, *, samples: int, cores: int, files: Files
) -> StatisticsReport:
    """Solve random formations and return their statistics.

    Raises ValueError if no formation has a pattern, and as `draws` if the formation cannot be fed.
    """
    solver = make_backend(config, threads=cores)
    size = samples * _pattern_bytes(config)
    if files.netcdf is not None and size > MOST_KEPT_BYTES:
        raise ValueError(f"--netcdf: {samples} patterns are {size / 1e9:.1f} GB; expected up to 4")
    size = _directions(config) * HISTOGRAM_BYTES
    if files.envelope is not None and size > MOST_KEPT_BYTES:
        raise ValueError(
            f"--envelope: histograms of {config.grid_deg:g} degrees are {size / 1e9:.1f} GB; expected up to 4"
        )
    best = _ideal_pattern(solver, places_m, config)
    running = RunningEnvelope(quantiles=files.envelope is not None)
    missing, first_missing = 0, None
    max_gain_dbi, towards_dbi, errors_deg = [], [], []
    kept: list[Pattern | ElementsTouch] = []
    snapshots = islice(draws(places_m, config, disorder), samples)
    for number, results in _solve(solver, config, snapshots, cores, samples):
        if files.netcdf is not None:
            kept += results
        patterns = []
        for k, result in enumerate(results):
            if isinstance(result, Pattern) and _sound(result):
                patterns.append(result)
                running.add(result)
                continue
            missing += 1
            if first_missing is None:
                # for elements that nearly touch a solver may find negative power
                reason = str(result) if isinstance(result, ElementsTouch) else "the solver found no power"
                first_missing = f"sample {number + k}: {reason}"
        max_gain_dbi += [pattern.max_gain_dbi for pattern in patterns]
        towards_dbi.append(gain_towards_dbi(patterns, *MAIN_LOBE_DEG))
        errors_deg.append(pointing_errors_deg(patterns, *MAIN_LOBE_DEG))
    if not max_gain_dbi:
        raise ValueError(f"no sample has a pattern; {first_missing}")
    gains_dbi, envelope = np.array(max_gain_dbi), running.result()
    ideal_dbi = None if best is None else best.max_gain_dbi
    _save(files.figure, lambda: gain_density_figure({"drawn": gains_dbi}, ideal_dbi))
    _save(files.envelope, lambda: envelope_figure(envelope, best))
    if files.netcdf is not None:
        write_dataset(to_dataset(kept, config, accuracy=solver.accuracy), _in_folder(files.netcdf))
    maximum, towards = gain_statistics(gains_dbi), gain_statistics(np.concatenate(towards_dbi))
    pointing = pointing_statistics(np.concatenate(errors_deg))
    return StatisticsReport(
        mean_dbi=maximum.mean_dbi, std_db=maximum.std_db, min_dbi=maximum.min_dbi, max_dbi=maximum.max_dbi,
        quantiles=_named(maximum.quantiles_dbi), ideal_dbi=ideal_dbi,
        samples=samples, missing=missing, first_missing=first_missing,
        towards=Spread(
            mean_dbi=towards.mean_dbi, std_db=towards.std_db, quantiles=_named(towards.quantiles_dbi)
        ),
        pointing=Pointing(
            mean_deg=pointing.mean_deg, rms_deg=pointing.rms_deg, max_deg=pointing.max_deg,
            quantiles=_named(pointing.quantiles_deg),
        ),
        mean_pattern_max_dbi=float(envelope.mean_dbi.max()),
        backend=solver.name, accuracy=str(solver.accuracy), elements=len(places_m),
    )  # fmt: skip


def exact_directivity_dbi(snapshot: Snapshot, config: AntennaConfig) -> float | None:
    """Return the closed-form directivity of short dipoles; None for others, or over real ground."""
    short = config.element_kind == "dipole" and config.element_length_m <= SHORT_LAMBDA * config.wavelength_m
    if not short or config.ground == "real":
        return None
    grid_deg, image = max(config.grid_deg, EXACT_GRID_DEG), config.ground == "perfect"
    return hertzian_pattern(snapshot, config.wavelength_m, grid_deg=grid_deg, image=image).max_gain_dbi


def _solve(
    solver: Backend, config: AntennaConfig, snapshots: Iterable[Snapshot], cores: int, samples: int
) -> Iterator[tuple[int, Sequence[Pattern | ElementsTouch]]]:
    """Solve all snapshots in lots; yield the number of the first and the results. Progress goes to stderr."""
    source = iter(snapshots)
    console = Console(stderr=True)
    together = max(1, min(AT_A_TIME, LOT_BYTES // _pattern_bytes(config)))
    firsts = range(0, samples, together)
    for first in track(
        firsts, console=console, description="solving", transient=True, disable=not console.is_terminal
    ):
        lot = list(islice(source, together))
        if solver.name == "batch":  # it uses threads; the others use one process per core
            yield first, solver.patterns(lot)
        else:
            yield first, compute_patterns(config, lot, workers=cores)


def _pattern_bytes(config: AntennaConfig) -> int:
    """Return the size of a pattern: two grids in single precision."""
    return 2 * _directions(config) * np.dtype(np.float32).itemsize


def _directions(config: AntennaConfig) -> int:
    theta_deg, phi_deg = directions_deg(config.grid_deg)
    return len(theta_deg) * len(phi_deg)


def _ideal_pattern(backend: Backend, places_m: Array, config: AntennaConfig) -> Pattern | None:
    """Return the pattern of the ideal formation; None if elements touch there, or cannot be fed."""
    try:
        return _solved(backend, ideal(places_m, config))
    except (ElementsTouch, ValueError):
        return None


def _solved(backend: Backend, snapshot: Snapshot) -> Pattern:
    (result,) = backend.patterns([snapshot])
    if isinstance(result, ElementsTouch):
        raise result
    if not _sound(result):
        raise ValueError(f"elements nearly touch, and {backend.name} finds no radiated power")
    return result


def _sound(pattern: Pattern) -> bool:
    """Whether the radiated power is positive; for elements that nearly touch a solver may find less."""
    return math.isfinite(pattern.max_gain_dbi) and pattern.average_gain > 0.0


def _named(quantiles: dict[float, float]) -> dict[str, float]:
    return {f"{share:g}": value for share, value in quantiles.items()}


def _save(path: Path | None, draw: Callable[[], Figure]) -> None:
    if path is not None:
        draw().savefig(_in_folder(path), format="png", dpi=120)


def _in_folder(path: Path) -> Path:
    """Return the path, after creating its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path
