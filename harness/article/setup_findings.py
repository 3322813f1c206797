"""Statements on the formation and its radio."""

import numpy as np

from antenna.ports import MAIN_LOBE_DEG
from antenna.statistics import pointing_errors_deg
from harness.article.evidence import Evidence, Missing
from harness.article.finding import Finding
from harness.article.plan import ARTICLE, CROWDED_FTM_PERIOD_S, FIGURE_WAVELENGTH_M, FIGURE_WIND_N, GPS

IDEAL_DBI, IDEAL_WITHIN_DB = 13.26, 0.01
AXIS_WITHIN_DEG = 1.0
SESSIONS_SHARE = 0.99
FTM_SHARE = 0.5
CROWDED_GROWTH = 1.1


def main_lobe_along_y(evidence: Evidence) -> Finding:
    """Direction of the ideal maximum."""
    patterns = [pattern for found in evidence.ideals.values() for pattern in found.values()]
    if not patterns:
        raise Missing("the ideal formation was not solved")
    errors_deg = pointing_errors_deg(patterns, *MAIN_LOBE_DEG)
    return Finding(
        found=f"at most {errors_deg.max():.2f}° from it ({', '.join(evidence.ideals)})",
        agrees=bool(errors_deg.max() <= AXIS_WITHIN_DEG), why="The solvers find the lobe elsewhere.",
    )  # fmt: skip


def ideal_gain(evidence: Evidence) -> Finding:
    """Ideal maximum by every solver."""
    gains = {name: [each.max_gain_dbi for each in found.values()] for name, found in evidence.ideals.items()}
    if not gains:
        raise Missing("the ideal formation was not solved")
    worst_db = max(abs(gain - IDEAL_DBI) for found in gains.values() for gain in found)
    said = "; ".join(f"{name} {min(found):.3f} to {max(found):.3f} dBi" for name, found in gains.items())
    return Finding(
        found=said, agrees=worst_db <= IDEAL_WITHIN_DB,
        why=f"The farthest is {worst_db:.3f} dB from it.",
    )  # fmt: skip


def distances_to_all(evidence: Evidence) -> Finding:
    """Sessions of the article's flights."""
    cells = [cell for (case, _, _), cell in evidence.cells.items() if case == ARTICLE]
    requested = sum(cell.ftm_requested for cell in cells)
    if not requested:
        raise Missing("no session was asked for")
    share = sum(cell.ftm_completed for cell in cells) / requested
    error_m = [cell.ftm_error_std_m for cell in cells if cell.ftm_error_std_m is not None]
    error = f"; they scatter by {np.sqrt(np.square(error_m).mean()):.3f} m" if error_m else ""
    return Finding(
        found=f"{share:.2%} of {requested} sessions{error}", agrees=share >= SESSIONS_SHARE,
        why="The others fail on the channel or find their peer busy.",
    )  # fmt: skip


def ftm_corrects_gps(evidence: Evidence) -> Finding:
    """Shape errors with and without ranging at λ 10 m."""
    ratios, words = [], []
    for wind_n in evidence.winds_n:
        if (GPS, FIGURE_WAVELENGTH_M, wind_n) not in evidence.cells:
            continue
        with_ftm = evidence.sigma_m(FIGURE_WAVELENGTH_M, wind_n)
        alone = evidence.sigma_m(FIGURE_WAVELENGTH_M, wind_n, GPS)
        ratios.append(with_ftm / alone)
        words.append(f"{wind_n:g} N {with_ftm:.3f} m, GPS alone {alone:.2f} m")
    if not ratios:
        raise Missing(f"nothing was flown on GPS alone at λ {FIGURE_WAVELENGTH_M:g} m")
    return Finding(
        found="horizontal σ per axis: " + "; ".join(words), agrees=max(ratios) <= FTM_SHARE,
        why=f"Ranging leaves up to {max(ratios):.2f} of the error.",
    )  # fmt: skip


def contention_harms(evidence: Evidence) -> Finding:
    """Shape error and sessions with an idle and a busy channel."""
    crowded, usual = evidence.crowded, evidence.cell(FIGURE_WAVELENGTH_M, FIGURE_WIND_N)
    if not crowded.shape_horizontal_m or not usual.shape_horizontal_m:
        raise Missing("no flight over a busy channel has a shape error")
    growth = crowded.shape_horizontal_m / usual.shape_horizontal_m
    busy, lost = crowded.busy_fraction or 0.0, 1.0 - crowded.ftm_completed / max(crowded.ftm_requested, 1)
    return Finding(
        found=f"channel busy {usual.busy_fraction or 0.0:.1%} and {busy:.1%}: shape error "
        f"{usual.shape_horizontal_m:.3f} m and {crowded.shape_horizontal_m:.3f} m, {growth:.2f} times",
        agrees=growth >= CROWDED_GROWTH,
        why=f"With ranging every {CROWDED_FTM_PERIOD_S:g} s {lost:.2%} of the sessions fail, and those that "
        "do not are ten times as many: eight UAVs gain more by them than contention takes. Sixteen that ask "
        "for more than the channel holds lose some ([codesign-results.md](codesign-results.md), ranging "
        "policy).",
    )  # fmt: skip
