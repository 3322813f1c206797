"""Tests of the judgement of the co-design experiment's flights and studies, without flights (8 s)."""

import math
from types import MappingProxyType

import numpy as np
import pytest
from msgspec.structs import replace

from harness.world.faults import RangingBias
from studies.codesign import cli, estimator_section
from studies.codesign.book import Book
from studies.codesign.cases import (
    BEACON_PERIODS_MS,
    LIAR,
    LIAR_FROM_START,
    LOSSY,
    CodesignPlan,
    cut,
    groups,
    liar_in_flight,
    wavelength,
)
from studies.codesign.measures import TRACK_PERIOD_S, Measures
from studies.codesign.results import CodesignFlown
from studies.codesign.study import LocalisationResult
from studies.common.report import draw_figures

PLAN = CodesignPlan(seeds=10, duration_s=30.0)


def made_up(
    plan,
    *,
    ftm_m=0.2,
    gps_m=1.5,
    bias_pull_m=0.0,
    bias_shift_m=0.0,
    recovers=True,
    drop_grows=1.2,
    drops=0.3,
    cuts=True,
    measures_bias=True,
    gps_dbi=9.0,
    busy_scheduled=0.1,
    busy_per_session=0.001,
    busy_most=1.0,
    completes=0.98,
    worse=MappingProxyType({}),
):
    """Make a book with all flights: a shape error of ``ftm_m`` with a scatter of 5 % by seed.

    ``worse``: factor on the errors of a case, by its name. Every ranging session takes
    ``busy_per_session`` of the channel's time: 5.6 % with 8 UAVs, all pairs and a second, 24 % with 16.
    """
    rng = np.random.default_rng(10)
    flights = {}
    for case in {case.name: case for members in groups(plan).values() for case in members}.values():
        for seed in range(1, plan.seeds + 1):
            scatter = 1.0 + 0.05 * np.random.default_rng(seed).standard_normal()
            shape_m = scatter * (gps_m if case.localisation == "gps" else ftm_m) * worse.get(case.name, 1.0)
            if case.drop_fraction:
                shape_m *= drop_grows
            instants = round((plan.duration_s + case.longer_s) / TRACK_PERIOD_S)
            track_ne_m = np.random.default_rng([seed, 1]).normal(
                0.0, shape_m / math.sqrt(2), (instants, case.agents, 2)
            )
            in_flight = any(isinstance(fault, RangingBias) for fault in case.faults)
            biased = measures_bias and (case.lies or in_flight)
            if biased:
                begin = 0 if case.lies else round(plan.liar_after_s / TRACK_PERIOD_S)
                track_ne_m[begin:, 0, 0] += bias_pull_m
                track_ne_m[begin:, :, 1] += bias_shift_m
            if case == cut(plan):
                begin = round(plan.cut_s / TRACK_PERIOD_S)
                track_ne_m[begin : 2 * begin + 20 if recovers else None] *= 4.0
            track_mm = np.rint(1e3 * track_ne_m).astype(int)
            collided = case.localisation == "gps" and seed % 2
            sessions_per_s = case.agents * (case.agents - 1) / case.ftm_period_s
            busy = min(busy_per_session * sessions_per_s, busy_most)
            if case.ranging == "scheduled":
                busy = busy_scheduled
            numbers = {
                "formed_s": 18.0, "simulated_s": 48.0, "wall_s": 10.0, "real_time_factor": 4.8,
                "collisions": int(collided), "first_collision_s": 40.0 if collided else None,
                "down": 2 * int(collided), "least_distance_m": 0.4 if collided else 1.9,
                "least_distance_formed_m": 1.9, "shape_m": shape_m, "shape_whole_m": shape_m,
                "absolute_m": 1.5, "vertical_m": 0.1, "estimate_m": 0.7 * shape_m, "control_m": 0.7 * shape_m,
                "busy_fraction": busy, "sessions_per_s": sessions_per_s,
                "completed_fraction": completes * (1.0 - drops * bool(case.drop_fraction)),
                "beacons_lost_fraction": drops * bool(case.drop_fraction),
                "longest_silence_s": plan.cut_s if case == cut(plan) and cuts else 0.1,
                "range_offsets_m": tuple(5.0 * (biased and i == LIAR) for i in range(case.agents)),
                "gain_dbi": tuple(rng.normal(gps_dbi if case.localisation == "gps" else 13.0, 0.1, 30))
                if case.gains
                else (),
                "track_mm": tuple(map(tuple, track_mm.reshape(instants, -1).tolist())),
            }  # fmt: skip
            flights[case.name, seed] = CodesignFlown(
                case=case.name, seed=seed, digest="x", measures=Measures(**numbers)
            )
    return Book(plan=plan, flights=flights)


