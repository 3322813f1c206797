"""Flights that were kept whole: what positions cost of the gain and what tilt, and figure 4's patterns.

The same flight is solved three times: as it was flown; with its vehicles upright where they flew; and with
its vehicles in their places, tilted as they flew. What differs between them is the one or the other's doing.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import Struct, structs

from antenna.config import AntennaConfig
from antenna.geometry import Snapshot
from antenna.parallel import compute_patterns
from antenna.patterns import Pattern
from antenna.ports import MAIN_LOBE_DEG
from antenna.statistics import RunningEnvelope, pointing_errors_deg
from harness.analysis import FIGURE_GRID_DEG, figure_patterns, gain_series, ideal_pattern
from harness.article.patterns import PatternReading, mean_pattern, read_pattern
from harness.article.plan import FIGURE_WAVELENGTH_M, FIGURE_WIND_N
from harness.campaign import Table
from harness.campaign.series import make_flight
from harness.flight import Array, Flight
from harness.formation_error import formation_error
from harness.scenario import Scenario

FLOWN, UPRIGHT, IN_PLACE = "flown", "upright", "in place"
VARIANTS = (FLOWN, UPRIGHT, IN_PLACE)
_AT_A_TIME = 64
"""Fine patterns in memory."""


@dataclass(frozen=True, slots=True, eq=False)
class KeptFlight:
    """A flight in formation, with all that its analysis needs."""

    scenario: Scenario
    flight: Flight
    """From when the formation was reached."""

    @property
    def wind_n(self) -> float:
        """Mean force on each vehicle."""
        return self.scenario.wind.mean_n or 0.0


class Separation(Struct, frozen=True, kw_only=True):
    """Mean maximum gain over the kept flights of one wavelength and wind, by what was made of them."""

    wavelength_m: float
    wind_n: float
    flights: int
    ideal_dbi: float
    mean_dbi: dict[str, float]
    """By `VARIANTS`."""
    tilt_rms_deg: float
    """Of vehicles from the vertical."""
    turned_rms_deg: float
    """Of the whole formation about the vertical."""
    pointing_rms_deg: float
    """Of the maximum from the end-fire axis, as flown."""

    def loss_db(self, variant: str) -> float:
        """Less than ideal."""
        return self.ideal_dbi - self.mean_dbi[variant]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FigurePatterns:
    """Patterns of one flight on a fine grid."""

    seed: int
    time_s: float
    """Of the instant that has the flight's median maximum gain."""
    ideal: Pattern
    median: Pattern
    means: dict[str, Pattern]
    """Mean power density of the flight, by `VARIANTS`."""

    def readings(self) -> dict[str, PatternReading]:
        """Numbers of all of them: ``ideal``, ``median``, and the means by `VARIANTS`."""
        patterns = {"ideal": self.ideal, "median": self.median, **self.means}
        return {name: read_pattern(pattern, self.ideal) for name, pattern in patterns.items()}


def kept_flights(table: Table) -> Iterator[KeptFlight]:
    """Give the flights of a table that reached their formation and were kept, one at a time."""
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
    """Give the flight as it was, upright, and in place, by `VARIANTS`."""
    upright = np.zeros_like(flight.q_ned_frd)
    upright[..., 0] = np.cos(flight.heading_rad / 2.0)[:, None]
    upright[..., 3] = np.sin(flight.heading_rad / 2.0)[:, None]
    return {
        FLOWN: flight,
        UPRIGHT: replace(flight, q_ned_frd=upright),
        IN_PLACE: replace(flight, pos_ned_m=flight.desired_pos_ned_m),
    }


def tilts_rad(q_ned_frd: Array) -> Array:
    """(...,) angles between the vehicles' down axes and the vertical of (..., 4) attitudes."""
    x, y = q_ned_frd[..., 1], q_ned_frd[..., 2]
    return np.asarray(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))


