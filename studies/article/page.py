"""Page that compares the article's results with ours: flights, tables, figures and verdicts."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from msgspec import Struct

from studies.article import figures
from studies.article.campaign_data import Cell
from studies.article.comparison import DECIDED_ERRORS
from studies.article.evidence import Evidence
from studies.article.gain_findings import SHORT_M
from studies.article.monte_carlo import Drawn
from studies.article.patterns import LEVEL_DBI
from studies.article.plan import (
    ARTICLE,
    CHANGES,
    CROWDED,
    CROWDED_FTM_PERIOD_S,
    MEANINGS,
    QUICK,
    UNCROWDED,
    ArticlePlan,
)
from studies.article.retained_flights import VARIANTS, FigurePatterns
from studies.article.setup_findings import IDEAL_DBI
from studies.article.statements import Judged, StatementVerdict, count
from studies.common.command_line import repeated_command
from studies.common.report import WIDTH, ReportFigure, ReportTable, Section, filled, flights_introduction

TITLE = "The article reproduced"
FILE_NAME, CSV_NAME = "article.md", "article-gains.csv"
_NONE = "–"
_SHOWN = {
    StatementVerdict.AGREES: "yes", StatementVerdict.DIFFERS: "**no**",
    StatementVerdict.OPEN: "undecided", StatementVerdict.UNKNOWN: "not measured",
}  # fmt: skip


class Results(Struct, frozen=True, kw_only=True):
    """Content of the page."""

    plan: ArticlePlan
    evidence: Evidence
    judged: Sequence[Judged]
    figure: FigurePatterns | None
    broken: Sequence[str] = ()
    """One line for each failed flight."""


def command(plan: ArticlePlan, *, quick: bool) -> str:
    """Return the command that generates the page, without folders."""
    usual = QUICK if quick else ArticlePlan()
    return repeated_command(
        "reproduce_article.py",
        ("--quick", quick),
        (f"--seeds {plan.seeds}", plan.seeds != usual.seeds),
        (f"--duration {plan.duration_s:g}", plan.duration_s != usual.duration_s),
    )


def introduction(results: Results, *, quick: bool) -> str:
    """Return the introduction: command, flights and verdicts."""
    plan, cells = results.plan, list(results.evidence.cells.values())
    flights, completed = (sum(getattr(cell, what) for cell in cells) for what in ("flights", "completed"))
    found = count(results.judged)
    agrees, differs = found[StatementVerdict.AGREES], found[StatementVerdict.DIFFERS]
    undecided, unmeasured = found[StatementVerdict.OPEN], found[StatementVerdict.UNKNOWN]
    text = (
        "This page compares the statements of Calvo-Fullana, Pyattaev, Mox, Andreev and Ribeiro, "
        '"Communications and Robotics Simulation in UAVs: A Case Study on Aerial Synthetic Aperture '
        f'Antenna", with our results. {completed} of {flights} flights of `scenarios/article.toml` and its '
        f"variants completed: {plan.seeds} of each wavelength in each wind, {plan.duration_s:g} s in "
        f"formation, with a pattern every 0.1 s. Verdicts on the {len(results.judged)} statements: {agrees} "
        f"hold, {differs} do not hold, {undecided} undecided, {unmeasured} not measured. "
        "The criteria are in the source code. They were fixed before these flights, but after some related "
        "results had been published; these are listed below. The same sources and seeds give the same "
        "numbers."
    )
    return flights_introduction(command(plan, quick=quick), text, results.broken)


def sections(results: Results) -> list[Section]:
    """Return all sections in the order of the page."""
    found = [
        _statements_section(results.judged), _gains_section(results), _pattern_section(results),
        _separation_section(results.evidence), _changes_section(results.evidence),
    ]  # fmt: skip
    crowded = [c for case in (CROWDED, UNCROWDED) for c in _of_case(results.evidence.cells.values(), case)]
    return [*found, _crowded_section(crowded)] if crowded else found


def _statements_section(judged: Sequence[Judged]) -> Section:
    rows = tuple((each.name, each.said, each.criterion, each.found, _SHOWN[each.verdict]) for each in judged)
    why = {
        title: [f"- {each.said} {each.why}" for each in judged if each.verdict is verdict]
        for verdict, title in (
            (StatementVerdict.DIFFERS, "Statements that do not hold:"),
            (StatementVerdict.OPEN, "Undecided statements:"),
        )
    }
    errors = (
        "Standard errors (±) are over the flights, by the jackknife over seeds. Cells are compared over "
        "their common seeds, because flights with the same seed have the same wind. A statement is "
        f"undecided if a number is within {DECIDED_ERRORS:g} standard errors of its bound. Numbers of the "
        "pattern are of one flight, as in the article; the verdicts on them use all retained flights of "
        "that pattern."
    )
    parts = [errors]
    for title, lines in why.items():
        if lines:
            parts += [title, "\n".join(map(_bullet, lines))]
    earlier: dict[str, list[str]] = {}
    for each in judged:
        if each.known:
            earlier.setdefault(each.known, []).append(each.name)
    if earlier:
        parts += [
            "Related results from before the criteria were fixed:",
            "\n".join(_bullet(f"- {', '.join(names)}: {known}") for known, names in earlier.items()),
        ]
    return Section(
        title="Statement by statement", conditions=_paragraphs(*parts),
        checks=(),
        tables=(ReportTable(
            caption="Statements of the article, paraphrased; their criteria; our results; agreement.",
            columns=("name", "the article states", "criterion", "result", "agrees"), rows=rows,
        ),),
    )  # fmt: skip


def _gains_section(results: Results) -> Section:
    cells = _of_case(results.evidence.cells.values(), ARTICLE)
    return Section(
        title="Maximum gain by wavelength and wind (the article's figure 3)",
        conditions=_paragraphs(
            "The maximum over all directions of the pattern of the true positions and attitudes, at all "
            "instants of all flights in formation. Quantiles, deviation and peak refer to these values; the "
            "peak is the highest probability density with Gaussian kernels of Scott's width; between is the "
            "deviation of the flights' means. Shape is the rms distance of the UAVs from the desired "
            "formation after the best alignment, σ the deviation per horizontal axis of independent errors "
            "with the same rms. Missing are the instants at which two antennas touched. "
            f"[{CSV_NAME}]({CSV_NAME}) contains these values and those of the changes below."
        ),
        checks=(), tables=(_cells_table(cells, "Gains in dBi."),),
        figures=(
            ReportFigure(
                "article-figure3.png",
                "densities of the maximum gain by wavelength: 5 N (top), 2 N, without wind",
                partial(figures.save_densities, cells=results.evidence.cells, ideal_dbi=IDEAL_DBI),
            ),
            ReportFigure(
                "article-wind.png", "mean and deviation of the maximum gain against wind",
                partial(figures.save_wind, cells=cells, ideal_dbi=IDEAL_DBI),
            ),
        ),
    )  # fmt: skip


def _cells_table(cells: Iterable[Cell], caption: str, *, case: bool = False) -> ReportTable:
    columns = (
        "λ m", "wind N", "flights", "collided", "instants", "missing", "mean", "std", "between", "5 %",
        "median", "95 %", "peak 1/dB", "shape m", "σ m", "σ/λ", "channel busy %",
    )  # fmt: skip
    rows = []
    for cell in cells:
        found, sigma_m = cell.statistics, cell.sigma_m
        quantiles = [found.quantiles_dbi[q] if found else None for q in (0.05, 0.5, 0.95)]
        row = (
            f"{cell.wavelength_m:g}", f"{cell.wind_n:g}", f"{cell.completed} of {cell.flights}",
            str(cell.collided), str(len(cell.max_gain_dbi)), str(cell.missing),
            _text(found.mean_dbi if found else None, 2), _text(found.std_db if found else None, 3),
            _text(cell.between_flights_db, 3),
            *(_text(each, 2) for each in quantiles), _text(cell.peak_per_db, 1), _text(cell.shape_m, 3),
            _text(sigma_m, 3), _text(None if sigma_m is None else sigma_m / cell.wavelength_m, 4),
            _text(None if cell.busy_fraction is None else 100.0 * cell.busy_fraction, 1),
        )  # fmt: skip
        rows.append((cell.case, *row) if case else row)
    return ReportTable(caption=caption, columns=("case", *columns) if case else columns, rows=tuple(rows))


def _pattern_section(results: Results) -> Section:
    title = "The pattern in 5 N at λ = 10 m (the article's figure 4)"
    if results.figure is None:
        return Section(title=title, conditions="No flight of this case was retained.\n", checks=())
    names = {
        "ideal": "ideal", "median": "median instant", "flown": "mean of the flight",
        "upright": "mean, UAVs upright at flown positions",
        "in place": "mean, UAVs in their places, tilted as flown",
    }  # fmt: skip
    rows = tuple(
        (
            name, f"{found.max_gain_dbi:.2f}", f"{found.effective_lobe_sr:.3f}", f"{found.lobe_sr:.3f}",
            f"{found.asymmetry_db:.2f}", f"{100.0 * found.lower_share:.0f}", f"{found.difference_db:.2f}",
            f"{found.region_dbi:.2f}", f"{found.region_max_dbi:.2f}", f"{found.region_colour_db:.2f}",
            f"{100.0 * found.region_lower_share:.0f}", f"{found.mean_dbi:.2f}",
        )
        for key, name in names.items()
        if (found := results.evidence.patterns.get(key)) is not None
    )  # fmt: skip
    return Section(
        title=title,
        conditions=_paragraphs(
            f"Flight of seed {results.figure.seed}, with its median maximum gain at "
            f"{results.figure.time_s:.1f} s after the start. The mean is that of the power density over the "
            "flight. The effective lobe is the solid angle around the maximum above half of the ideal "
            "maximum, the own lobe that above half of the pattern's own maximum. Asymmetry is the rms "
            f"difference from the mirror image in x, with gains below {LEVEL_DBI:g} dBi set to that value; "
            "lower is the share of directions with less than the ideal gain, of those with an ideal gain "
            "above that value. By colour is the mean of the region's gain in decibels, at least -30. The "
            "region is φ 180° to 225°, θ 0° to 45°, dashed in the figures: upwind and up, because the wind "
            "blows towards φ 45° and the UAVs tilt against it."
        ),
        checks=(),
        tables=(ReportTable(
            caption="Solid angles in sr, gains in dBi, differences in dB rms.",
            columns=("pattern", "maximum", "effective lobe", "own lobe", "asymmetry", "lower %",
                     "from ideal", "region", "region's highest", "by colour", "lower there %",
                     "over all directions"),
            rows=rows,
        ), *_leaning_tables(results.evidence)),
        figures=(
            ReportFigure(
                "article-figure4.png",
                "ideal pattern and pattern of the median instant; the main lobe is outlined in black",
                partial(figures.save_patterns, patterns=results.figure),
            ),
            ReportFigure(
                "article-figure4-mean.png", "ideal pattern and mean pattern of the flight",
                partial(figures.save_patterns, patterns=results.figure, mean=True),
            ),
        ),
    )  # fmt: skip


def _leaning_tables(evidence: Evidence) -> tuple[ReportTable, ...]:
    """Return the table of the article's region by wind direction, if it was solved."""
    if not evidence.leaning:
        return ()
    rows = tuple(
        (f"{phi_deg:g}", f"{found.region_dbi:.2f}", f"{found.region_colour_db:.2f}",
         f"{100.0 * found.region_lower_share:.0f}", f"{found.max_gain_dbi:.2f}")
        for phi_deg, found in evidence.leaning.items()
    )  # fmt: skip
    return (ReportTable(
        caption="The same region with all UAVs in their places, tilted by the flights' rms tilt against a "
        "wind that blows towards φ: gains in dBi.",
        columns=("wind towards φ °", "region", "by colour", "lower there %", "maximum"), rows=rows,
    ),)  # fmt: skip


