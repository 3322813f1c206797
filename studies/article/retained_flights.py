"""Retained flights: losses of gain due to position errors and due to tilt, and the patterns of figure 4.

Each flight is solved three times: as flown, with upright vehicles at their flown positions, and with vehicles
in their places with their flown tilt. The differences separate the two causes.
"""

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import Struct, structs

from antenna.analysis.patterns import Pattern
from antenna.analysis.statistics import pointing_errors_deg
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, Snapshot
from antenna.solvers.parallel import compute_patterns
from antenna.solvers.ports import MAIN_LOBE_DEG
from foundation.types import Array
from harness.campaign import Table
from harness.records.flight import Flight
from harness.records.tables import make_flight
from harness.report.flown_array import FIGURE_GRID_DEG, NoFeed, gain_series, ideal_pattern, snapshot_at
from harness.report.formation_error import formation_error
from harness.scenario.scenario import Scenario
from studies.article.monte_carlo import upright_array
from studies.article.patterns import PatternReading, mean_pattern, read_pattern
from studies.article.plan import FIGURE_WAVELENGTH_M, FIGURE_WIND_N

FLOWN, UPRIGHT, IN_PLACE = "flown", "upright", "in place"
VARIANTS = (FLOWN, UPRIGHT, IN_PLACE)
_AT_A_TIME = 64
"""Fine patterns held in memory at the same time."""


@dataclass(frozen=True, slots=True, eq=False)
class KeptFlight:
    """A flight in formation with its scenario."""

    scenario: Scenario
    flight: Flight
    """Starts when the formation is reached."""

    @property
    def wind_n(self) -> float:
        """Mean force on each vehicle."""
        return self.scenario.wind.mean_n or 0.0


class Separation(Struct, frozen=True, kw_only=True):
    """Mean maximum gain of the retained flights of one wavelength and wind, by variant."""

    wavelength_m: float
    wind_n: float
    ideal_dbi: float
    mean_dbi: dict[int, dict[str, float]]
    """By seed of the flight and `VARIANTS`."""
    tilt_rms_deg: float
    """Tilt of the vehicles from the vertical."""
    turned_rms_deg: float
    """Rotation of the formation about the vertical."""
    pointing_rms_deg: float
    """Angle of the maximum from the end-fire axis, as flown."""

    @property
    def seeds(self) -> list[int]:
        """Sorted seeds of the flights."""
        return sorted(self.mean_dbi)

    def loss_db(self, variant: str, seeds: Sequence[int] | None = None) -> float:
        """Return the loss from the ideal gain, mean of the flights of the given seeds, by default all."""
        means = [self.mean_dbi[seed][variant] for seed in (self.seeds if seeds is None else seeds)]
        return self.ideal_dbi - math.fsum(means) / len(means)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FigurePatterns:
    """Patterns of one flight on a fine grid."""

    seed: int
    time_s: float
    """Time of the flight's median maximum gain."""
    ideal: Pattern
    median: Pattern
    means: dict[str, Pattern]
    """Patterns of the flight's mean power density, by `VARIANTS`."""

    def readings(self) -> dict[str, PatternReading]:
        """Return the features of all patterns: ``ideal``, ``median``, and the means by `VARIANTS`."""
        patterns = {"ideal": self.ideal, "median": self.median, **self.means}
        return {name: read_pattern(pattern, self.ideal) for name, pattern in patterns.items()}


def kept_flights(table: Table) -> Iterator[KeptFlight]:
    """Yield the retained flights of a table that reached their formation."""
    formed_s = table.column("formed_s") if "formed_s" in table.rows.column_names else []
    for row, at_s in enumerate(formed_s):
        columns = table.series(row, "flight")
        if at_s is None or columns is None:
            continue
        flight = make_flight(columns, table.runs[row].scenario, start_us=None)
        window = flight.at(np.flatnonzero(flight.time_us >= round(at_s * 1e6)))
        if len(window):
            yield KeptFlight(table.runs[row].scenario, window)


def variants(flight: Flight) -> dict[str, Flight]:
    """Return the flight as flown, upright, and in place, by `VARIANTS`."""
    upright = np.zeros_like(flight.q_ned_frd)
    upright[..., 0] = np.cos(flight.heading_rad / 2.0)[:, None]
    upright[..., 3] = np.sin(flight.heading_rad / 2.0)[:, None]
    return {
        FLOWN: flight,
        UPRIGHT: replace(flight, q_ned_frd=upright),
        IN_PLACE: replace(flight, pos_ned_m=flight.desired_pos_ned_m),
    }


def tilts_rad(q_ned_frd: Array) -> Array:
    """Return the angles (...,) between the vehicles' down axes and the vertical for attitudes (..., 4)."""
    x, y = q_ned_frd[..., 1], q_ned_frd[..., 2]
    return np.asarray(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))


