"""Judgement of the wind and antenna cases: checks, tables and figures."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

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
from studies.common.report import Check, ReportTable, Section

RATIO_LEAST = 5.0
"""Smallest ratio of the shape error with GPS alone to that with FTM"""
TIGHT_M, TIGHT_WIND_N = 5.0, 2.0
"""Wavelength and wind in which flights with FTM must be free of collisions"""
GAIN_BACK_LEAST = 0.9
"""Share of the gain lost with GPS alone (dB) that FTM must recover"""
TIGHT_COLLIDED_LEAST = 0.5
"""Share of flights at `TIGHT_M` that must collide with GPS alone; otherwise the case is not critical"""
Judge = Callable[[Book, Path | None], Section]


def judge_wind_agents(book: Book, images: Path | None) -> Section:
    """Compare GPS alone with FTM over wind and number of vehicles."""
    shape, safety = [], []
    for agents in AGENTS:
        for wind_n in WINDS_N:
            gps, ftm = (wind_agents(name, agents, wind_n) for name in ("gps", "ftm"))
            setting = (str(agents), f"{wind_n:g}")
            shape.append((
                *setting, book.mean(gps, "shape_m").text(2), book.mean(ftm, "shape_m").text(),
                book.ratio(gps, ftm, "shape_m").text(1), book.mean(ftm, "estimate_m").text(),
                book.mean(ftm, "control_m").text(), book.mean(gps, "absolute_m").text(2),
                book.mean(ftm, "absolute_m").text(2),
            ))  # fmt: skip
            safety.append((
                *setting, *(book.of_flights(book.formed(case), case) for case in (gps, ftm)),
                *(book.of_flights(book.collided(case), case) for case in (gps, ftm)),
                *(book.least(case, "least_distance_m") for case in (gps, ftm)),
                book.mean(ftm, "busy_fraction").text(1, factor=100.0),
                book.mean(ftm, "sessions_per_s").text(0),
                book.mean(ftm, "completed_fraction").text(1, factor=100.0),
            ))  # fmt: skip
    ratio = book.ratio(GPS_ALONE, BASE, "shape_m")
    ftm_cases = [wind_agents("ftm", agents, wind_n) for agents in AGENTS for wind_n in WINDS_N]
    ftm_cases = [case for case in ftm_cases if not case.last or book.begun(case)]
    drawn: tuple[tuple[str, str], ...] = ()
    if images is not None:
        figures.save_wind(
            images / "codesign-wind.png", WINDS_N,
            {
                agents: {
                    name: [book.mean(wind_agents(name, agents, wind_n), "shape_m") for wind_n in WINDS_N]
                    for name in ("gps", "ftm")
                }
                for agents in AGENTS
            },
        )  # fmt: skip
        shape_m, busy = (
            {
                name: [book.mean(wind_agents(name, agents, 5), what) for agents in AGENTS]
                for name in ("gps", "ftm")
            }
            for what in ("shape_m", "busy_fraction")
        )
        figures.save_agents(images / "codesign-agents.png", AGENTS, shape_m, busy)
        drawn = (
            ("codesign-wind.png", "shape error against wind, GPS alone and with FTM"),
            ("codesign-agents.png", "shape error and channel occupancy against the number of UAVs in 5 N"),
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
                name="shape error with FTM, 8 UAVs, 5 N, mean", value=book.mean(BASE, "shape_m").value,
                unit="m", at_most=SHAPE_MOST_M,
            ),
            Check(
                name="shape error with GPS alone over that with FTM, same case", value=ratio.value,
                at_least=RATIO_LEAST,
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
        figures=drawn,
    )  # fmt: skip


def judge_wavelength(book: Book, images: Path | None) -> Section:
    """Compare the antenna gain with GPS alone and with FTM."""
    rows = []
    for wavelength_m in WAVELENGTHS_M:
        for wind_n in (2, 5):
            for name in ("gps", "ftm"):
                case = wavelength(name, wavelength_m, wind_n)
                rows.append((
                    f"{wavelength_m:g}", f"{wind_n:g}", figures.LABELS[name], *_gain_cells(book, case),
                    book.of_flights(book.formed(case), case), book.of_flights(book.collided(case), case),
                    book.least(case, "least_distance_m"),
                ))  # fmt: skip
    tight, tight_gps = (wavelength(name, TIGHT_M, TIGHT_WIND_N) for name in ("ftm", "gps"))
    settings = [(wavelength_m, wind_n) for wavelength_m in WAVELENGTHS_M for wind_n in (2, 5)]
    ftm_cases = [wavelength("ftm", *setting) for setting in settings]
    gps_cases = [wavelength("gps", *setting) for setting in settings]
    drawn: tuple[tuple[str, str], ...] = ()
    if images is not None:
        figures.save_gains(
            images / "codesign-gain.png",
            {
                wavelength_m: {
                    (name, wind_n): _all_gains_dbi(book, wavelength(name, wavelength_m, wind_n))
                    for name in ("gps", "ftm")
                    for wind_n in (2, 5)
                }
                for wavelength_m in WAVELENGTHS_M
            },
            IDEAL_DBI,
        )
        drawn = (("codesign-gain.png", "densities of the maximum gain at λ = 5 and 10 m"),)
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
                name=f"λ = {TIGHT_M:g} m, {TIGHT_WIND_N:g} N, FTM: flights with a collision",
                value=_of_any(book, tight, book.collided), at_most=0.0,
            ),
            Check(
                name=f"λ = {TIGHT_M:g} m, {TIGHT_WIND_N:g} N, FTM: flights that did not form",
                value=_of_any(book, tight, lambda case: len(book.flown(case)) - book.formed(case)),
                at_most=0.0,
            ),
            Check(
                name=f"λ = {TIGHT_M:g} m, {TIGHT_WIND_N:g} N, GPS alone: share of flights with a collision",
                value=_of_any(book, tight_gps, book.collided) / max(len(book.flown(tight_gps)), 1),
                at_least=TIGHT_COLLIDED_LEAST,
            ),
            Check(
                name="share of the gain lost with GPS alone that FTM recovers, in dB, smallest",
                value=float(np.min([
                    _recovered(book, *cases) for cases in zip(gps_cases, ftm_cases, strict=True)
                ])),
                at_least=GAIN_BACK_LEAST,
            ),
        ),
        tables=(
            ReportTable(
                caption="Maximum gain, dBi (ideal formation: "
                f"{IDEAL_DBI:.2f}), and the gain expected for the position error. At λ = {TIGHT_M:g} m and "
                f"{TIGHT_WIND_N:g} N, {book.of_flights(book.collided(tight_gps), tight_gps)} flights with "
                "GPS alone have a collision.",
                columns=(
                    "λ m", "wind N", "positions by", "mean max gain dBi", "std dB", "σ horizontal m",
                    "σ vertical m", "σ/λ", "expected for σ/λ dBi", "formed", "collided", "nearest m",
                ),
                rows=tuple(rows),
            ),
        ),
        figures=drawn,
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


def _all_gains_dbi(book: Book, case: CodesignCase) -> list[float]:
    return [gain_dbi for flight in book.flown(case) for gain_dbi in flight.gain_dbi]
