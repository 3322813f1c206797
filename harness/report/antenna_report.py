"""Antenna part of a run's report: flown patterns, their statistics, and their files."""

import contextlib
import math
import os
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

from antenna.analysis.patterns import Pattern
from antenna.analysis.statistics import gain_statistics
from antenna.model.array_deck import deck_of
from antenna.model.geometry import ElementsTouch
from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.nec2c import Nec2cFailed
from antenna.solvers.parallel import WorkerError
from antenna.solvers.selection import make_backend
from harness.records.flight import Flight
from harness.records.run_folder import RunFolder
from harness.records.tables import write_gains
from harness.report.flown_array import GainSeries, NoFeed, describe_touch, gain_series, ideal_pattern
from harness.scenario.scenario import Scenario

_threads: ContextVar[int | None] = ContextVar("threads", default=None)
"""Number of threads that compute patterns; None: one per processor"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Solver:
    """Solver that computed the gains."""

    backend: str
    accuracy: str
    """A sentence on their deviation from NEC2."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aperture:
    """Results of the antenna; missing ones are None, with the reason in ``note``."""

    solver: Solver | None = None
    ideal: Pattern | None = None
    """Pattern with every vehicle upright in its place."""
    series: GainSeries | None = None
    """Series over the time in formation; None only if the solver is not available."""
    note: str | None = None


@contextlib.contextmanager
def on_threads(count: int) -> Iterator[None]:
    """Limit `measure` to ``count`` threads or processes in the block, for flights in parallel."""
    before = _threads.set(count)
    try:
        yield
    finally:
        _threads.reset(before)


def measure(window: Flight, scenario: Scenario) -> Aperture:
    """Compute the patterns of the time in formation, which may be empty, and the ideal pattern."""
    config, note, ideal = scenario.antenna, None, None
    try:
        backend = make_backend(config)
        solver = Solver(backend=backend.name, accuracy=str(backend.accuracy))
        try:
            ideal = ideal_pattern(scenario.places_ned_m(), heading_rad(scenario), config)
        except ElementsTouch as touch:
            note = f"the ideal formation: {describe_touch(touch, range(scenario.agents))}"
        except NoFeed as error:
            note = f"the ideal formation: {error}"
        workers = _threads.get() or os.cpu_count() or 1
        series = gain_series(window, config, workers=workers, with_grids=config.keep_patterns)
    except (BackendUnavailable, WorkerError, Nec2cFailed) as error:
        return Aperture(note=str(error))
    if not len(window):
        note = note or "the formation was not reached"
    return Aperture(solver=solver, ideal=ideal, series=series, note=note)


def heading_rad(scenario: Scenario) -> float:
    """Return the heading of the formation before it moves."""
    return math.radians(scenario.formation.heading_deg)


def numbers(aperture: Aperture) -> dict[str, Any]:
    """Return the statistics of the maximum gain for the summary."""
    series, ideal, solver = aperture.series, aperture.ideal, aperture.solver
    statistics = gain_statistics(series.max_gain_dbi) if series is not None and series.patterns else None
    return {
        "ideal": None if ideal is None else round(ideal.max_gain_dbi, 4),
        "mean": None if statistics is None else round(statistics.mean_dbi, 4),
        "std": None if statistics is None else round(statistics.std_db, 4),
        "patterns": len(series.patterns) if series else 0,
        "missing": len(series.missing) if series else 0,
        "backend": solver.backend if solver else None,
        "accuracy": solver.accuracy if solver else None,
        **({"note": aperture.note} if aperture.note else {}),
    }


def write(folder: RunFolder, aperture: Aperture, scenario: Scenario) -> None:
    """Write the series of gains, the median instant as a NEC deck and, with ``keep_patterns``, all patterns.

    Writes nothing without a solver, and no deck and patterns without a pattern. Raises OSError.
    """
    series, config = aperture.series, scenario.antenna
    if series is None or aperture.solver is None:
        return
    write_gains(folder.gains, series, scenario)
    median, snapshot = series.median_index, series.median_snapshot
    if median is None or snapshot is None:
        return
    at = f"t = {series.time_us[median] * 1e-6:.3f} s, the instant of median maximum gain"
    deck = deck_of(snapshot, config, series.patterns[median], comments=[at])
    folder.deck.write_text(deck, encoding="ascii")
    if config.keep_patterns:
        from antenna.analysis.dataset import to_dataset, write_dataset  # noqa: PLC0415  slow to import

        dataset = to_dataset(
            series.patterns, config, accuracy=aperture.solver.accuracy, time_us=series.time_us
        )
        write_dataset(dataset, folder.patterns)
