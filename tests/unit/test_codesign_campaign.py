"""The co-design experiment's campaign on disk, its judgement and its page, without flights (15 s)."""

import csv
import json
import math
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from harness import one_process
from harness.codesign import cli, estimator_section, flights, results
from harness.codesign.book import Book
from harness.codesign.cases import (
    BASE,
    BEACON_PERIODS_MS,
    GPS_ALONE,
    LIAR,
    LIAR_FROM_START,
    LOSSY,
    Plan,
    all_pairs,
    cut,
    groups,
    liar_in_flight,
    wavelength,
)
from harness.codesign.measures import TRACK_PERIOD_S, Measures
from harness.codesign.results import CampaignError, Flown, Store, fly_tasks, known, make_tasks, sources_state
from harness.codesign.study import LocalisationResult
from harness.faults import RangingBias
from harness.processes import SwarmError, SwarmTimeoutError
from harness.validation.command import BAD_INPUT, FINE, MISSED

PLAN = Plan(seeds=10, duration_s=30.0)


# ---- a campaign on disk


def flown(task, **numbers):
    measures = Measures(
        **{
            "formed_s": 20.0, "simulated_s": 50.0, "wall_s": 10.0, "real_time_factor": 5.0, "collisions": 0,
            "first_collision_s": None, "down": 0, "least_distance_m": 2.0,
        } | numbers
    )  # fmt: skip
    return Flown(case=task.case, seed=task.seed, digest=task.digest, measures=measures)


def fly_noted(task):
    """Leave a mark of each flight; one breaks, one kills its process, all others land."""
    marks = Path(task.folder).parents[1] / "marks"
    with marks.open("a") as file:
        file.write(f"{task.case} {task.seed}\n")
    if task.case == LOSSY.name and task.seed == 2:
        return Flown(case=task.case, seed=task.seed, digest=task.digest, broken="fell into the sea")
    if task.case == GPS_ALONE.name and task.seed == 1:
        deadline_s = time.monotonic() + 20.0
        while len(marks.read_text().splitlines()) < 3 and time.monotonic() < deadline_s:
            time.sleep(0.01)  # until somebody else is in the air, or has been
        os._exit(3)
    return flown(task, shape_m=0.1 * task.seed)


def marks_of(folder):
    marks = folder / "marks"
    return marks.read_text().splitlines() if marks.exists() else []


def test_a_campaign_flies_each_flight_once_and_goes_on_after_losses(tmp_path, monkeypatch):
    """A killed worker costs its own flight alone; a second run flies nothing; a changed one flies anew."""
    monkeypatch.setattr(results, "START_METHOD", "fork")  # spawned ones would import all of this
    monkeypatch.setattr(results, "sources_state", lambda: "one")
    plan, cases = Plan(seeds=2), (BASE, GPS_ALONE, LOSSY, BASE)
    tasks = make_tasks(cases, plan, folder=tmp_path, state="one")
    assert [(task.case, task.seed) for task in tasks] == [
        (case.name, seed) for seed in (1, 2) for case in (BASE, GPS_ALONE, LOSSY)
    ]
    assert make_tasks((all_pairs(16, 0.25), BASE), plan, folder=tmp_path)[-1].case.startswith("ftm-16")
    store, heard = Store(tmp_path), []
    fly_tasks(tasks, store, fly_noted, workers=2, done=heard.append)
    assert sorted((each.case, each.seed) for each in heard) == sorted(
        (each.case, each.seed) for each in tasks
    )
    reasons = {(each.case, each.seed): each.broken for each in store.flights() if each.broken}
    assert reasons == {(GPS_ALONE.name, 1): "its process died", (LOSSY.name, 2): "fell into the sea"}
    with store.path.open("ab") as file:
        file.write(b'{"case": "ftm-8-5n", "seed": 1, "dig')  # killed while it wrote
    there = known(tasks, Store(tmp_path))
    assert len(there) == len(tasks)
    assert there[BASE.name, 2].measures.shape_m == pytest.approx(0.2)
    store.append(flown(tasks[0], shape_m=7.0))
    assert known(tasks, store)[BASE.name, 1].measures.shape_m == 7.0  # the latest, on a line of its own
    assert {each.state for each in known(tasks, store).values()} == {"one"}  # also of that without a note
    later = make_tasks(cases, plan, folder=tmp_path, state="another")
    assert known(later, store) == {}
    assert len(known(later, store, stale=True)) == len(tasks)
    shorter = make_tasks(cases, replace(plan, duration_s=8.0), folder=tmp_path, state="one")
    assert known(shorter, store) == known(shorter, store, stale=True) == {}  # cuts and lies come elsewhere
    with pytest.raises(CampaignError, match="the sources have changed"):
        fly_tasks(later, store, fly_noted, workers=2, done=heard.append)
    assert len(heard) == len(tasks)