def judged(book):
    return {name: judge(book) for name, judge in cli.JUDGES.items()}


def missed(sections):
    return [check.name for section in sections.values() for check in section.checks if not check.passed]


def test_campaign_within_all_limits_passes_and_is_drawn(tmp_path):
    sections = judged(made_up(PLAN))
    draw_figures(sections.values(), tmp_path)
    assert missed(sections) == []
    drawn = [figure.file_name for section in sections.values() for figure in section.figures]
    assert len(drawn) == 6
    assert all((tmp_path / name).stat().st_size > 10_000 for name in drawn)
    checks = {check.name: check for section in sections.values() for check in section.checks}
    ratio = checks["shape error with GPS alone over that with FTM, same case"]
    assert ratio.value == pytest.approx(1.5 / 0.2)
    (rows,) = [table.rows for table in sections["wavelength"].tables]
    assert len(rows) == 8
    cell = dict(zip(sections["wavelength"].tables[0].columns, rows[-1], strict=True))
    assert (cell["λ m"], cell["wind N"], cell["positions by"]) == ("10", "5", "with FTM")
    assert float(cell["σ horizontal m"]) == pytest.approx(0.2 / math.sqrt(1.625), rel=0.06)
    assert cell["expected for σ/λ dBi"].startswith("13.1")
    assert "5 of 10 flights with GPS alone have a collision" in sections["wavelength"].tables[0].caption
    assert len(sections["beacon_period"].tables[0].rows) == len(BEACON_PERIODS_MS)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"ftm_m": 0.26, "gps_m": 2.0},
            [
                "shape error with FTM, 8 UAVs, 5 N, mean",
                "shape error with FTM, all flown winds and numbers of UAVs, largest mean",
                "shape error with FTM, any period, largest mean",
                "shape error with FTM, any policy within the channel capacity, largest mean",
            ],
        ),
        (
            {"worse": {"ftm-16-5n": 1.3, "ftm-16-5n-scheduled": 1.3}},
            [
                "shape error with FTM, all flown winds and numbers of UAVs, largest mean",
                "shape error with FTM, any policy within the channel capacity, largest mean",
            ],
        ),
        (
            {"worse": {"ftm-16-0n": 1.3}},
            ["shape error with FTM, all flown winds and numbers of UAVs, largest mean"],
        ),
        ({"gps_dbi": 11.0}, ["share of the gain lost with GPS alone that FTM recovers, in dB, smallest"]),
        ({"worse": {"ftm-8-5n-beacon200": 1.15}}, ["shape error at 200 ms over that at 50 ms"]),
        (
            {"worse": {"ftm-8-5n-beacon1000": 0.8}},
            ["error of the estimates at 1000 ms over that at 100 ms, lower end"],
        ),
        (
            {"completes": 0.94},
            [
                (
                    "share of ranging sessions that complete, any policy within the channel capacity, "
                    "smallest mean"
                )
            ],
        ),
        (
            {"busy_scheduled": 0.115},
            ["scheduled: occupancy of the channel over its configured share, largest"],
        ),
        (
            {"worse": {"ftm-8-5n-scheduled": 1.02}},
            ["8 UAVs: shape error scheduled over all pairs once a second, lower end"],
        ),
        (
            {"worse": {"ftm-16-5n-scheduled": 1.12}},
            ["16 UAVs: shape error scheduled over all pairs once a second"],
        ),
        (
            {"busy_per_session": 0.0008},
            ["16 UAVs: occupancy of the channel scheduled over all pairs once a second"],
        ),
        (
            {"busy_most": 0.25},
            ["8 UAVs: occupancy of the channel, all pairs every 0.1 s over every second"],
        ),
        (
            {"worse": {"ftm-8-5n-every0.1s": 0.49}},
            ["8 UAVs: shape error, all pairs every 0.1 s over every second"],
        ),
        (
            {"worse": {"truth-8-5n": 1.05}},
            ["shape error with true positions over that with FTM, lower end"],
        ),
        ({"worse": {"truth-8-5n": 0.7}}, ["shape error with true positions over that with FTM"]),
        (
            {"worse": {"ftm-8-5n-ideal": 1.05}},
            ["shape error over an ideal channel over that over the emulated one, lower end"],
        ),
        (
            {"worse": {"ftm-8-5n-ideal": 0.9}},
            ["shape error over the emulated channel over that over an ideal one"],
        ),
        ({"gps_m": 0.97}, ["shape error with GPS alone over that with FTM, same case"]),
        ({"drop_grows": 1.55}, ["30% of beacons and distances lost: growth of the shape error"]),
        (
            {"drops": 0.2},
            [
                "losses: share of the beacons lost at the hosts",
                "losses: share of ranging sessions that complete",
            ],
        ),
        ({"cuts": False}, ["outage: time without any distance, shortest"]),
        ({"measures_bias": False}, ["ranging bias: error of the measured distances, median, smallest"]),
        ({"recovers": False}, ["outage: recovery after the channel's return, slowest"]),
        (
            {"bias_pull_m": 0.8},
            [
                "ranging bias in flight: displacement of another in the shape over 2 s, largest",
                "ranging bias in flight: displacement of another in space over 2 s, largest",
                "ranging bias from the start: lasting displacement of another in the shape, largest",
            ],
        ),
        (
            {"bias_shift_m": 0.4},
            ["ranging bias in flight: displacement of another in space over 2 s, largest"],
        ),
    ],
)
def test_each_check_depends_on_its_own_measure(changes, expected):
    assert missed(judged(made_up(PLAN, **changes))) == expected


