"""Verdicts on the article's statements: each comes out either way, by its numbers alone (5 s)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import structs
from scipy.special import ndtri

from antenna.statistics import GainStatistics
from harness.article import gain_findings
from harness.article.draws import Drawn
from harness.article.evidence import Evidence
from harness.article.kept import FLOWN, IN_PLACE, UPRIGHT, Separation
from harness.article.patterns import PatternReading
from harness.article.plan import ARTICLE, CROWDED, GPS
from harness.article.readings import Cell
from harness.article.statements import STATEMENTS, Verdict, count, judge, judge_all

WAVELENGTHS_M, WINDS_N = (5.0, 7.5, 10.0, 15.0, 20.0), (0.0, 2.0, 5.0)
NORMAL = ndtri((np.arange(400) + 0.5) / 400)
"""Of mean 0 and deviation 1, without chance."""


def cell(wavelength_m, wind_n, mean_dbi, std_db, *, case=ARTICLE, shape_m=0.1, busy=0.06, completed=1000):
    return Cell(
        case=case, wavelength_m=wavelength_m, wind_n=wind_n, flights=2, completed=2, collided=0,
        max_gain_dbi=mean_dbi + std_db * NORMAL, missing=0, ideal_dbi=13.26, shape_m=1.2 * shape_m,
        shape_horizontal_m=shape_m, vehicles=8, busy_fraction=busy, ftm_requested=1000,
        ftm_completed=completed, ftm_error_std_m=0.4,
    )  # fmt: skip


def as_in_the_article():
    """Make numbers with which every statement holds."""
    cells = {}
    for wavelength_m in WAVELENGTHS_M:
        for wind_n in WINDS_N:
            cost_db = wind_n * (0.4 if wavelength_m == 5.0 else 0.04)
            std_db = 0.05 + wind_n * (0.2 if wavelength_m == 5.0 else 0.02)
            calm_dbi = 13.1 if wavelength_m == 5.0 else 13.2
            cells[ARTICLE, wavelength_m, wind_n] = cell(wavelength_m, wind_n, calm_dbi - cost_db, std_db)
    for wind_n in WINDS_N:
        cells[GPS, 10.0, wind_n] = cell(10.0, wind_n, 10.0, 1.0, case=GPS, shape_m=1.7)
    cells[CROWDED, 10.0, 5.0] = cell(10.0, 5.0, 12.0, 0.5, case=CROWDED, shape_m=0.2, busy=0.95)
    ideal = SimpleNamespace(max_gain_dbi=13.262, max_theta_deg=90.0, max_phi_deg=90.0)
    drawn = {
        (sigma_m, wavelength_m): drawing(13.2 - sigma_m / wavelength_m, 0.05 / sigma_m * wavelength_m)
        for sigma_m in (0.1, 0.5, 1.0)
        for wavelength_m in (5.0, 10.0, 15.0, 20.0)
    }
    reading = PatternReading(
        max_gain_dbi=13.26, lobe_sr=0.4, effective_lobe_sr=0.4, region_dbi=-1.0, region_max_dbi=2.0,
        region_colour_db=-10.0, region_lower_share=0.0, asymmetry_db=0.0, lower_share=0.0,
        difference_db=0.0, mean_dbi=0.0,
    )  # fmt: skip
    flown = structs.replace(
        reading, max_gain_dbi=13.0, effective_lobe_sr=0.35, region_dbi=-4.0, asymmetry_db=3.0,
        lower_share=0.8, difference_db=3.0,
    )  # fmt: skip
    upright = structs.replace(flown, region_dbi=-1.2)
    patterns = {"ideal": reading, "median": flown, FLOWN: flown, UPRIGHT: upright, IN_PLACE: flown}
    return Evidence(
        cells=cells, ideals={"batch": dict.fromkeys(WAVELENGTHS_M, ideal)},
        separations=[separation(0.0, flown=0.05, upright=0.04, tilted=0.01),
                     separation(5.0, flown=0.25, upright=0.06, tilted=0.19)],
        patterns=patterns, drawn=drawn,
    )  # fmt: skip


def drawing(mean_dbi, peak_per_db):
    return Drawn(
        GainStatistics(samples=9, mean_dbi=mean_dbi, std_db=0.4, min_dbi=1.0, max_dbi=2.0, quantiles_dbi={}),
        peak_per_db,
    )


def separation(wind_n, *, flown, upright, tilted, wavelength_m=10.0):
    losses_db = {FLOWN: flown, UPRIGHT: upright, IN_PLACE: tilted}
    return Separation(
        wavelength_m=wavelength_m, wind_n=wind_n, flights=1, ideal_dbi=13.26, tilt_rms_deg=15.0,
        turned_rms_deg=0.3, pointing_rms_deg=1.0,
        mean_dbi={name: 13.26 - loss_db for name, loss_db in losses_db.items()},
    )  # fmt: skip


def with_cells(**changes):
    """Change cells of the article by a function of (wavelength_m, wind_n) that gives mean and deviation."""
    evidence = as_in_the_article()
    made = {
        key: replace(found, max_gain_dbi=changes["gains"](found)) if key[0] == ARTICLE else found
        for key, found in evidence.cells.items()
    }
    return replace(evidence, cells=made)


def with_cell(key, **changes):
    evidence = as_in_the_article()
    return replace(evidence, cells={**evidence.cells, key: replace(evidence.cells[key], **changes)})


def with_pattern(name, **changes):
    evidence = as_in_the_article()
    changed = structs.replace(evidence.patterns[name], **changes)
    return replace(evidence, patterns={**evidence.patterns, name: changed})


def with_ideal(**changes):
    evidence = as_in_the_article()
    ideal = SimpleNamespace(**{"max_gain_dbi": 13.262, "max_theta_deg": 90.0, "max_phi_deg": 90.0} | changes)
    return replace(evidence, ideals={**evidence.ideals, "nec2": {20.0: ideal}})


def shifted(wavelength_m, wind_n, by_db):
    """Move the gains of one cell."""
    found = as_in_the_article().cells[ARTICLE, wavelength_m, wind_n].max_gain_dbi
    return with_cell((ARTICLE, wavelength_m, wind_n), max_gain_dbi=found + by_db)


OTHERWISE = {
    "main lobe": with_ideal(max_phi_deg=92.0),
    "ideal gain": with_ideal(max_gain_dbi=13.28),
    "all distances": with_cell((ARTICLE, 5.0, 0.0), ftm_completed=800),  # 200 of 15 000 sessions: 1.3 %
    "FTM accuracy": with_cell((GPS, 10.0, 2.0), shape_horizontal_m=0.15),
    "contention": with_cell((CROWDED, 10.0, 5.0), shape_horizontal_m=0.1),
    "short wavelengths": shifted(5.0, 2.0, 2.0),
    "near flat": with_cell((ARTICLE, 5.0, 5.0), max_gain_dbi=13.0 + 0.07 * NORMAL),
    "wind lowers": shifted(15.0, 2.0, -0.5),  # and 5 N are above it
    "wind flattens": with_cell((ARTICLE, 20.0, 5.0), max_gain_dbi=13.0 + 0.04 * NORMAL),
    "no wind": shifted(7.5, 0.0, -0.3),
    "noticeable": shifted(20.0, 5.0, 0.15),
    "angular deviation": replace(
        as_in_the_article(),
        separations=[separation(0.0, flown=0.05, upright=0.04, tilted=0.01),
                     separation(5.0, flown=0.25, upright=0.19, tilted=0.06)],
    ),
    "sensitive": shifted(5.0, 5.0, 1.7),
    "alike": shifted(15.0, 5.0, -0.4),
    "resilient": shifted(10.0, 5.0, -0.9),
    "lobe": with_pattern("median", effective_lobe_sr=0.395),
    "lower throughout": with_pattern("median", lower_share=0.6),
    "symmetry": with_pattern("median", asymmetry_db=0.9),
    "region: ideal": with_pattern("ideal", region_max_dbi=-0.5),
    "region: reduced": with_pattern(FLOWN, region_dbi=-1.5),
    "region: cause": with_pattern(UPRIGHT, region_dbi=-3.0),
    "shape, not maximum": with_pattern("median", max_gain_dbi=12.0),
}  # fmt: skip


def test_with_the_articles_numbers_every_statement_holds():
    judged = judge_all(as_in_the_article())
    assert [(each.name, each.found) for each in judged if each.verdict is not Verdict.AGREES] == []
    assert not any(each.why for each in judged)
    assert count(judged) == {Verdict.AGREES: len(STATEMENTS), Verdict.DIFFERS: 0, Verdict.UNKNOWN: 0}


@pytest.mark.parametrize("statement", STATEMENTS, ids=lambda each: each.name)
def test_each_statement_can_fail_and_says_why(statement):
    found = judge(statement, OTHERWISE[statement.name])
    assert found.verdict is Verdict.DIFFERS, found.found
    assert found.why
    assert found.found


@pytest.mark.parametrize("statement", STATEMENTS, ids=lambda each: each.name)
def test_what_was_not_measured_is_no_verdict(statement):
    nothing = Evidence(cells={}, ideals={}, separations=[], patterns={}, drawn={})
    found = judge(statement, nothing)
    assert found.verdict is Verdict.UNKNOWN
    assert found.found
    assert "\n" not in found.found


def test_no_two_statements_have_one_name():
    names = [each.name for each in STATEMENTS]
    assert len(set(names)) == len(names)
    assert set(OTHERWISE) == set(names)


def test_the_error_that_the_articles_densities_imply_is_found_between_too_little_and_too_much():
    """5 m are flat from 0.5 m on: a peak of 1 per dB, half of that of 10 m. With 1.4 m 10 and 20 m differ."""
    peaks = {0.1: (5.0, 10.0), 0.5: (0.5, 1.2), 1.0: (0.4, 0.9), 1.4: (0.4, 0.9)}
    spans_db = {0.1: 0.01, 0.5: 0.1, 1.0: 0.29, 1.4: 0.5}
    drawn = {}
    for sigma_m, (short, long) in peaks.items():
        drawn[sigma_m, 5.0] = drawing(10.0, short)
        drawn[sigma_m, 10.0] = drawing(13.0 - spans_db[sigma_m], long)
        drawn[sigma_m, 20.0] = drawing(13.0, long)
    assert gain_findings.flat_from_m(drawn) == 0.5
    assert gain_findings.implied_sigmas_m(drawn) == [0.5, 1.0]
    text = judge(statement_of("near flat"), replace(OTHERWISE["near flat"], drawn=drawn)).why
    assert "σ = 0.5 to 1 m" in text
    never = {key: replace(each, peak_per_db=9.0) for key, each in drawn.items()}
    assert gain_findings.flat_from_m(never) is None
    assert (
        "No error that was drawn"
        in judge(statement_of("near flat"), replace(OTHERWISE["near flat"], drawn=never)).why
    )


def test_what_was_flown_flat_is_told_from_what_was_not():
    """Flat beside 10 m is a deviation of 2.5 against 1 dB, peaks of 0.16 and 0.4 per dB; 0.1 dB has 4."""
    evidence = OTHERWISE["near flat"]
    extra = {
        (GPS, 5.0, 5.0): cell(5.0, 5.0, 9.0, 2.5, case=GPS, shape_m=1.7),
        ("cascade", 5.0, 5.0): cell(5.0, 5.0, 13.0, 0.1, case="cascade", shape_m=0.2),
        ("cascade", 10.0, 5.0): cell(10.0, 5.0, 13.1, 0.05, case="cascade", shape_m=0.2),
    }
    why = judge(statement_of("near flat"), replace(evidence, cells=evidence.cells | extra)).why
    flat, not_flat = why.split("met the criterion with: ")[1].split("They did not with: ")
    assert "GPS alone" in flat
    assert "cascade" in not_flat


def statement_of(name):
    return next(each for each in STATEMENTS if each.name == name)