def test_two_campaigns_do_not_fly_into_one_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    with Store(tmp_path).alone():
        with pytest.raises(CampaignError, match="another campaign"), Store(tmp_path).alone():
            pass
        result = run_cli("--only", "baselines", "--data", tmp_path)
        assert result.exit_code == BAD_INPUT
        assert "another campaign" in result.stderr
    with Store(tmp_path).alone():
        pass


def test_pairs_are_of_one_state_of_the_sources():
    """Of three seeds one has its second flight by other sources, and one has none."""
    states = {(BASE.name, 1): "a", (BASE.name, 2): "a", (BASE.name, 3): "a"}
    states |= {(LOSSY.name, 1): "a", (LOSSY.name, 2): "b"}
    flights = {}
    for task in make_tasks((BASE, LOSSY), replace(PLAN, seeds=3), folder=Path(), state="a"):
        if (task.case, task.seed) in states:
            flights[task.case, task.seed] = replace(
                flown(task, shape_m=0.1 * task.seed), state=states[task.case, task.seed]
            )
    book = Book(plan=replace(PLAN, seeds=3), flights=flights)
    assert [(a.shape_m, b.shape_m) for a, b in book.pairs(BASE, LOSSY)] == [(0.1, 0.1)]
    assert book.ratio(LOSSY, BASE, "shape_m").count == 1
    assert book.mean(BASE, "shape_m").count == 3


def fly_timed_out(*_, **__):
    raise SwarmTimeoutError("the physics server is silent")


def test_a_flight_whose_machinery_failed_is_broken(tmp_path, monkeypatch):
    """A timeout is a formation that was not reached, unless it is the machinery's."""
    (task,) = make_tasks((BASE,), Plan(seeds=1), folder=tmp_path)
    for status, reason in (("failed", "the physics server is silent"), ("not_formed", None)):

        class Silent:
            summary = staticmethod(
                lambda *_, status=status, **__: {
                    "status": status, "reason": "the physics server is silent", "formed_s": None,
                    "wall_s": 1.0,
                }
            )  # fmt: skip
            run_until_formed = staticmethod(fly_timed_out)

            def __init__(self, *_, **__):
                pass

            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

        monkeypatch.setattr(flights, "OneProcessSwarm", Silent)
        monkeypatch.setattr(one_process, "OneProcessSwarm", Silent)
        monkeypatch.setattr(flights, "read_tables", lambda *_: None)
        monkeypatch.setattr(flights, "measure", lambda *_, **__: flown(task).measures)
        result = flights.fly_task(task)
        assert result.broken == (None if reason is None else f"SwarmError: {reason}")
        if reason is None:
            assert one_process.fly(task.scenario, tmp_path)["status"] == status
        else:
            with pytest.raises(SwarmError, match=reason):
                one_process.fly(task.scenario, tmp_path)


def test_the_state_of_the_sources_is_what_they_do(tmp_path):
    """Comments, docstrings and layout change nothing; a number does, wherever it flies."""
    for package in ("antenna", "netsim", "autopilot", "harness/codesign"):
        (tmp_path / package).mkdir(parents=True)
    flying, telling = tmp_path / "autopilot" / "a.py", tmp_path / "harness" / "codesign" / "cli.py"
    flying.write_text('"""One."""\n\n\ndef f(x):\n    """Two."""\n    return x + 1\n')
    telling.write_text("A = 1\n")
    first = sources_state(tmp_path)
    sources_state.cache_clear()
    flying.write_text('"""Three."""\ndef f(x):\n    # four\n    return (x + 1)\n')
    telling.write_text("A = 2\n")
    assert sources_state(tmp_path) == first
    sources_state.cache_clear()
    flying.write_text("def f(x):\n    return x + 2\n")
    assert sources_state(tmp_path) != first
    sources_state.cache_clear()


# ---- judgement