def separate(
    flights: Sequence[KeptFlight], *, done: Callable[[int], None] = lambda _flights: None
) -> list[Separation]:
    """Solve every variant of every flight, and take means over those of one wavelength and wind.

    ``done`` is told how many flights are through.
    """
    groups: dict[tuple[float, float], list[_Solved]] = {}
    for number, kept in enumerate(flights, start=1):
        groups.setdefault((kept.scenario.antenna.wavelength_m, kept.wind_n), []).append(_solve(kept))
        done(number)
    return [_separation(wavelength_m, wind_n, group) for (wavelength_m, wind_n), group in groups.items()]


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """Numbers of one flight, over its instants and living vehicles."""

    ideal_dbi: float
    max_gain_dbi: dict[str, Array]
    tilts_rad: Array
    turned_rad: Array
    pointing_deg: Array


def _solve(kept: KeptFlight) -> _Solved:
    series = {
        name: gain_series(variant, kept.scenario.antenna) for name, variant in variants(kept.flight).items()
    }
    return _Solved(
        ideal_dbi=_ideal_dbi(kept.scenario),
        max_gain_dbi={name: each.max_gain_dbi for name, each in series.items()},
        tilts_rad=tilts_rad(kept.flight.q_ned_frd)[kept.flight.alive],
        turned_rad=formation_error(kept.flight).yaw_rad,
        pointing_deg=pointing_errors_deg(series[FLOWN].patterns, *MAIN_LOBE_DEG),
    )


def _separation(wavelength_m: float, wind_n: float, group: Sequence[_Solved]) -> Separation:
    gains = {name: np.concatenate([each.max_gain_dbi[name] for each in group]) for name in VARIANTS}
    return Separation(
        wavelength_m=wavelength_m, wind_n=wind_n, flights=len(group), ideal_dbi=group[0].ideal_dbi,
        mean_dbi={name: float(values.mean()) for name, values in gains.items()},
        tilt_rms_deg=math.degrees(_rms([each.tilts_rad for each in group])),
        turned_rms_deg=math.degrees(_rms([each.turned_rad for each in group])),
        pointing_rms_deg=_rms([each.pointing_deg for each in group]),
    )  # fmt: skip


def _ideal_dbi(scenario: Scenario) -> float:
    heading_rad = math.radians(scenario.formation.heading_deg)
    return ideal_pattern(scenario.places_ned_m(), heading_rad, scenario.antenna).max_gain_dbi


def _rms(parts: Sequence[Array]) -> float:
    return float(np.sqrt((np.concatenate(parts) ** 2).mean()))


def figure_flight(flights: Sequence[KeptFlight]) -> KeptFlight | None:
    """Give the first flight of the article's pattern's wavelength and wind; None if there is none."""
    wanted = (FIGURE_WAVELENGTH_M, FIGURE_WIND_N)
    return next(
        (each for each in flights if (each.scenario.antenna.wavelength_m, each.wind_n) == wanted), None
    )


def figure_patterns_of(kept: KeptFlight) -> FigurePatterns:
    """Solve one flight on a fine grid: its median instant, and the means of its variants."""
    scenario, means = kept.scenario, {}
    series = gain_series(kept.flight, scenario.antenna)
    heading_rad = math.radians(scenario.formation.heading_deg)
    ideal, median = figure_patterns(series, scenario.places_ned_m(), heading_rad, scenario.antenna)
    fine = structs.replace(scenario.antenna, grid_deg=min(scenario.antenna.grid_deg, FIGURE_GRID_DEG))
    for name, variant in variants(kept.flight).items():
        means[name] = _mean(gain_series(variant, scenario.antenna).snapshots, fine)
    return FigurePatterns(
        seed=scenario.run.seed, time_s=float(series.time_us[series.median_index]) / 1e6, ideal=ideal,
        median=median, means=means,
    )  # fmt: skip


def _mean(snapshots: Sequence[Snapshot], config: AntennaConfig) -> Pattern:
    running, backend = RunningEnvelope(), ""
    for first in range(0, len(snapshots), _AT_A_TIME):
        for pattern in compute_patterns(config, snapshots[first : first + _AT_A_TIME]):
            if isinstance(pattern, Pattern):
                running.add(pattern)
                backend = pattern.backend
    return mean_pattern(running.result(), backend)