def _separation_section(evidence: Evidence) -> Section:
    rows = tuple(
        (
            f"{each.wavelength_m:g}", f"{each.wind_n:g}", str(len(each.seeds)),
            *(f"{each.loss_db(name):.3f}" for name in VARIANTS),
            f"{each.tilt_rms_deg:.1f}", f"{each.turned_rms_deg:.2f}", f"{each.pointing_rms_deg:.2f}",
        )
        for each in sorted(evidence.separations, key=lambda each: (each.wavelength_m, each.wind_n))
    )  # fmt: skip
    return Section(
        title="Losses due to position errors and tilt",
        conditions=_paragraphs(
            "Some flights were solved again with upright vehicles at their flown positions, and with "
            "vehicles in their places with their flown tilt. Turned is the rotation of the formation about "
            "the vertical; pointing is the angle of the maximum from +y."
        ),
        checks=(),
        tables=(ReportTable(
            caption="Loss of the mean maximum gain from the ideal one, dB; angles in degrees rms.",
            columns=("λ m", "wind N", "flights", "as flown", "upright", "in place, tilted", "tilt", "turned",
                     "pointing"),
            rows=rows,
        ),),
    )  # fmt: skip


def _changes_section(evidence: Evidence) -> Section:
    cells = [cell for name in CHANGES for cell in _of_case(evidence.cells.values(), name)]
    meanings = "\n".join(f"- `{name}`: {MEANINGS[name]}" for name in (ARTICLE, *CHANGES))
    return Section(
        title="Errors that would explain the article's densities",
        conditions=_paragraphs(
            "The article does not state the position errors of its UAVs. Random formations with independent "
            "errors of σ on each axis show which σ its densities imply; flights with other position sources, "
            "controls, sensors and gusts show which causes would lead to it.",
            meanings,
        ),
        checks=(),
        tables=(
            _drawn_table(evidence.drawn),
            _cells_table(cells, "Flights with changes; gains in dBi. Fallen UAVs are included.", case=True),
        ),
        figures=(
            ReportFigure(
                "article-changes.png", "densities in 5 N by change of the scenario",
                partial(figures.save_changes, cells=evidence.cells, ideal_dbi=IDEAL_DBI),
            ),
            ReportFigure(
                "article-sigma.png", "maximum gain against position error: random formations and flights",
                partial(figures.save_sigma, drawn=evidence.drawn, cells=evidence.cells.values()),
            ),
        ),
    )  # fmt: skip