def separate(
    flights: Sequence[KeptFlight], *, done: Callable[[int], None] = lambda _flights: None
) -> list[Separation]:
    """Solve every variant of every flight; return the means for each wavelength and wind.

    Flights with a variant without patterns are skipped. ``done`` is called with the number of flights done.
    """
    groups: dict[tuple[float, float], list[_Solved]] = {}
    for number, kept in enumerate(flights, start=1):
        if (solved := _solve(kept)) is not None:
            groups.setdefault((kept.scenario.antenna.wavelength_m, kept.wind_n), []).append(solved)
        done(number)
    return [_separation(wavelength_m, wind_n, group) for (wavelength_m, wind_n), group in groups.items()]


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """Values of one flight over its instants and alive vehicles."""

    seed: int
    ideal_dbi: float
    max_gain_dbi: dict[str, Array]
    tilts_rad: Array
    turned_rad: Array
    pointing_deg: Array


def _solve(kept: KeptFlight) -> _Solved | None:
    series = {
        name: gain_series(variant, kept.scenario.antenna) for name, variant in variants(kept.flight).items()
    }
    if not all(len(each.patterns) for each in series.values()):
        return None
    scenario = kept.scenario
    heading_rad = math.radians(scenario.formation.heading_deg)
    return _Solved(
        seed=scenario.run.seed,
        ideal_dbi=ideal_pattern(scenario.places_ned_m(), heading_rad, scenario.antenna).max_gain_dbi,
        max_gain_dbi={name: each.max_gain_dbi for name, each in series.items()},
        tilts_rad=tilts_rad(kept.flight.q_ned_frd)[kept.flight.alive],
        turned_rad=formation_error(kept.flight).yaw_rad,
        pointing_deg=pointing_errors_deg(series[FLOWN].patterns, *MAIN_LOBE_DEG),
    )  # fmt: skip


def _separation(wavelength_m: float, wind_n: float, group: Sequence[_Solved]) -> Separation:
    return Separation(
        wavelength_m=wavelength_m, wind_n=wind_n, ideal_dbi=group[0].ideal_dbi,
        mean_dbi={
            each.seed: {name: float(each.max_gain_dbi[name].mean()) for name in VARIANTS} for each in group
        },
        tilt_rms_deg=math.degrees(_rms([each.tilts_rad for each in group])),
        turned_rms_deg=math.degrees(_rms([each.turned_rad for each in group])),
        pointing_rms_deg=_rms([each.pointing_deg for each in group]),
    )  # fmt: skip


def _rms(parts: Sequence[Array]) -> float:
    return float(np.sqrt((np.concatenate(parts) ** 2).mean()))


def figure_flights(flights: Iterable[KeptFlight]) -> Iterator[KeptFlight]:
    """Yield the flights with wavelength and wind of the article's pattern."""
    of_figure = (FIGURE_WAVELENGTH_M, FIGURE_WIND_N)
    return (each for each in flights if (each.scenario.antenna.wavelength_m, each.wind_n) == of_figure)


def snapshots_of(flight: Flight, config: AntennaConfig) -> dict[int, Snapshot]:
    """Return the feedable arrays of the flight at ``config.snapshot_rate_hz``, by time in us."""
    sampled = flight.sampled(config.snapshot_rate_hz)
    found: dict[int, Snapshot] = {}
    for t, time_us in enumerate(sampled.time_us.tolist()):
        with contextlib.suppress(ElementsTouch, NoFeed):
            found[time_us] = snapshot_at(sampled, t, config)
    return found


def figure_patterns_of(kept: KeptFlight) -> FigurePatterns | None:
    """Solve one flight on a fine grid: the median instant, and the means of its variants.

    None if a variant has no pattern.
    """
    scenario = kept.scenario
    fine = structs.replace(scenario.antenna, grid_deg=min(scenario.antenna.grid_deg, FIGURE_GRID_DEG))
    means: dict[str, Pattern] = {}
    flown: list[tuple[float, int]] = []  # maximum gains, with their times in us
    arrays = {name: snapshots_of(each, scenario.antenna) for name, each in variants(kept.flight).items()}
    for name, snapshots in arrays.items():
        noted: list[tuple[float, int]] = []
        mean = mean_pattern(_patterns(fine, snapshots, noted))
        if mean is None:
            return None
        means[name] = mean
        flown = noted if name == FLOWN else flown
    _, time_us = sorted(flown)[(len(flown) - 1) // 2]
    ideal, median = compute_patterns(fine, [upright_array(scenario), arrays[FLOWN][time_us]])
    if not isinstance(ideal, Pattern) or not isinstance(median, Pattern):
        return None
    return FigurePatterns(
        seed=scenario.run.seed, time_s=time_us / 1e6, ideal=ideal, median=median, means=means
    )


def _patterns(
    config: AntennaConfig, snapshots: Mapping[int, Snapshot], noted: list[tuple[float, int]]
) -> Iterator[Pattern]:
    """Solve snapshots in batches; append the maximum gain and the time of each to ``noted``."""
    times_us = list(snapshots)
    for first in range(0, len(times_us), _AT_A_TIME):
        batch = times_us[first : first + _AT_A_TIME]
        results = compute_patterns(config, [snapshots[time_us] for time_us in batch])
        for time_us, result in zip(batch, results, strict=True):
            if isinstance(result, Pattern):
                noted.append((result.max_gain_dbi, time_us))
                yield result