def test_too_few_flights_fail():
    """Every section and every ratio requires enough flights."""
    names = missed(judged(made_up(replace(PLAN, seeds=4))))
    assert names.count("flights that formed, fewest") == len(cli.JUDGES)
    assert names.count("pairs of flights, fewest of a ratio") == 3
    assert sorted(set(names)) == sorted({
        "flights that formed, fewest",
        "pairs of flights, fewest of a ratio",
        "pairs of flights, GPS alone and FTM",
        "pairs of flights, with and without losses",
        "pairs of flights, with and without ranging bias in flight",
        "pairs of flights, with and without ranging bias from the start",
    })  # fmt: skip


@pytest.mark.parametrize("name", cli.JUDGES)
def test_group_with_broken_flights_fails(name):
    """A single broken flight or collision in a case with FTM fails as well."""
    book = made_up(replace(PLAN, seeds=11))  # one more than required, so that the broken one is the cause
    assert missed(judged(book)) == []
    broken = {
        key: replace(flown, measures=None, broken="no vehicle is left") for key, flown in book.flights.items()
    }
    section = cli.JUDGES[name](replace(book, flights=broken))
    assert section.checks
    assert all(not check.passed for check in section.checks)
    held = [case for case in groups(PLAN)[name] if case.localisation != "gps" and not case.last]
    for case in held:
        key = (case.name, 3)
        bumped = replace(book.flights[key], measures=replace(book.flights[key].measures, collisions=1))
        for changed, expected in ((broken[key], "broke or did not form"), (bumped, "with a collision")):
            worse = cli.JUDGES[name](replace(book, flights=dict(book.flights) | {key: changed}))
            assert any(expected in check.name and not check.passed for check in worse.checks), case.name


def test_collisions_with_gps_alone_are_expected():
    """At 1.25 m half of the synthetic flights collide; without collisions the case would not be critical."""
    book, tight = made_up(PLAN), wavelength("gps", 5, 2)
    calm = {
        key: replace(flown, measures=replace(flown.measures, collisions=0)) if key[0] == tight.name else flown
        for key, flown in book.flights.items()
    }
    assert missed(judged(replace(book, flights=calm))) == [
        "λ = 5 m, 2 N, GPS alone: share of flights with a collision"
    ]


def test_optional_flights_may_be_missing_but_are_judged_if_present():
    """Winds of 0 and 2 N with 4 and 16 UAVs are flown last; 240 sessions in 0.25 s are not judged."""
    book = made_up(PLAN)
    last = {case.name for members in groups(PLAN).values() for case in members if case.last}
    assert last >= {"ftm-4-0n", "ftm-16-2n", "ftm-16-5n-every0.25s"}
    without = {key: flown for key, flown in book.flights.items() if key[0] not in last}
    assert missed(judged(replace(book, flights=without))) == []
    for name, expected in (
        ("ftm-16-2n", ["with FTM: flights with a collision"]),
        ("ftm-16-5n-every0.25s", []),
    ):
        old = book.flights[name, 1]
        bumped = replace(old, measures=replace(old.measures, collisions=1))
        assert missed(judged(replace(book, flights=dict(book.flights) | {(name, 1): bumped}))) == expected


@pytest.mark.parametrize("case", [LOSSY, LIAR_FROM_START, liar_in_flight(PLAN), cut(PLAN)])
def test_flight_that_did_not_form_fails(case):
    """It has neither errors nor a track, and no pair for a comparison."""
    book = made_up(PLAN)
    old = book.flights[case.name, 3]
    nowhere = replace(old, measures=replace(old.measures, formed_s=None, shape_m=None, track_mm=()))
    names = missed(judged(replace(book, flights=dict(book.flights) | {(case.name, 3): nowhere})))
    assert names[:2] == ["flights that formed, fewest", "with FTM: flights that broke or did not form"]
    assert len(names) == (2 if case == cut(PLAN) else 3)