def _drawn_table(drawn: Mapping[tuple[float, float], Drawn]) -> ReportTable:
    wavelengths_m = sorted({wavelength_m for _, wavelength_m in drawn})
    rows = []
    for sigma_m in sorted({sigma_m for sigma_m, _ in drawn}):
        found = [drawn[sigma_m, wavelength_m] for wavelength_m in wavelengths_m]
        gains = [f"{each.statistics.mean_dbi:.2f} ± {each.statistics.std_db:.2f}" for each in found]
        rows.append((f"{sigma_m:g}", *gains, _text(drawn[sigma_m, SHORT_M].peak_per_db, 2)))
    return ReportTable(
        caption="Random formations, upright: maximum gain in dBi, and the peak of the density of λ = 5 m, "
        "1/dB.",
        columns=("σ m", *(f"λ {each:g} m" for each in wavelengths_m), "peak at 5 m"), rows=tuple(rows),
    )  # fmt: skip


def _crowded_section(cells: Sequence[Cell]) -> Section:
    return Section(
        title="A full channel",
        conditions=_paragraphs(
            f"`{CROWDED}`: {MEANINGS[CROWDED]}, every {CROWDED_FTM_PERIOD_S:g} s. "
            f"`{UNCROWDED}`: {MEANINGS[UNCROWDED]}."
        ),
        checks=(), tables=(_cells_table(cells, "Gains in dBi.", case=True),),
    )  # fmt: skip


def _of_case(cells: Iterable[Cell], case: str) -> list[Cell]:
    found = [cell for cell in cells if cell.case == case]
    return sorted(found, key=lambda cell: (cell.wavelength_m, cell.wind_n))


def _text(value: float | None, digits: int) -> str:
    return _NONE if value is None else f"{value:.{digits}f}"


def _bullet(line: str) -> str:
    return textwrap.fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False)


def _paragraphs(*parts: str) -> str:
    """Join paragraphs and lists; paragraphs are wrapped."""
    return "\n\n".join(part if part.startswith("- ") else filled(part) for part in parts) + "\n"
