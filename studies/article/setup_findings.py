"""Statements on the formation and its radio."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from antenna.analysis.statistics import pointing_errors_deg
from antenna.solvers.ports import MAIN_LOBE_DEG
from studies.article import plan
from studies.article.campaign_data import Cell
from studies.article.comparison import ComparedEstimate, has_shape, jackknife, shape_m
from studies.article.evidence import Evidence, Missing
from studies.article.finding import Finding, by_margins
from studies.article.monte_carlo import BACKENDS

IDEAL_DBI, IDEAL_WITHIN_DB = 13.26, 0.01
AXIS_WITHIN_DEG = 1.0
BAND_MHZ = {5.0: 60, 20.0: 15}
SESSIONS_SHARE = 0.99
FTM_SHARE = 0.5
CROWDED_GROWTH = 1.1
EXPONENTIAL_SHARE, EXPONENTIAL_WITHIN_DB = 0.4, 0.2
"""A decrease linear in the error or its variance deviates by more than this from every exponential."""


def main_lobe_along_y(evidence: Evidence) -> Finding:
    """Measure the direction of the ideal maximum."""
    errors_deg = {
        name: float(pointing_errors_deg(list(found.values()), *MAIN_LOBE_DEG).max())
        for name, found in evidence.ideals.items()
        if found
    }
    others = [name for name, error_deg in errors_deg.items() if error_deg > AXIS_WITHIN_DEG]
    said = "at most " + ", ".join(f"{error:.2f}° from it ({name})" for name, error in errors_deg.items())
    return _by_every_solver(errors_deg, said, others)


def ideal_gain(evidence: Evidence) -> Finding:
    """Measure the ideal maximum by every solver."""
    gains = {
        name: [each.max_gain_dbi for each in found.values()]
        for name, found in evidence.ideals.items()
        if found
    }
    others = [
        name for name, found in gains.items() if max(abs(g - IDEAL_DBI) for g in found) > IDEAL_WITHIN_DB
    ]
    said = "; ".join(f"{name} {min(found):.3f} to {max(found):.3f} dBi" for name, found in gains.items())
    return _by_every_solver(gains, said, others)


def _by_every_solver(solved: Mapping[str, object], said: str, others: Sequence[str]) -> Finding:
    """Judge a criterion for every solver; raises Missing if one is not installed and the others agree."""
    absent = [name for name in BACKENDS if name not in solved]
    if not solved or (absent and not others):
        raise Missing(f"{', '.join(absent)} not installed{f'; {said}' if solved else ''}")
    return Finding(found=said, agrees=not others, why=f"{', '.join(others)}: outside the criterion.")


def band(evidence: Evidence) -> Finding:
    """Measure the frequencies of the shortest and the longest wavelength."""
    absent = [f"{each:g}" for each in BAND_MHZ if each not in evidence.frequencies_mhz]
    if absent:
        raise Missing(f"λ {', '.join(absent)} m: not flown")
    found = {each: evidence.frequencies_mhz[each] for each in BAND_MHZ}
    others = [f"λ {each:g} m" for each, mhz in found.items() if round(mhz) != BAND_MHZ[each]]
    return Finding(
        found=", ".join(f"λ {each:g} m {mhz:.2f} MHz" for each, mhz in found.items()), agrees=not others,
        why=f"{', '.join(others)}: another frequency.",
    )  # fmt: skip


def exponential_loss(evidence: Evidence) -> Finding:
    """Compare the mean gain of random formations with exponentials in the variance of the position error."""
    variances, losses_db, errors_db, along_db, coherent_db = [], [], [], [], []
    rest = min((drawn.axis_gain for drawn in evidence.drawn.values()), default=0.0)
    for (sigma_m, wavelength_m), drawn in sorted(evidence.drawn.items()):
        ideal_dbi = evidence.ideal_dbi(wavelength_m)
        loss_db = ideal_dbi - 10.0 * math.log10(drawn.mean_gain)
        if loss_db <= -10.0 * math.log10(EXPONENTIAL_SHARE) and drawn.axis_gain > rest:
            variances.append((2.0 * math.pi * sigma_m / wavelength_m) ** 2)
            losses_db.append(loss_db)
            errors_db.append(10.0 / math.log(10.0) * drawn.mean_gain_error / drawn.mean_gain)
            along_db.append(ideal_dbi - 10.0 * math.log10(drawn.axis_gain))
            ideal = 10.0 ** (ideal_dbi / 10.0)
            coherent_db.append(-10.0 * math.log10((drawn.axis_gain - rest) / (ideal - rest)))
    if len(variances) < 3:
        raise Missing(f"fewer than three drawn errors keep {EXPONENTIAL_SHARE:.0%} of the gain")
    rate, off_db, worst = _exponential(variances, losses_db)
    along_rate, along_off_db, _ = _exponential(variances, along_db)
    coherent_rate, coherent_off_db, _ = _exponential(variances, coherent_db)
    ratio = math.sqrt(variances[worst]) / (2.0 * math.pi)
    margin = ComparedEstimate(value=EXPONENTIAL_WITHIN_DB - off_db, error=errors_db[worst], flights=0)
    why = []
    if along_db[worst] > losses_db[worst]:
        why.append(
            f"There the loss is {losses_db[worst]:.2f} dB, and {along_db[worst]:.2f} dB in the direction of "
            "the ideal maximum: errors favour other directions."
        )
    if coherent_off_db < along_off_db:
        why.append(
            f"In that direction {10.0 * math.log10(rest):.2f} dBi remain with the largest drawn error; the "
            f"gain above them is within {coherent_off_db:.2f} dB of exp(-{coherent_rate:.2f} (2π σ/λ)²)."
        )
    return by_margins(
        {f"σ/λ {ratio:.3f}": margin},
        found=f"up to σ/λ {math.sqrt(max(variances)) / (2.0 * math.pi):.3f}, with a loss of "
        f"{max(losses_db):.2f} dB, within {off_db:.2f} dB of exp(-{rate:.2f} (2π σ/λ)²); the gain in the "
        f"direction of the ideal maximum within {along_off_db:.2f} dB of exp(-{along_rate:.2f} (2π σ/λ)²)",
        why=" ".join(why),
    )  # fmt: skip


def _exponential(variances: Sequence[float], losses_db: Sequence[float]) -> tuple[float, float, int]:
    """Fit an exponential by least squares in decibels; return rate, largest deviation and its index."""
    variance, loss_db = np.array(variances), np.array(losses_db)
    slope_db = float((variance * loss_db).sum() / (variance**2).sum())
    off_db = np.abs(loss_db - slope_db * variance)
    return slope_db * math.log(10.0) / 10.0, float(off_db.max()), int(off_db.argmax())


def distances_to_all(evidence: Evidence) -> Finding:
    """Measure the share of completed ranging sessions in the article's flights."""
    cells = [cell for (case, _, _), cell in evidence.cells.items() if case == plan.ARTICLE]
    requested = sum(cell.ftm_requested for cell in cells)
    if not requested:
        raise Missing("no session was requested")
    seeds = sorted({each.seed for cell in cells for each in cell.runs if each.ftm_requested})

    def share(kept: Sequence[int]) -> float:
        of_kept = [cell.of(kept) for cell in cells]
        return sum(cell.ftm_completed for cell in of_kept) / sum(cell.ftm_requested for cell in of_kept)

    found = jackknife(seeds, share)
    error_m = [cell.ftm_error_std_m for cell in cells if cell.ftm_error_std_m is not None]
    error = f"; standard deviation {np.sqrt(np.square(error_m).mean()):.3f} m" if error_m else ""
    margin = ComparedEstimate(value=found.value - SESSIONS_SHARE, error=found.error, flights=found.flights)
    return by_margins(
        {"share of the sessions": margin}, found=f"{found.value:.2%} of {requested} sessions{error}", unit="",
        why="The others fail on the channel or because their peer is busy.",
    )  # fmt: skip


