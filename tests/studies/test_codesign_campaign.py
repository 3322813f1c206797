"""Tests of the co-design experiment's campaign store, command line and page, without flights (10 s)."""

import csv
import json
import os
import sys
import time
from pathlib import Path

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from harness.launch import one_process
from harness.launch.processes import SwarmError, SwarmTimeoutError
from studies.codesign import cli, flights, results
from studies.codesign.book import Book
from studies.codesign.cases import BASE, GPS_ALONE, LOSSY, QUICK, CodesignPlan, all_pairs, cut
from studies.codesign.introduction import command, introduction
from studies.codesign.measures import Measures
from studies.codesign.results import (
    CampaignError,
    CodesignFlown,
    CodesignStore,
    fly_tasks,
    known,
    make_tasks,
    sources_state,
)
from studies.common.command_line import BAD_INPUT, FINE, MISSED

PLAN = CodesignPlan(seeds=10, duration_s=30.0)


# ---- a campaign on disk


def flown(task, **numbers):
    measures = Measures(
        **{
            "formed_s": 20.0, "simulated_s": 50.0, "wall_s": 10.0, "real_time_factor": 5.0, "collisions": 0,
            "first_collision_s": None, "down": 0, "least_distance_m": 2.0,
        } | numbers
    )  # fmt: skip
    return CodesignFlown(case=task.case, seed=task.seed, digest=task.digest, measures=measures)


def fly_recorded(task):
    """Record each flight in a file; one breaks, one kills its process, all others finish."""
    marks = Path(task.folder).parents[1] / "marks"
    with marks.open("a") as file:
        file.write(f"{task.case} {task.seed}\n")
    if task.case == LOSSY.name and task.seed == 2:
        return CodesignFlown(case=task.case, seed=task.seed, digest=task.digest, broken="fell into the sea")
    if task.case == GPS_ALONE.name and task.seed == 1:
        deadline_s = time.monotonic() + 20.0
        while len(marks.read_text().splitlines()) < 3 and time.monotonic() < deadline_s:
            time.sleep(0.01)  # until another flight has started
        os._exit(3)
    return flown(task, shape_m=0.1 * task.seed)


def marks_of(folder):
    marks = folder / "marks"
    return marks.read_text().splitlines() if marks.exists() else []


def test_campaign_flies_each_flight_once_and_continues_after_losses(tmp_path, monkeypatch):
    """A killed worker loses only its own flight; a second run flies nothing; changed sources repeat all."""
    monkeypatch.setattr(results, "START_METHOD", "fork")  # spawned workers would import this module
    monkeypatch.setattr(results, "sources_state", lambda: "one")
    plan, cases = CodesignPlan(seeds=2), (BASE, GPS_ALONE, LOSSY, BASE)
    tasks = make_tasks(cases, plan, folder=tmp_path, state="one")
    assert [(task.case, task.seed) for task in tasks] == [
        (case.name, seed) for seed in (1, 2) for case in (BASE, GPS_ALONE, LOSSY)
    ]
    assert make_tasks((all_pairs(16, 0.25), BASE), plan, folder=tmp_path)[-1].case.startswith("ftm-16")
    store, finished = CodesignStore(tmp_path), []
    fly_tasks(tasks, store, fly_recorded, workers=2, done=finished.append)
    assert sorted((each.case, each.seed) for each in finished) == sorted(
        (each.case, each.seed) for each in tasks
    )
    reasons = {(each.case, each.seed): each.broken for each in store.flights() if each.broken}
    assert reasons == {(GPS_ALONE.name, 1): "its process died", (LOSSY.name, 2): "fell into the sea"}
    with store.path.open("ab") as file:
        file.write(b'{"case": "ftm-8-5n", "seed": 1, "dig')  # killed during a write
    there = known(tasks, CodesignStore(tmp_path))
    assert len(there) == len(tasks)
    assert there[BASE.name, 2].measures.shape_m == pytest.approx(0.2)
    store.append(flown(tasks[0], shape_m=7.0))
    assert known(tasks, store)[BASE.name, 1].measures.shape_m == 7.0  # the latest, on a new line
    assert {each.state for each in known(tasks, store).values()} == {"one"}  # also for lines without a state
    later = make_tasks(cases, plan, folder=tmp_path, state="another")
    assert known(later, store) == {}
    assert len(known(later, store, stale=True)) == len(tasks)
    shorter = make_tasks(cases, replace(plan, duration_s=8.0), folder=tmp_path, state="one")
    assert known(shorter, store) == known(shorter, store, stale=True) == {}  # other fault times
    with pytest.raises(CampaignError, match="the sources changed"):
        fly_tasks(later, store, fly_recorded, workers=2, done=finished.append)
    assert len(finished) == len(tasks)