def test_track_that_ends_before_the_bias_fails():
    book, case = made_up(PLAN), liar_in_flight(PLAN)
    old = book.flights[case.name, 3]
    short = replace(old, measures=replace(old.measures, track_mm=old.measures.track_mm[:5]))
    names = missed(judged(replace(book, flights=dict(book.flights) | {(case.name, 3): short})))
    assert names == [
        "ranging bias in flight: displacement of another in the shape over 2 s, largest",
        "ranging bias in flight: displacement of another in space over 2 s, largest",
    ]


def test_collision_at_five_metres_fails():
    book = made_up(PLAN)
    tight = wavelength("ftm", 5, 2)
    old = book.flights[tight.name, 3]
    bumped = replace(old, measures=replace(old.measures, collisions=1))
    lost = replace(old, measures=None, broken="no vehicle is left")
    for changed, expected in (
        (bumped, ["with FTM: flights with a collision", "λ = 5 m, 2 N, FTM: flights with a collision"]),
        (lost, ["flights that formed, fewest", "with FTM: flights that broke or did not form"]),
    ):
        worse = replace(book, flights=dict(book.flights) | {(tight.name, 3): changed})
        assert missed(judged(worse)) == expected


def test_without_flights_every_check_fails(tmp_path):
    """Missing values are NaN and raise no exception."""
    sections = judged(Book(plan=PLAN, flights={}))
    draw_figures(sections.values(), tmp_path)
    checks = [check for section in sections.values() for check in section.checks]
    assert len(missed(sections)) == len(checks) > 10


def fake_study(*, places_ned_m, runs, trouble, batch, **_):
    """Ten runs of 8 UAVs have 130 degrees of freedom: the mean NEES of a consistent filter is 13.

    With losses it is above its band, with 4 UAVs below it.
    """
    nees = 9.9 if len(places_ned_m) == 4 else 16.1 if trouble.loss else 14.0
    return LocalisationResult(
        runs=runs, bound_m=0.1,
        filter_m=0.149 if batch else 0.2, batch_m=0.12 if batch else None, predicted_m=0.1,
        nees=nees, nees_band=(10.0, 16.0),
    )  # fmt: skip


def test_studies_are_stored_by_state_and_number_of_runs(tmp_path, monkeypatch):
    """Only the article's geometry must be within 1.5 times the bound."""
    monkeypatch.setattr(estimator_section, "START_METHOD", "fork")
    monkeypatch.setattr(estimator_section, "localisation_study", fake_study)
    seen = []

    def run_studies(plan):
        seen.clear()
        return estimator_section.studies(plan, tmp_path, workers=2, done=lambda *counts: seen.append(counts))

    first = run_studies(CodesignPlan(seeds=1))
    assert seen == [(done, 5) for done in range(6)]
    section = estimator_section.judge_estimator(first)
    assert [check.passed for check in section.checks] == [False, True, True]  # ten runs are too few
    assert section.checks[1].value == pytest.approx(1.49)
    (table,) = section.tables
    assert [row[0] for row in table.rows] == ["8", "8", "8", "4", "16"]
    cells = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    verdicts = [row["consistent"] for row in cells]
    assert verdicts == ["yes", "**overconfident**", "yes", "**too cautious**", "yes"]
    assert [row["expected"] for row in cells] == ["13", "13", "13", "5", "29"]
    assert (cells[0]["filter predicts"], cells[0]["batch over bound"]) == ("0.100", "1.20")
    assert "distances of the last 4 s" in section.conditions
    monkeypatch.setattr(estimator_section, "localisation_study", None)  # no study is repeated ...
    assert run_studies(CodesignPlan(seeds=1)) == first
    assert seen == [(5, 5)]
    monkeypatch.setattr(estimator_section, "localisation_study", fake_study)
    assert run_studies(CodesignPlan(seeds=2)) != first  # ... except with another number of runs
    enough = estimator_section.judge_estimator(run_studies(CodesignPlan(seeds=10)))
    assert [check.passed for check in enough.checks] == [True, True, True]
    run_studies(CodesignPlan(seeds=1))
    assert seen == [(5, 5)]
    with monkeypatch.context() as patch:
        patch.setattr(estimator_section, "_SEED", 6)
        run_studies(CodesignPlan(seeds=1))
        assert seen[0] == (0, 5)
    monkeypatch.setattr(estimator_section, "_state", lambda: "another")
    run_studies(CodesignPlan(seeds=1))
    assert seen[0] == (0, 5)