def ftm_corrects_gps(evidence: Evidence) -> Finding:
    """Compare the shape errors with and without ranging at λ 10 m for the same seeds."""
    margins, words = {}, []
    for wind_n in evidence.winds_n:
        keys = [(case, plan.FIGURE_WAVELENGTH_M, wind_n) for case in (plan.ARTICLE, plan.GPS)]
        if keys[1] not in evidence.cells:
            continue
        margins[f"{wind_n:g} N"] = evidence.shape(
            keys, lambda ftm, gps: FTM_SHARE * shape_m(gps) - shape_m(ftm)
        )
        ratio = evidence.shape(keys, lambda ftm, gps: shape_m(ftm) / shape_m(gps))
        ftm, gps = (evidence.shape(keys, lambda *cells, k=k: shape_m(cells[k])) for k in (0, 1))
        words.append(
            f"{wind_n:g} N {ftm.text()} m, GPS alone {gps.text(2)} m, ratio {ratio.text()} ({_of(ratio)})"
        )
    if not margins:
        raise Missing(f"no flights with GPS alone at λ {plan.FIGURE_WAVELENGTH_M:g} m")
    return by_margins(margins, found="shape error: " + "; ".join(words), unit=" m")


def _of(estimate: ComparedEstimate) -> str:
    return f"{estimate.flights} seeds" if estimate.flights != 1 else "1 seed"


def contention_harms(evidence: Evidence) -> Finding:
    """Compare the shape errors with an idle and a busy channel for the same seeds and flight time."""
    keys = [(case, plan.FIGURE_WAVELENGTH_M, plan.FIGURE_WIND_N) for case in (plan.CROWDED, plan.UNCROWDED)]
    margin = evidence.shape(keys, lambda crowded, usual: shape_m(crowded) - CROWDED_GROWTH * shape_m(usual))
    growth = evidence.shape(keys, lambda crowded, usual: shape_m(crowded) / shape_m(usual))
    seeds = {each.seed for each in evidence.flown(keys[0]).runs if has_shape(each)}
    seeds &= {each.seed for each in evidence.flown(keys[1]).runs if has_shape(each)}
    crowded, usual = (evidence.flown(key).of(seeds) for key in keys)
    return by_margins(
        {"shape error": margin}, unit=" m",
        found=f"channel busy {usual.busy_fraction or 0.0:.1%} and {crowded.busy_fraction or 0.0:.1%}: shape "
        f"error {shape_m(usual):.3f} m and {shape_m(crowded):.3f} m, {growth.text(2)} times ({_of(growth)})",
        why=_contention_text(crowded, usual, growth),
    )  # fmt: skip


def _contention_text(crowded: Cell, usual: Cell, growth: ComparedEstimate) -> str:
    lost = 1.0 - crowded.ftm_completed / max(crowded.ftm_requested, 1)
    times = crowded.ftm_completed / max(usual.ftm_completed, 1)
    balance = {
        True: "their benefit does not compensate for it",
        False: "their benefit exceeds the effect of contention",
        None: "their benefit and the effect of contention are about equal",
    }[ComparedEstimate(value=growth.value - 1.0, error=growth.error, flights=growth.flights).positive]
    return (
        f"With ranging every {plan.CROWDED_FTM_PERIOD_S:g} s {lost:.2%} of the sessions fail, and "
        f"{times:.1f} times as many return a distance: {balance}. "
        "[codesign-results.md](codesign-results.md), ranging policy, contains sixteen UAVs whose requests "
        "exceed the channel's capacity."
    )