def made_up(
    plan,
    *,
    ftm_m=0.2,
    gps_m=1.5,
    liar_pull_m=0.0,
    liar_shift_m=0.0,
    recovers=True,
    drop_grows=1.2,
    drops=0.3,
    cuts=True,
    tells=True,
):
    """A book in which everything was flown: ``ftm_m`` of shape error give or take a twentieth by seed."""
    rng = np.random.default_rng(10)
    flights = {}
    for case in {case.name: case for members in groups(plan).values() for case in members}.values():
        for seed in range(1, plan.seeds + 1):
            luck = 1.0 + 0.05 * np.random.default_rng(seed).standard_normal()
            shape_m = luck * (gps_m if case.localisation == "gps" else ftm_m)
            if case.drop_fraction:
                shape_m *= drop_grows
            instants = round((plan.duration_s + case.longer_s) / TRACK_PERIOD_S)
            track_ne_m = np.random.default_rng([seed, 1]).normal(
                0.0, shape_m / math.sqrt(2), (instants, case.agents, 2)
            )
            lies = tells and (case.lies or any(isinstance(fault, RangingBias) for fault in case.faults))
            if lies:
                begin = 0 if case.lies else round(plan.liar_after_s / TRACK_PERIOD_S)
                track_ne_m[begin:, 0, 0] += liar_pull_m
                track_ne_m[begin:, :, 1] += liar_shift_m
            if case == cut(plan):
                begin = round(plan.cut_s / TRACK_PERIOD_S)
                track_ne_m[begin : 2 * begin + 20 if recovers else None] *= 4.0
            track_mm = np.rint(1e3 * track_ne_m).astype(int)
            collided = case.localisation == "gps" and seed % 2
            numbers = {
                "formed_s": 18.0, "simulated_s": 48.0, "wall_s": 10.0, "real_time_factor": 4.8,
                "collisions": int(collided), "first_collision_s": 40.0 if collided else None,
                "down": 2 * int(collided), "least_distance_m": 0.4 if collided else 1.9,
                "least_distance_formed_m": 1.9, "shape_m": shape_m, "shape_whole_m": shape_m,
                "absolute_m": 1.5, "vertical_m": 0.1, "estimate_m": 0.7 * shape_m, "control_m": 0.7 * shape_m,
                "busy_fraction": 0.02 * case.agents, "sessions_per_s": 56.0,
                "completed_fraction": 0.98 * (1.0 - drops * bool(case.drop_fraction)),
                "beacons_lost_fraction": drops * bool(case.drop_fraction),
                "longest_silence_s": plan.cut_s if case == cut(plan) and cuts else 0.1,
                "range_offsets_m": tuple(5.0 * (lies and i == LIAR) for i in range(case.agents)),
                "gain_dbi": tuple(rng.normal(13.0, 0.1, 30)) if case.gains else (),
                "track_mm": tuple(map(tuple, track_mm.reshape(instants, -1).tolist())),
            }  # fmt: skip
            flights[case.name, seed] = Flown(
                case=case.name, seed=seed, digest="x", measures=Measures(**numbers)
            )
    return Book(plan=plan, flights=flights)


def judged(book, images=None):
    return {name: judge(book, images) for name, judge in cli.JUDGES.items()}


def missed(sections):
    return [check.name for section in sections.values() for check in section.checks if not check.passed]


def test_a_campaign_that_meets_everything_passes_and_is_drawn(tmp_path):
    sections = judged(made_up(PLAN), tmp_path)
    assert missed(sections) == []
    drawn = [name for section in sections.values() for name, _ in section.figures]
    assert len(drawn) == 6
    assert all((tmp_path / name).stat().st_size > 10_000 for name in drawn)
    checks = {check.name: check for section in sections.values() for check in section.checks}
    assert checks["GPS alone over FTM there"].value == pytest.approx(1.5 / 0.2)
    (rows,) = [table.rows for table in sections["wavelength"].tables]
    assert len(rows) == 8
    cell = dict(zip(sections["wavelength"].tables[0].columns, rows[-1], strict=True))
    assert (cell["λ m"], cell["wind N"], cell["positions by"]) == ("10", "5", "with FTM")
    assert float(cell["σ horizontal m"]) == pytest.approx(0.2 / math.sqrt(1.625), rel=0.06)
    assert cell["expected for σ/λ dBi"].startswith("13.1")
    assert "collides in 5 of 10 flights" in sections["wavelength"].tables[0].caption
    assert len(sections["beacon_period"].tables[0].rows) == len(BEACON_PERIODS_MS)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"ftm_m": 0.26, "gps_m": 2.0}, ["shape error with FTM, 8 UAVs, 5 N, mean"]),
        ({"gps_m": 0.97}, ["GPS alone over FTM there"]),
        ({"drop_grows": 1.55}, ["30% of beacons and distances lost: growth of the shape error"]),
        (
            {"drops": 0.2},
            [
                "losses: share of the beacons that arrived",
                "losses: share of ranging sessions that complete",
            ],
        ),
        ({"cuts": False}, ["cut: time without any distance, shortest"]),
        ({"tells": False}, ["liar: error of the distances that it measures, median, smallest"]),
        ({"recovers": False}, ["cut: recovery from the channel's return, slowest"]),
        (
            {"liar_pull_m": 0.8},
            [
                "liar in flight: displacement of another within the shape over 2 s, largest",
                "liar in flight: displacement of another in space over 2 s, largest",
                "liar from the start: lasting displacement of another within the shape, largest",
            ],
        ),
        ({"liar_shift_m": 0.4}, ["liar in flight: displacement of another in space over 2 s, largest"]),
    ],
)
def test_each_line_is_judged_by_its_own_number(changes, expected):
    assert missed(judged(made_up(PLAN, **changes))) == expected


