"""Judgement of the wind and antenna cases: checks, tables and figures."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product

import numpy as np

from studies.codesign import figures
from studies.codesign.book import Book
from studies.codesign.cases import (
    AGENTS,
    BASE,
    GPS_ALONE,
    WAVELENGTHS_M,
    WINDS_N,
    CodesignCase,
    wavelength,
    wind_agents,
)
from studies.codesign.checks import SHAPE_MOST_M, formed_check, largest_shape_check, pairs_check, sound_checks
from studies.codesign.sensitivity import IDEAL_DBI, expected_gain, per_axis_sigma_m, vertical_sigma_m
from studies.common.report import Check, ReportFigure, ReportTable, Section

POSITIONS = ("gps", "ftm")
WINDY_N = (2, 5)
RATIO_LEAST = 5.0
"""Smallest ratio of the shape error with GPS alone to that with FTM"""
TIGHT_M, TIGHT_WIND_N = 5.0, 2.0
"""Wavelength and wind in which flights with FTM must be free of collisions"""
GAIN_BACK_LEAST = 0.9
"""Share of the gain lost with GPS alone (dB) that FTM must recover"""
TIGHT_COLLIDED_LEAST = 0.5
"""Share of flights at `TIGHT_M` that must collide with GPS alone; otherwise the case is not critical"""
Judge = Callable[[Book], Section]


def judge_wind_agents(book: Book) -> Section:
    """Compare GPS alone with FTM over wind and number of vehicles."""
    shape, safety = [], []
    for agents, wind_n in product(AGENTS, WINDS_N):
        gps, ftm = (wind_agents(name, agents, wind_n) for name in POSITIONS)
        setting = (str(agents), f"{wind_n:g}")
        shape.append((
            *setting, book.mean(gps, "shape_m").text(2), book.cell(ftm, "shape m"),
            book.ratio(gps, ftm, "shape_m").text(1), book.cell(ftm, "estimates m"),
            book.cell(ftm, "control m"), book.mean(gps, "absolute_m").text(2),
            book.mean(ftm, "absolute_m").text(2),
        ))  # fmt: skip
        safety.append((
            *setting, *(book.of_flights(count, case) for count in (book.formed, book.collided)
                        for case in (gps, ftm)),
            *(book.least(case, "least_distance_m") for case in (gps, ftm)),
            *(book.cell(ftm, column) for column in ("busy %", "sessions/s", "completed %")),
        ))  # fmt: skip
    ratio = book.ratio(GPS_ALONE, BASE, "shape_m")
    ftm_cases = [wind_agents("ftm", *setting) for setting in product(AGENTS, WINDS_N)]
    ftm_cases = [case for case in ftm_cases if not case.last or book.begun(case)]
    by_wind = {
        agents: {
            name: [book.mean(wind_agents(name, agents, wind_n), "shape_m") for wind_n in WINDS_N]
            for name in POSITIONS
        }
        for agents in AGENTS
    }
    shape_m, busy = (
        {name: [book.mean(wind_agents(name, agents, 5), what) for agents in AGENTS] for name in POSITIONS}
        for what in ("shape_m", "busy_fraction")
    )
    return Section(
        title="GPS alone against ranging: wind and number of UAVs",
        conditions=(
            "The article's scenario with other winds (mean force on each UAV, with gusts) and numbers of "
            "UAVs, in two rows. Shape is the horizontal error of the true positions relative to the "
            "desired ones after the best rigid alignment, rms over UAVs and time in formation. It ends "
            "when two UAVs touch or one falls, which favours the case with collisions. The ratio is that "
            "of the means, with a paired bootstrap over the seeds. Estimates is the error of the UAVs' own "
            "position estimates relative to the true positions after alignment, control that of the same "
            "estimates relative to the desired positions.\n"
        ),
        checks=(
            formed_check(book, (GPS_ALONE, *(case for case in ftm_cases if not case.last))),
            *sound_checks(book, ftm_cases),
            pairs_check("GPS alone and FTM", ratio.count),
            Check(
                "shape error with FTM, 8 UAVs, 5 N, mean", book.mean(BASE, "shape_m").value, "m",
                at_most=SHAPE_MOST_M,
            ),
            Check(
                "shape error with GPS alone over that with FTM, same case", ratio.value, at_least=RATIO_LEAST
            ),
            largest_shape_check(book, ftm_cases, "all flown winds and numbers of UAVs"),
        ),
        tables=(
            ReportTable(
                caption="Horizontal rms, m: mean and 95 % confidence interval over the flights.",
                columns=(
                    "UAVs", "wind N", "GPS: shape", "FTM: shape", "ratio", "FTM: estimates",
                    "FTM: control", "GPS: absolute", "FTM: absolute",
                ),
                rows=tuple(shape),
            ),
            ReportTable(
                caption="Flights that formed, flights that collided, the smallest distance of two airborne "
                "UAVs in any flight, and the channel load with FTM.",
                columns=(
                    "UAVs", "wind N", "GPS: formed", "FTM: formed", "GPS: collided", "FTM: collided",
                    "GPS: nearest m", "FTM: nearest m", "busy %", "sessions/s", "completed %",
                ),
                rows=tuple(safety),
            ),
        ),
        figures=(
            ReportFigure(
                "codesign-wind.png", "shape error against wind, GPS alone and with FTM",
                partial(figures.save_wind, winds_n=WINDS_N, shape_m=by_wind),
            ),
            ReportFigure(
                "codesign-agents.png",
                "shape error and channel occupancy against the number of UAVs in 5 N",
                partial(figures.save_agents, agents=AGENTS, shape_m=shape_m, busy=busy),
            ),
        ),
    )  # fmt: skip


def judge_wavelength(book: Book) -> Section:
    """Compare the antenna gain with GPS alone and with FTM."""
    rows = []
    for wavelength_m, wind_n, name in product(WAVELENGTHS_M, WINDY_N, POSITIONS):
        case = wavelength(name, wavelength_m, wind_n)
        rows.append((
            f"{wavelength_m:g}", f"{wind_n:g}", figures.LABELS[name], *_gain_cells(book, case),
            book.of_flights(book.formed, case), book.of_flights(book.collided, case),
            book.least(case, "least_distance_m"),
        ))  # fmt: skip
    tight_gps, tight = (wavelength(name, TIGHT_M, TIGHT_WIND_N) for name in POSITIONS)
    gps_cases, ftm_cases = (
        [wavelength(name, *setting) for setting in product(WAVELENGTHS_M, WINDY_N)] for name in POSITIONS
    )
    gains_dbi: figures.Gains = {
        wavelength_m: {
            (name, wind_n): [
                gain
                for flight in book.flown(wavelength(name, wavelength_m, wind_n))
                for gain in flight.gain_dbi
            ]
            for name, wind_n in product(POSITIONS, WINDY_N)
        }
        for wavelength_m in WAVELENGTHS_M
    }
    return Section(
        title="The antenna at two wavelengths",
        conditions=(
            "8 UAVs whose spacing scales with the wavelength: at 5 m the rows are 1.25 m apart. The "
            "maximum gain over all directions is computed from the true positions and attitudes every "
            "second in formation, until two UAVs touch or one falls: the table contains the mean of the "
            "flights' means with its confidence interval, and the standard deviation within a flight. σ is "
            "the standard deviation per axis of independent errors with the same rms as in flight (the "
            "alignment removes 3 of 16 horizontal degrees of freedom). The expected gain is that of "
            "independent Gaussian errors of this σ on every axis, interpolated in σ/λ between the points "
            "of `studies/reference/antenna_sensitivity.csv`. The errors in flight are neither independent "
            "nor Gaussian, vertical errors differ from horizontal ones, and the dipoles tilt with their "
            "UAVs against the wind, which costs gain without any position error.\n"
        ),
        checks=(
            formed_check(book, ftm_cases),
            *sound_checks(book, ftm_cases),
            Check(
                f"λ = {TIGHT_M:g} m, {TIGHT_WIND_N:g} N, FTM: flights with a collision",
                _of_any(book, tight, book.collided), at_most=0.0,
            ),
            Check(
                f"λ = {TIGHT_M:g} m, {TIGHT_WIND_N:g} N, FTM: flights that did not form",
                _of_any(book, tight, lambda case: len(book.flown(case)) - book.formed(case)), at_most=0.0,
            ),
            Check(
                f"λ = {TIGHT_M:g} m, {TIGHT_WIND_N:g} N, GPS alone: share of flights with a collision",
                _of_any(book, tight_gps, book.collided) / max(len(book.flown(tight_gps)), 1),
                at_least=TIGHT_COLLIDED_LEAST,
            ),
            Check(
                "share of the gain lost with GPS alone that FTM recovers, in dB, smallest",
                float(np.min([
                _recovered(book, *cases) for cases in zip(gps_cases, ftm_cases, strict=True)
                ])),
                at_least=GAIN_BACK_LEAST,
            ),
        ),
        tables=(
            ReportTable(
                caption="Maximum gain, dBi (ideal formation: "
                f"{IDEAL_DBI:.2f}), and the gain expected for the position error. At λ = {TIGHT_M:g} m and "
                f"{TIGHT_WIND_N:g} N, {book.of_flights(book.collided, tight_gps)} flights with "
                "GPS alone have a collision.",
                columns=(
                    "λ m", "wind N", "positions by", "mean max gain dBi", "std dB", "σ horizontal m",
                    "σ vertical m", "σ/λ", "expected for σ/λ dBi", "formed", "collided", "nearest m",
                ),
                rows=tuple(rows),
            ),
        ),
        figures=(
            ReportFigure(
                "codesign-gain.png", "densities of the maximum gain at λ = 5 and 10 m",
                partial(figures.save_gains, gains_dbi=gains_dbi, ideal_dbi=IDEAL_DBI),
            ),
        ),
    )  # fmt: skip


def _of_any(book: Book, case: CodesignCase, count: Callable[[CodesignCase], int]) -> float:
    """Count flights; NaN if there are none."""
    return float(count(case)) if book.flown(case) else math.nan


def _recovered(book: Book, gps: CodesignCase, ftm: CodesignCase) -> float:
    """Return the share of the gain lost with GPS alone that FTM recovers; NaN if a gain is missing."""
    gps_dbi, ftm_dbi = (book.mean(case, "gain_mean_dbi").value for case in (gps, ftm))
    return (ftm_dbi - gps_dbi) / (IDEAL_DBI - gps_dbi) if gps_dbi < IDEAL_DBI else math.nan


def _gain_cells(book: Book, case: CodesignCase) -> tuple[str, ...]:
    """Return gain, deviation, sigmas, their ratio to the wavelength and the expected gain, as text."""
    sigma_m = _pooled_sigma(book.values(case, "shape_m"), case.agents, per_axis_sigma_m)
    vertical_m = _pooled_sigma(book.values(case, "vertical_m"), case.agents, vertical_sigma_m)
    gains = book.mean(case, "gain_mean_dbi").text(2), book.mean(case, "gain_std_db").text(2)
    if sigma_m is None or vertical_m is None:
        return (*gains, "–", "–", "–", "–")
    expected = expected_gain(sigma_m, case.wavelength_m)
    return (
        *gains, f"{sigma_m:.3f}", f"{vertical_m:.3f}", f"{sigma_m / case.wavelength_m:.3f}",
        f"{expected.mean_dbi:.2f} ± {expected.std_db:.2f}",
    )  # fmt: skip


def _pooled_sigma(
    rms_m: Sequence[float | None], vehicles: int, sigma: Callable[[float, int], float]
) -> float | None:
    """Return the sigma that corresponds to the mean square over the flights; None without a flight."""
    known = [each for each in rms_m if each is not None]
    return sigma(float(np.sqrt(np.mean(np.square(known)))), vehicles) if known else None