def test_folder_is_locked_for_one_campaign(tmp_path, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    with CodesignStore(tmp_path).alone():
        with pytest.raises(CampaignError, match="another campaign"), CodesignStore(tmp_path).alone():
            pass
        result = run_cli("--only", "baselines", "--data", tmp_path)
        assert result.exit_code == BAD_INPUT
        assert "another campaign" in " ".join(result.stderr.split())  # the line may be wrapped
    with CodesignStore(tmp_path).alone():
        pass


def test_pairs_have_the_same_state_of_the_sources():
    """Of three seeds, one has its second flight from other sources, and one has no second flight."""
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


def test_flight_with_an_infrastructure_failure_is_broken(tmp_path, monkeypatch):
    """A timeout means that the formation was not reached, unless the infrastructure caused it."""
    (task,) = make_tasks((BASE,), CodesignPlan(seeds=1), folder=tmp_path)
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


def test_source_state_ignores_comments_and_layout(tmp_path):
    """Comments, docstrings and layout do not change the state; a number in flight code does."""
    for package in ("antenna", "netsim", "autopilot", "harness/cli", "studies/codesign"):
        (tmp_path / package).mkdir(parents=True)
    for name in ("flights.py", "measures.py"):
        (tmp_path / "studies" / "codesign" / name).touch()
    flying, reporting = tmp_path / "autopilot" / "a.py", tmp_path / "harness" / "cli" / "fly.py"
    flying.write_text('"""One."""\n\n\ndef f(x):\n    """Two."""\n    return x + 1\n')
    reporting.write_text("A = 1\n")
    first = sources_state(tmp_path)
    sources_state.cache_clear()
    flying.write_text('"""Three."""\ndef f(x):\n    # four\n    return (x + 1)\n')
    reporting.write_text("A = 2\n")
    assert sources_state(tmp_path) == first
    sources_state.cache_clear()
    flying.write_text("def f(x):\n    return x + 2\n")
    assert sources_state(tmp_path) != first
    sources_state.cache_clear()


# ---- the command line


def fly_made_up(task):
    return flown(task, shape_m=0.2, busy_fraction=0.05, completed_fraction=1.0)


@pytest.fixture
def no_flying(monkeypatch):
    """A campaign whose flights finish at once in this process and are counted; one breaks at first."""
    flights = []

    def fly_here(tasks, store, _fly, *, done, **_):
        for task in tasks:
            result = fly_made_up(task)
            first = all(task.case != BASE.name or task.seed != 2 for task in flights)
            if (task.case, task.seed) == (BASE.name, 2) and first:
                result = CodesignFlown(
                    case=task.case, seed=task.seed, digest=task.digest, broken="SwarmError: lost"
                )
            result = replace(result, state=task.state, plan_s=task.plan_s)
            flights.append(task)
            store.append(result)
            done(result)

    monkeypatch.setattr(cli, "fly_tasks", fly_here)
    monkeypatch.setattr(cli.kernel_cache, "prepare", lambda _: None)
    return flights


def run_cli(*arguments):
    return CliRunner().invoke(cli.codesign_app, [str(argument) for argument in arguments])


def test_second_run_flies_nothing_and_writes_the_same_page(tmp_path, no_flying, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    arguments = ("--only", "baselines", "--data", tmp_path / "data", "--out", tmp_path / "docs")
    first = run_cli(*arguments)
    assert first.exit_code == MISSED, first.output
    assert len(no_flying) == 4 * 10
    page = (tmp_path / "docs" / "codesign-results.md").read_text()
    assert "    python scripts/experiment_codesign.py --only baselines --out docs/results\n" in page
    assert "| FTM over the emulated channel | 0.200 (0.200 to 0.200) |" in page
    assert "- ftm-8-5n, seed 2: SwarmError: lost" in page
    assert "from 39 flights" in page
    assert "9 to 10 of each of 4 cases." in " ".join(page.split())
    assert str(tmp_path) not in page
    with (tmp_path / "docs" / "codesign-flights.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 39
    assert {row["shape_m"] for row in rows} == {"0.2"}
    assert not {"wall_s", "real_time_factor"} & rows[0].keys()  # the same sources write the same tables
    with (tmp_path / "docs" / "codesign-cases.csv").open() as file:
        means = {row["case"]: row for row in csv.DictReader(file)}
    assert (means[BASE.name]["flights"], means[GPS_ALONE.name]["flights"]) == ("9", "10")
    second = run_cli(*arguments)
    assert second.exit_code == MISSED
    assert len(no_flying) == 40
    assert (tmp_path / "docs" / "codesign-results.md").read_text() == page
    retried = run_cli(*arguments, "--retry")
    assert retried.exit_code == FINE
    assert [(task.case, task.seed) for task in no_flying[40:]] == [(BASE.name, 2)]
    longer = run_cli(*arguments, "--duration", 40)
    assert longer.exit_code == FINE
    assert len(no_flying) == 40 + 1 + 40


def introduction_text(flights, tasks, **changed):
    """Return the introduction without line breaks."""
    text = introduction(Book(plan=PLAN, flights=flights), tasks, made_by=command(PLAN), **changed)
    return " ".join(text.split())


def test_introduction_states_flights_and_sources():
    """Of four cases one has no flight, one two and the others three; an outage of 10 s takes 40 s."""
    cases = (BASE, cut(PLAN), LOSSY, GPS_ALONE)
    tasks = make_tasks(cases, PLAN, folder=Path(), state="now")
    flights = {}
    for task in tasks:
        if task.case != GPS_ALONE.name and task.seed <= 3 - (task.case == LOSSY.name):
            flights[task.case, task.seed] = replace(flown(task), state="now")
    text = introduction_text(flights, tasks)
    assert "from 8 flights of `scenarios/article.toml`" in text
    assert "30 to 40 s in formation each as planned" in text
    assert "2 to 3 of each of 3 cases, and none of 1 more." in text
    assert "7 minutes were simulated in 1 minutes of wall time" in text  # 8 of 50 s, in 10 s each
    assert "the same sources give the same numbers" in text
    assert "the current one" not in text
    flights[BASE.name, 1] = replace(flights[BASE.name, 1], digest="other", state="before")
    text = introduction_text(flights, tasks)
    assert "1 of the flights are of other states of the sources than the current one**, 2 states" in text
    assert "same sources" not in text
    assert "same winds" not in text
    assert "cannot be assigned to one state" not in text
    assert "cannot be assigned to one state" in introduction_text(flights, tasks, changed=True)
    assert "without a flight of any of the 4 cases" in introduction_text({}, tasks)
    assert "from simulated measurements, without a flight" in introduction_text({}, [])


def test_page_names_its_command():
    program = "python scripts/experiment_codesign.py"
    assert command(CodesignPlan()) == program
    assert command(QUICK, quick=True) == f"{program} --quick"
    plan = replace(CodesignPlan(), seeds=3, duration_s=40.0)
    assert (
        command(plan, ("ranging", "trouble"), stale=True)
        == f"{program} --only ranging,trouble --seeds 3 --duration 40 --stale"
    )


@pytest.mark.usefixtures("no_flying")
def test_json_has_the_checks_and_failed_ones_set_the_exit_status(tmp_path, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    result = run_cli("--only", "wind_agents", "--quick", "--json", "--data", tmp_path)
    assert result.exit_code == MISSED
    numbers = {each["name"]: each for each in json.loads(result.stdout)}
    assert numbers["shape error with FTM, 8 UAVs, 5 N, mean"]["met"] is True
    assert numbers["shape error with GPS alone over that with FTM, same case"]["value"] == pytest.approx(1.0)
    assert numbers["shape error with GPS alone over that with FTM, same case"]["at_least"] == 5.0


def test_unknown_group_is_a_one_line_error():
    result = run_cli("--only", "wind_agents,nonsense")
    assert result.exit_code == BAD_INPUT
    assert "nonsense" in result.stderr
    assert result.stderr.count("\n") <= 2