def test_too_few_flights_are_not_enough():
    """Every section that judges anything says so: wind, antenna, troubles."""
    names = missed(judged(made_up(replace(PLAN, seeds=4))))
    assert names.count("flights that formed, fewest") == 3
    assert [name for name in names if name != "flights that formed, fewest"] == [
        "pairs of flights, GPS alone and FTM",
        "pairs of flights, with and without losses",
        "pairs of flights, with and without a liar in flight",
        "pairs of flights, with and without a liar from the start",
    ]


@pytest.mark.parametrize("case", [LOSSY, LIAR_FROM_START, liar_in_flight(PLAN), cut(PLAN)])
def test_a_flight_that_did_not_form_is_missed(case):
    """It has neither errors nor a track, and its pair none to compare with."""
    book = made_up(PLAN)
    old = book.flights[case.name, 3]
    nowhere = replace(old, measures=replace(old.measures, formed_s=None, shape_m=None, track_mm=()))
    names = missed(judged(replace(book, flights=dict(book.flights) | {(case.name, 3): nowhere})))
    assert names[0] == "flights that formed, fewest"
    assert len(names) == (1 if case == cut(PLAN) else 2)


def test_a_track_that_ends_before_the_lie_is_no_pass():
    book, case = made_up(PLAN), liar_in_flight(PLAN)
    old = book.flights[case.name, 3]
    short = replace(old, measures=replace(old.measures, track_mm=old.measures.track_mm[:5]))
    names = missed(judged(replace(book, flights=dict(book.flights) | {(case.name, 3): short})))
    assert names == [
        "liar in flight: displacement of another within the shape over 2 s, largest",
        "liar in flight: displacement of another in space over 2 s, largest",
    ]


def test_a_collision_at_five_metres_is_seen():
    book = made_up(PLAN)
    tight = wavelength("ftm", 5, 2)
    old = book.flights[tight.name, 3]
    bumped = replace(old, measures=replace(old.measures, collisions=1))
    lost = replace(old, measures=None, broken="no vehicle is left")
    for changed, expected in (
        (bumped, ["λ = 5 m, 2 N, FTM: flights with a collision"]),
        (lost, ["flights that formed, fewest"]),
    ):
        worse = replace(book, flights=dict(book.flights) | {(tight.name, 3): changed})
        assert missed(judged(worse)) == expected


def test_nothing_flown_is_nothing_met(tmp_path):
    """No number is made up, and nothing breaks for the lack of them."""
    sections = judged(Book(plan=PLAN, flights={}), tmp_path)
    checks = [check for section in sections.values() for check in section.checks]
    assert len(missed(sections)) == len(checks) > 10


def fake_study(setting, runs):
    """Ten runs of 8 UAVs have 130 degrees of freedom: the mean NEES of a consistent filter is 13."""
    return LocalisationResult(
        count=setting.agents, loss=setting.loss, scheduled=setting.scheduled, runs=runs, bound_m=0.1,
        filter_m=0.149 if setting.batch else 0.2, batch_m=0.12 if setting.batch else None, predicted_m=0.1,
        nees=14.0, nees_band=(10.0, 16.0),
    )  # fmt: skip


