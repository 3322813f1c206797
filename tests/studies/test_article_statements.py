"""Tests of the verdicts on the article's statements, in both directions, from given values (5 s)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import structs
from scipy.special import ndtri

from antenna.analysis.statistics import GainStatistics
from studies.article import gain_findings
from studies.article.campaign_data import Cell, OneFlight
from studies.article.evidence import Evidence
from studies.article.monte_carlo import BACKENDS, SIGMAS_M, Drawn
from studies.article.patterns import PatternReading
from studies.article.plan import ARTICLE, CROWDED, GPS, UNCROWDED
from studies.article.retained_flights import FLOWN, IN_PLACE, UPRIGHT, Separation
from studies.article.statements import STATEMENTS, StatementVerdict, count, judge, judge_all

WAVELENGTHS_M, WINDS_N = (5.0, 7.5, 10.0, 15.0, 20.0), (0.0, 2.0, 5.0)
NORMAL = ndtri((np.arange(400) + 0.5) / 400)
"""Deterministic values with mean 0 and deviation 1."""


SEEDS = (1, 2, 3)


def cell(wavelength_m, wind_n, mean_dbi, std_db, *, case=ARTICLE, shape_m=0.1, scatter_db=0.0, **changes):
    """Make flights with means ``scatter_db`` below, at and above a mean."""
    runs = tuple(
        OneFlight(
            seed=seed, max_gain_dbi=mean_dbi + scatter_db * (seed - 2) + std_db * NORMAL, ideal_dbi=13.26,
            **{"shape_m": 1.2 * shape_m, "shape_horizontal_m": shape_m, "vehicles": 8, "busy_fraction": 0.06,
               "ftm_requested": 1000, "ftm_completed": 1000, "ftm_error_std_m": 0.4} | changes,
        )
        for seed in SEEDS
    )  # fmt: skip
    return Cell(case=case, wavelength_m=wavelength_m, wind_n=wind_n, runs=runs)


def each_run(found, **changes):
    """Return a cell with changes in all flights."""
    return replace(found, runs=tuple(replace(run, **changes) for run in found.runs))


def as_in_the_article():
    """Make evidence with which every statement holds."""
    cells = {}
    for wavelength_m in WAVELENGTHS_M:
        for wind_n in WINDS_N:
            cost_db = wind_n * (0.4 if wavelength_m == 5.0 else 0.04)
            std_db = 0.05 + wind_n * (0.2 if wavelength_m == 5.0 else 0.02)
            calm_dbi = 13.1 if wavelength_m == 5.0 else 13.2
            cells[ARTICLE, wavelength_m, wind_n] = cell(
                wavelength_m, wind_n, calm_dbi - cost_db, std_db, shape_m=0.1 + 0.02 * wind_n, scatter_db=0.01
            )
    for wind_n in WINDS_N:
        cells[GPS, 10.0, wind_n] = cell(10.0, wind_n, 10.0, 1.0, case=GPS, shape_m=1.7)
    cells[CROWDED, 10.0, 5.0] = cell(
        10.0, 5.0, 12.0, 0.5, case=CROWDED, shape_m=0.3, busy_fraction=0.95, ftm_requested=10_000,
        ftm_completed=9000,
    )  # fmt: skip
    cells[UNCROWDED, 10.0, 5.0] = cell(10.0, 5.0, 13.0, 0.1, case=UNCROWDED, shape_m=0.2)
    ideal = SimpleNamespace(max_gain_dbi=13.262, max_theta_deg=90.0, max_phi_deg=90.0)
    drawn = {
        (sigma_m, wavelength_m): drawing(
            13.262 - 4.0 * (2.0 * np.pi * sigma_m / wavelength_m) ** 2, 0.05 / sigma_m * wavelength_m
        )
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
        cells=cells, ideals={name: dict.fromkeys(WAVELENGTHS_M, ideal) for name in BACKENDS},
        separations=[separation(0.0, flown=0.05, upright=0.04, tilted=0.01),
                     separation(5.0, flown=0.25, upright=0.06, tilted=0.19)],
        patterns=patterns, pattern_flights=dict.fromkeys(SEEDS, patterns), drawn=drawn,
        frequencies_mhz={5.0: 59.96, 10.0: 29.98, 20.0: 14.99},
    )  # fmt: skip


def drawing(mean_dbi, peak_per_db, axis_gain=None):
    return Drawn(
        GainStatistics(samples=9, mean_dbi=mean_dbi, std_db=0.4, min_dbi=1.0, max_dbi=2.0, quantiles_dbi={}),
        peak_per_db,
        mean_gain=10.0 ** (mean_dbi / 10.0),
        mean_gain_error=0.001 * 10.0 ** (mean_dbi / 10.0),
        axis_gain=axis_gain or 10.0 ** (mean_dbi / 10.0),
    )


def separation(wind_n, *, flown, upright, tilted, wavelength_m=10.0):
    losses_db = {FLOWN: flown, UPRIGHT: upright, IN_PLACE: tilted}
    return Separation(
        wavelength_m=wavelength_m, wind_n=wind_n, ideal_dbi=13.26, tilt_rms_deg=15.0,
        turned_rms_deg=0.3, pointing_rms_deg=1.0,
        mean_dbi={
            seed: {name: 13.26 - loss_db + 0.01 * seed for name, loss_db in losses_db.items()}
            for seed in SEEDS
        },
    )  # fmt: skip


def with_cell(key, **changes):
    evidence = as_in_the_article()
    return replace(evidence, cells={**evidence.cells, key: each_run(evidence.cells[key], **changes)})


def with_pattern(name, **changes):
    evidence = as_in_the_article()
    changed = structs.replace(evidence.patterns[name], **changes)
    patterns = {**evidence.patterns, name: changed}
    return replace(evidence, patterns=patterns, pattern_flights=dict.fromkeys(SEEDS, patterns))


def with_ideal(**changes):
    evidence = as_in_the_article()
    ideal = SimpleNamespace(**{"max_gain_dbi": 13.262, "max_theta_deg": 90.0, "max_phi_deg": 90.0} | changes)
    return replace(evidence, ideals={**evidence.ideals, "nec2": {20.0: ideal}})


def without_solver(name, evidence):
    return replace(evidence, ideals={each: found for each, found in evidence.ideals.items() if each != name})


def shifted(wavelength_m, wind_n, by_db):
    """Shift the gains of one cell."""
    evidence, key = as_in_the_article(), (ARTICLE, wavelength_m, wind_n)
    found = evidence.cells[key]
    moved = tuple(replace(run, max_gain_dbi=run.max_gain_dbi + by_db) for run in found.runs)
    return replace(evidence, cells={**evidence.cells, key: replace(found, runs=moved)})


def with_losses(losses_db):
    """Make separations with the given losses of the variants in 5 N, and none without wind."""
    return replace(
        as_in_the_article(),
        separations=[separation(0.0, flown=0.0, upright=0.0, tilted=0.0),
                     separation(5.0, **dict(zip(("flown", "upright", "tilted"), losses_db, strict=True)))],
    )  # fmt: skip


def falling(loss_db):
    """Make random formations with a loss in dB as a function of (2 pi sigma / lambda)^2."""
    evidence = as_in_the_article()
    drawn = {
        (sigma_m, each_m): drawing(13.262 - loss_db((2.0 * np.pi * sigma_m / each_m) ** 2), 1.0)
        for sigma_m in SIGMAS_M
        for each_m in (5.0, 10.0, 15.0, 20.0)
    }
    return replace(evidence, drawn=drawn)


OTHERWISE = {
    "main lobe": with_ideal(max_phi_deg=92.0),
    "ideal gain": with_ideal(max_gain_dbi=13.28),
    "band": replace(as_in_the_article(), frequencies_mhz={5.0: 61.0, 20.0: 14.99}),
    "exponential": falling(lambda variance: -10.0 * np.log10(max(1.0 - variance, 0.1))),
    "all distances": with_cell((ARTICLE, 5.0, 0.0), ftm_completed=800),  # 600 of 45 000 sessions: 1.3 %
    "FTM accuracy": with_cell((GPS, 10.0, 2.0), shape_horizontal_m=0.15),
    "contention": with_cell((CROWDED, 10.0, 5.0), shape_horizontal_m=0.21),
    "short wavelengths": shifted(5.0, 2.0, 2.0),
    "near flat": with_cell((ARTICLE, 5.0, 5.0), max_gain_dbi=13.0 + 0.07 * NORMAL),
    "wind lowers": shifted(15.0, 2.0, -0.5),  # lower than in 5 N
    "wind flattens": with_cell((ARTICLE, 20.0, 5.0), max_gain_dbi=13.0 + 0.04 * NORMAL),
    "no wind": shifted(7.5, 0.0, -0.3),
    "noticeable": shifted(20.0, 5.0, 0.15),
    "angular deviation": with_losses((0.25, 0.19, 0.06)),
    "sensitive": shifted(5.0, 5.0, 1.7),
    "alike": shifted(15.0, 5.0, -0.4),
    "resilient": shifted(10.0, 5.0, -0.9),
    "lobe": with_pattern("median", effective_lobe_sr=0.395),
    "lower throughout": with_pattern("median", lower_share=0.6),
    "symmetry": with_pattern("median", asymmetry_db=0.9),
    "region: ideal": with_pattern("ideal", region_max_dbi=-0.5),
    "region: reduced": with_pattern(FLOWN, region_dbi=-1.5),
    "region: cause": with_pattern(UPRIGHT, region_dbi=-3.0),
    "shape, not maximum": with_cell((ARTICLE, 10.0, 5.0), shape_horizontal_m=0.12),
}  # fmt: skip


def test_all_statements_hold_with_matching_values():
    judged = judge_all(as_in_the_article())
    assert [(each.name, each.found) for each in judged if each.verdict is not StatementVerdict.AGREES] == []
    assert not any(each.why for each in judged)
    none = dict.fromkeys(StatementVerdict, 0)
    assert count(judged) == none | {StatementVerdict.AGREES: len(STATEMENTS)}


@pytest.mark.parametrize("statement", STATEMENTS, ids=lambda each: each.name)
def test_each_statement_can_fail_with_a_reason(statement):
    found = judge(statement, OTHERWISE[statement.name])
    assert found.verdict is StatementVerdict.DIFFERS, found.found
    assert found.why
    assert found.found


@pytest.mark.parametrize("statement", STATEMENTS, ids=lambda each: each.name)
def test_missing_evidence_is_not_a_verdict(statement):
    nothing = Evidence(cells={}, ideals={}, separations=[], patterns={}, drawn={})
    found = judge(statement, nothing)
    assert found.verdict is StatementVerdict.UNKNOWN
    assert found.found
    assert "\n" not in found.found


def test_statement_names_are_unique():
    names = [each.name for each in STATEMENTS]
    assert len(set(names)) == len(names)
    assert set(OTHERWISE) == set(names)


def test_implied_position_errors_are_bounded_on_both_sides():
    """λ 5 m is flat from 0.5 m on: a peak of 1 per dB, half of that of 10 m. At 1.4 m 10 and 20 m differ."""
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
    assert "for σ = 0.5, 1 m" in text
    never = {key: replace(each, peak_per_db=9.0) for key, each in drawn.items()}
    assert gain_findings.flat_from_m(never) is None
    assert (
        "No drawn error" in judge(statement_of("near flat"), replace(OTHERWISE["near flat"], drawn=never)).why
    )


def test_flat_and_other_changes_are_separated():
    """Flat relative to 10 m: deviations of 2.5 and 1 dB, peaks of 0.16 and 0.4 per dB; 0.1 dB has 4."""
    evidence = OTHERWISE["near flat"]
    extra = {
        (GPS, 5.0, 5.0): cell(5.0, 5.0, 9.0, 2.5, case=GPS, shape_m=1.7),
        ("cascade", 5.0, 5.0): cell(5.0, 5.0, 13.0, 0.1, case="cascade", shape_m=0.2),
        ("cascade", 10.0, 5.0): cell(10.0, 5.0, 13.1, 0.05, case="cascade", shape_m=0.2),
    }
    why = judge(statement_of("near flat"), replace(evidence, cells=evidence.cells | extra)).why
    flat, not_flat = why.split("that meet the criterion: ")[1].split("Flights that do not: ")
    assert "GPS alone" in flat
    assert "cascade" in not_flat


def statement_of(name):
    return next(each for each in STATEMENTS if each.name == name)


# ---- comparison over common seeds, undecided statements


def with_runs(key, runs):
    evidence = as_in_the_article()
    return replace(evidence, cells={**evidence.cells, key: replace(evidence.cells[key], runs=tuple(runs))})


@pytest.mark.parametrize(
    ("name", "key"), [("contention", (UNCROWDED, 10.0, 5.0)), ("FTM accuracy", (ARTICLE, 10.0, 5.0))]
)
def test_only_common_seeds_are_compared(name, key):
    """A fourth seed with 100 times the deviation, on one side only, has no effect."""
    runs = as_in_the_article().cells[key].runs
    far = replace(runs[0], seed=4, shape_horizontal_m=100.0 * runs[0].shape_horizontal_m)
    usual, more = judge(statement_of(name), as_in_the_article()), judge(
        statement_of(name), with_runs(key, [*runs, far])
    )  # fmt: skip
    assert (more.found, more.verdict) == (usual.found, usual.verdict)


def test_contention_is_compared_with_flights_of_equal_length():
    assert judge(
        statement_of("contention"), with_cell((ARTICLE, 10.0, 5.0), shape_horizontal_m=9.0)
    ) == judge(statement_of("contention"), as_in_the_article())


def test_consistent_pairs_decide_despite_larger_differences_between_seeds():
    """Shape errors of 0.2, 0.4, 0.6 m, and 1.5 times these: the ratio of each pair is the same."""
    of = as_in_the_article().cells
    keys = (CROWDED, 10.0, 5.0), (UNCROWDED, 10.0, 5.0)
    for growth, verdict in ((1.5, StatementVerdict.AGREES), (1.0, StatementVerdict.DIFFERS)):
        cells = {
            key: replace(
                of[key],
                runs=tuple(replace(r, shape_horizontal_m=0.2 * r.seed * times) for r in of[key].runs),
            )
            for key, times in zip(keys, (growth, 1.0), strict=True)
        }
        found = judge(statement_of("contention"), replace(as_in_the_article(), cells=of | cells))
        assert found.verdict is verdict


@pytest.mark.parametrize(
    ("scatter_db", "verdict"), [(0.001, StatementVerdict.DIFFERS), (0.1, StatementVerdict.OPEN)]
)
def test_difference_within_two_standard_errors_is_undecided(scatter_db, verdict):
    """Loss of 0.05 dB in 5 N at 20 m, 0.05 below the limit; by seeds +s, -2 s, +s: an error of s."""
    key, calm = (ARTICLE, 20.0, 5.0), as_in_the_article().cells[ARTICLE, 20.0, 0.0]
    runs = [
        replace(run, max_gain_dbi=run.max_gain_dbi - 0.05 + scatter_db * (1.0, -2.0, 1.0)[number])
        for number, run in enumerate(calm.runs)
    ]
    found = judge(statement_of("noticeable"), with_runs(key, runs))
    assert found.verdict is verdict
    assert "λ 20 m" in found.why
    assert f"± {scatter_db:.3f}" in found.found


@pytest.mark.parametrize(
    ("deficits_db", "verdict"),
    [
        ((1.4, 1.5, 1.6), StatementVerdict.AGREES),
        ((0.5, 1.0, 1.6), StatementVerdict.OPEN),
        ((0.4, 0.5, 0.6), StatementVerdict.DIFFERS),
    ],
)
def test_patterns_are_judged_by_all_retained_flights(deficits_db, verdict):
    """Limit of 1 dB in the region; with 0.5 dB between flights a mean of 1.03 dB is undecided."""
    evidence = as_in_the_article()
    flights = {
        seed: evidence.patterns
        | {
            name: structs.replace(evidence.patterns[name], region_dbi=-1.0 - deficit_db)
            for name in ("median", FLOWN)
        }
        for seed, deficit_db in zip(SEEDS, deficits_db, strict=True)
    }
    found = judge(statement_of("region: reduced"), replace(evidence, pattern_flights=flights))
    assert found.verdict is verdict
    assert "over 3 flights" in found.found
    single = replace(evidence, pattern_flights={1: flights[1]})
    assert judge(statement_of("region: reduced"), single).verdict is StatementVerdict.OPEN


def test_single_flight_has_no_standard_error():
    runs = as_in_the_article().cells[ARTICLE, 20.0, 5.0].runs
    found = judge(statement_of("resilient"), with_runs((ARTICLE, 20.0, 5.0), runs[:1]))
    assert found.verdict is StatementVerdict.OPEN
    assert "no standard error" in found.why


def test_losses_and_means_must_both_agree():
    """λ 15 m loses 0.2 dB more from a mean 0.2 dB higher without wind: the means in 5 N are equal."""
    moved = shifted(15.0, 0.0, 0.2)
    found = judge(statement_of("alike"), moved)
    assert found.verdict is StatementVerdict.DIFFERS
    assert "loss in 5 N" in found.why
    assert "means" not in found.why.split(". ")[0]


def test_criteria_require_every_solver():
    """Without one solver there is no verdict, unless another one violates the criterion."""
    for name in ("main lobe", "ideal gain"):
        found = judge(statement_of(name), without_solver("nec2c", as_in_the_article()))
        assert found.verdict is StatementVerdict.UNKNOWN
        assert "nec2c" in found.found
        assert (
            judge(statement_of(name), without_solver("nec2c", OTHERWISE[name])).verdict
            is StatementVerdict.DIFFERS
        )


def test_ideal_gain_is_that_of_the_flights_solver():
    evidence = as_in_the_article()
    other = SimpleNamespace(max_gain_dbi=12.0, max_theta_deg=90.0, max_phi_deg=90.0)
    evidence = replace(evidence, ideals=evidence.ideals | {"nec2": {10.0: other}})
    assert evidence.ideal_dbi(10.0) == 13.262
    assert replace(evidence, solver="nec2").ideal_dbi(10.0) == 12.0


def test_exponential_loss_holds_at_any_rate():
    for rate in (0.5, 1.0, 1.7):
        found = judge(
            statement_of("exponential"), falling(lambda v, rate=rate: 10.0 * rate * v / np.log(10.0))
        )
        assert found.verdict is StatementVerdict.AGREES
        assert f"exp(-{rate:.2f} (2π σ/λ)²)" in found.found


@pytest.mark.parametrize("loss", [lambda v: 3.0 * np.sqrt(v), lambda v: -10.0 * np.log10(max(1 - v, 0.1))])
def test_linear_loss_in_error_or_variance_is_not_exponential(loss):
    assert judge(statement_of("exponential"), falling(loss)).verdict is StatementVerdict.DIFFERS


def test_residual_gain_in_the_ideal_direction_explains_the_deviation():
    """There 2 + 19.2 exp(-v) of 21.2 remains: above a residual of 2 (3.01 dBi) an exponential of rate 1."""
    by_variance = falling(lambda v: -10.0 * np.log10(max(1.0 - v, 0.1)))
    ideal = 10.0**1.3262
    along = {
        (sigma_m, each_m): replace(
            found, axis_gain=2.0 + (ideal - 2.0) * np.exp(-((2.0 * np.pi * sigma_m / each_m) ** 2))
        )
        for (sigma_m, each_m), found in by_variance.drawn.items()
    }
    along[100.0, 5.0] = replace(along[1.0, 5.0], axis_gain=2.0, mean_gain=5.0)
    explained = judge(statement_of("exponential"), replace(by_variance, drawn=along))
    assert explained.verdict is StatementVerdict.DIFFERS
    assert "3.01 dBi remain" in explained.why
    assert "within 0.00 dB of exp(-1.00" in explained.why
    usual = judge(statement_of("exponential"), by_variance)  # in that direction the same as the maximum
    assert "errors favour" not in usual.why


# ---- reasons follow from their values

REASONS = [
    ("angular deviation", with_losses((0.6, 0.01, 0.05)), "Neither alone", "Positions alone cause more"),
    ("angular deviation", with_losses((0.6, 0.5, 0.05)), "Positions alone cause more", "Neither"),
    ("angular deviation", with_losses((-0.1, 0.0, 0.05)), "There is no loss", "Positions alone cause"),
    ("contention", with_cell((CROWDED, 10.0, 5.0), shape_horizontal_m=0.216),
     "not compensate", "benefit exceeds"),
    ("contention", with_cell((CROWDED, 10.0, 5.0), shape_horizontal_m=0.15),
     "benefit exceeds", "not compensate"),
    ("no wind", shifted(7.5, 0.0, 0.5), "Above the ideal at λ 7.5 m", "Position errors remain"),
    ("no wind", shifted(7.5, 0.0, -0.5), "Position errors remain", "Above the ideal"),
    ("noticeable", shifted(20.0, 5.0, 0.9), "the mean is higher at λ 20 m", "hold the shape"),
    ("noticeable", shifted(20.0, 5.0, 0.15), "λ 20 m", "the mean is higher"),
    ("symmetry", with_pattern("ideal", asymmetry_db=0.5),
     "ideal pattern is not symmetric", "flown pattern differs"),
    ("symmetry", with_pattern("median", asymmetry_db=0.5),
     "flown pattern differs", "ideal pattern is not symmetric"),
    ("lower throughout", replace(
        with_pattern("median", lower_share=0.5), patterns=with_pattern("median", lower_share=0.5).patterns
        | {"ideal": structs.replace(as_in_the_article().patterns["ideal"], mean_dbi=1.0)},
    ), "1.00 dBi ideally.", "a gain in others"),
    ("region: reduced", with_pattern("median", region_dbi=1.0), "1.00 dBi", "zenith"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "evidence", "said", "unsaid"), REASONS)
def test_reason_follows_from_the_values(name, evidence, said, unsaid):
    found = judge(statement_of(name), evidence)
    assert found.verdict is StatementVerdict.DIFFERS, found.found
    assert said in found.why
    assert unsaid not in found.why


def test_gain_increase_is_not_reported_as_a_deficit():
    found = judge(statement_of("region: reduced"), with_pattern("median", region_dbi=1.0)).found
    assert "2.00 dB higher than ideal" in found
    assert "difference from ideal is 2.00" in found