def test_studies_are_done_once_for_a_state_and_a_number_of_runs(tmp_path, monkeypatch):
    """Only the article's geometry is held to 1.5 times the bound."""
    monkeypatch.setattr(estimator_section, "START_METHOD", "fork")
    monkeypatch.setattr(estimator_section, "study", fake_study)
    seen = []

    def go(plan):
        seen.clear()
        return estimator_section.studies(plan, tmp_path, workers=2, done=lambda *told: seen.append(told))

    first = go(Plan(seeds=1))
    assert seen == [(done, 5) for done in range(6)]
    section = estimator_section.judge_estimator(first)
    assert [check.passed for check in section.checks] == [False, True, True]  # ten runs are not enough
    assert section.checks[1].value == pytest.approx(1.49)
    assert [row[0] for row in section.tables[0].rows] == ["8", "8", "8", "4", "16"]
    monkeypatch.setattr(estimator_section, "study", None)  # nothing is studied again ...
    assert go(Plan(seeds=1)) == first
    assert seen == [(5, 5)]
    monkeypatch.setattr(estimator_section, "study", fake_study)
    assert go(Plan(seeds=2)) != first  # ... but for another number of runs
    enough = estimator_section.judge_estimator(go(Plan(seeds=10)))
    assert [check.passed for check in enough.checks] == [True, True, True]
    go(Plan(seeds=1))
    assert seen == [(5, 5)]
    with monkeypatch.context() as patch:
        patch.setattr(estimator_section, "_SEED", 6)
        go(Plan(seeds=1))
        assert seen[0] == (0, 5)
    monkeypatch.setattr(estimator_section, "_state", lambda: "another")
    go(Plan(seeds=1))
    assert seen[0] == (0, 5)


# ---- the command line


def fly_made_up(task):
    return flown(task, shape_m=0.2, busy_fraction=0.05, completed_fraction=1.0)


@pytest.fixture
def no_flying(monkeypatch):
    """A campaign whose flights land at once, in this process, and are counted."""
    flights = []

    def fly_here(tasks, store, _fly, *, done, **_):
        for task in tasks:
            result = fly_made_up(task)
            if (task.case, task.seed) == (BASE.name, 2):
                result = Flown(case=task.case, seed=task.seed, digest=task.digest, broken="SwarmError: lost")
            flights.append(task)
            store.append(result)
            done(result)

    monkeypatch.setattr(cli, "fly_tasks", fly_here)
    monkeypatch.setattr(cli.kernel_cache, "prepare", lambda _: None)
    return flights


def run_cli(*arguments):
    return CliRunner().invoke(cli.codesign_app, [str(argument) for argument in arguments])


def test_a_second_run_flies_nothing_and_writes_the_same_page(tmp_path, no_flying, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    arguments = (
        "--only", "baselines", "--seeds", 3, "--data", tmp_path / "data", "--out", tmp_path / "docs",
    )  # fmt: skip
    first = run_cli(*arguments)
    assert first.exit_code == FINE, first.output
    assert len(no_flying) == 4 * 3
    page = (tmp_path / "docs" / "codesign-results.md").read_text()
    assert "| FTM over the emulated channel | 0.200 (0.200 to 0.200) |" in page
    assert "- ftm-8-5n, seed 2: SwarmError: lost" in page
    assert "12 flights" in page
    with (tmp_path / "docs" / "codesign-flights.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 11
    assert {row["shape_m"] for row in rows} == {"0.2"}
    assert not {"wall_s", "real_time_factor"} & rows[0].keys()  # the same sources write the same tables
    with (tmp_path / "docs" / "codesign-cases.csv").open() as file:
        means = {row["case"]: row for row in csv.DictReader(file)}
    assert (means[BASE.name]["flights"], means[GPS_ALONE.name]["flights"]) == ("2", "3")
    second = run_cli(*arguments)
    assert second.exit_code == FINE
    assert len(no_flying) == 12
    assert (tmp_path / "docs" / "codesign-results.md").read_text() == page
    retried = run_cli(*arguments, "--retry")
    assert retried.exit_code == FINE
    assert [(task.case, task.seed) for task in no_flying[12:]] == [(BASE.name, 2)]
    longer = run_cli(*arguments, "--duration", 40)
    assert longer.exit_code == FINE
    assert len(no_flying) == 12 + 1 + 12


@pytest.mark.usefixtures("no_flying")
def test_json_is_the_checks_and_unmet_ones_are_the_exit_status(tmp_path, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    result = run_cli("--only", "wind_agents", "--quick", "--json", "--data", tmp_path)
    assert result.exit_code == MISSED
    numbers = {each["name"]: each for each in json.loads(result.stdout)}
    assert numbers["shape error with FTM, 8 UAVs, 5 N, mean"]["met"] is True
    assert numbers["GPS alone over FTM there"]["value"] == pytest.approx(1.0)
    assert numbers["GPS alone over FTM there"]["at_least"] == 5.0


def test_an_unknown_group_is_one_line():
    result = run_cli("--only", "wind_agents,nonsense")
    assert result.exit_code == BAD_INPUT
    assert "nonsense" in result.stderr
    assert result.stderr.count("\n") <= 2
