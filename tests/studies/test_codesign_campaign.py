"""Tests of the co-design experiment's campaign store, command line and page, without flights (10 s)."""

import csv
import json
import sys

import msgspec
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from foundation import exit_status
from harness.campaign.store import FAILED, CampaignError, Flown, Store
from harness.launch import one_process
from harness.launch.run_messages import SwarmError, SwarmTimeoutError
from studies.codesign import cli
from studies.codesign import measures as flown_measures
from studies.codesign.book import Book
from studies.codesign.cases import BASE, GPS_ALONE, LOSSY, QUICK, CodesignPlan, all_pairs, cut
from studies.codesign.introduction import command, introduction
from studies.codesign.measures import Measures
from studies.codesign.results import CodesignFlown, known, make_runs

PLAN = CodesignPlan(seeds=10, duration_s=30.0)


# ---- a campaign on disk


def measures(**numbers):
    return Measures(
        **{
            "formed_s": 20.0, "simulated_s": 50.0, "wall_s": 10.0, "real_time_factor": 5.0, "collisions": 0,
            "first_collision_s": None, "down": 0, "least_distance_m": 2.0,
        } | numbers
    )  # fmt: skip


def flown(run, *, state="", **numbers):
    """Return a flight as it is read from the store."""
    return CodesignFlown(
        case=run.case, seed=run.seed, digest=run.digest, measures=measures(**numbers), state=state
    )


def put(store, run, state, **numbers):
    """Store a flight as a worker returns it."""
    summary = {"scenario": run.case, "seed": run.seed, "status": "completed"}
    summary["measures"] = msgspec.to_builtins(measures(**numbers))
    store.put(
        Flown(digest=run.digest, status="completed", summary=summary, settings=run.settings, state=state), {}
    )


def test_stored_flights_are_known_by_state_and_settings(tmp_path):
    """Flights of other sources are used only on request, and never those of other durations."""
    plan, cases = CodesignPlan(seeds=2), (BASE, GPS_ALONE, LOSSY, BASE)
    runs = make_runs(cases, plan, of_state="one")
    assert [(run.case, run.seed) for run in runs] == [
        (case.name, seed) for seed in (1, 2) for case in (BASE, GPS_ALONE, LOSSY)
    ]
    assert make_runs((all_pairs(16, 0.25), BASE), plan, of_state="")[-1].case.startswith("ftm-16")
    store = Store(tmp_path)
    for run in runs[1:]:
        put(store, run, "one", shape_m=0.1 * run.seed)
    store.put(Flown(digest=runs[0].digest, status=FAILED, reason="fell into the sea", state="one"), {})
    there = known(runs, store)
    assert len(there) == len(runs)
    assert there[BASE.name, 1].broken == "fell into the sea"
    assert there[BASE.name, 2].measures.shape_m == pytest.approx(0.2)
    assert {each.state for each in there.values()} == {"one"}
    assert known(runs, store, retry=True).keys() == there.keys() - {(BASE.name, 1)}
    later = make_runs(cases, plan, of_state="another")
    assert known(later, store) == {}
    assert known(later, store, stale=True) == {key: there[key] for key in there if key != (BASE.name, 1)}
    put(store, later[1], "another", shape_m=7.0)
    assert known(later, store, stale=True)[GPS_ALONE.name, 1].measures.shape_m == 7.0
    assert known(runs, store, stale=True)[GPS_ALONE.name, 1].measures.shape_m == pytest.approx(0.1)
    shorter = make_runs(cases, replace(plan, duration_s=8.0), of_state="one")
    assert known(shorter, store) == known(shorter, store, stale=True) == {}  # other fault times


def test_folder_is_locked_for_one_campaign(tmp_path, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    with Store(tmp_path).alone():
        with pytest.raises(CampaignError, match="another campaign"), Store(tmp_path).alone():
            pass
        result = run_cli("--only", "baselines", "--data", tmp_path)
        assert result.exit_code == exit_status.BAD_INPUT
        assert "another campaign" in " ".join(result.stderr.split())  # the line may be wrapped


def test_pairs_have_the_same_state_of_the_sources():
    """Of three seeds, one has its second flight from other sources, and one has no second flight."""
    states = {(BASE.name, 1): "a", (BASE.name, 2): "a", (BASE.name, 3): "a"}
    states |= {(LOSSY.name, 1): "a", (LOSSY.name, 2): "b"}
    flights = {}
    for run in make_runs((BASE, LOSSY), replace(PLAN, seeds=3), of_state="a"):
        if state := states.get((run.case, run.seed)):
            flights[run.case, run.seed] = flown(run, state=state, shape_m=0.1 * run.seed)
    book = Book(plan=replace(PLAN, seeds=3), flights=flights)
    assert [(a.shape_m, b.shape_m) for a, b in book.pairs(BASE, LOSSY)] == [(0.1, 0.1)]
    assert book.ratio(LOSSY, BASE, "shape_m").count == 1
    assert book.mean(BASE, "shape_m").count == 3


def fly_timed_out(*_, **__):
    raise SwarmTimeoutError("the physics server is silent")


def test_flight_with_an_infrastructure_failure_is_broken(tmp_path, monkeypatch):
    """A timeout means that the formation was not reached, unless the infrastructure caused it."""
    (run,) = make_runs((BASE,), CodesignPlan(seeds=1), of_state="")
    for status, reason in (("failed", "the physics server is silent"), ("not_formed", None)):

        class Silent:
            summary = staticmethod(
                lambda *_, status=status, **__: {
                    "scenario": "article", "seed": 1, "status": status,
                    "reason": "the physics server is silent", "formed_s": None, "wall_s": 1.0,
                }
            )  # fmt: skip
            run_until_formed = staticmethod(fly_timed_out)

            def __init__(self, *_, **__):
                pass

            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

        monkeypatch.setattr(one_process, "OneProcessSwarm", Silent)
        monkeypatch.setattr(flown_measures, "read_tables", lambda *_: None)
        monkeypatch.setattr(flown_measures, "measure", lambda *_, **__: measures())
        if reason is None:
            summary = flown_measures.fly(run.scenario, tmp_path, **run.options)
            assert (summary["status"], summary["measures"]["down"]) == (status, 0)
        else:
            with pytest.raises(SwarmError, match=reason):
                flown_measures.fly(run.scenario, tmp_path, **run.options)


# ---- the command line


@pytest.fixture
def no_flying(monkeypatch):
    """A campaign whose flights are stored at once and counted; one breaks at first."""
    flights = []

    def fly_here(_campaign, *, out, runs, **_):
        for run in runs:
            first = (run.case, run.seed) not in {(each.case, each.seed) for each in flights}
            flights.append(run)
            if (run.case, run.seed) == (BASE.name, 2) and first:
                Store(out).put(Flown(digest=run.digest, status=FAILED, reason="SwarmError: lost"), {})
            else:
                put(Store(out), run, "", shape_m=0.2, busy_fraction=0.05, completed_fraction=1.0)

    monkeypatch.setattr(cli, "run", fly_here)
    monkeypatch.setattr(cli.kernel_cache, "prepare", lambda _: None)
    return flights


def run_cli(*arguments):
    return CliRunner().invoke(cli.codesign_app, [str(argument) for argument in arguments])


def test_second_run_flies_nothing_and_writes_the_same_page(tmp_path, no_flying, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    arguments = ("--only", "baselines", "--data", tmp_path / "data", "--out", tmp_path / "docs")
    first = run_cli(*arguments)
    assert first.exit_code == exit_status.FAILED, first.output
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
    assert second.exit_code == exit_status.FAILED
    assert len(no_flying) == 40
    assert (tmp_path / "docs" / "codesign-results.md").read_text() == page
    retried = run_cli(*arguments, "--retry")
    assert retried.exit_code == exit_status.FINE
    assert [(run.case, run.seed) for run in no_flying[40:]] == [(BASE.name, 2)]
    longer = run_cli(*arguments, "--duration", 40)
    assert longer.exit_code == exit_status.FINE
    assert len(no_flying) == 40 + 1 + 40


def introduction_text(flights, runs, **changed):
    """Return the introduction without line breaks."""
    text = introduction(Book(plan=PLAN, flights=flights), runs, made_by=command(PLAN), **changed)
    return " ".join(text.split())


def test_introduction_states_flights_and_sources():
    """Of four cases one has no flight, one two and the others three; an outage of 10 s takes 40 s."""
    cases = (BASE, cut(PLAN), LOSSY, GPS_ALONE)
    runs = make_runs(cases, PLAN, of_state="now")
    flights = {}
    for run in runs:
        if run.case != GPS_ALONE.name and run.seed <= 3 - (run.case == LOSSY.name):
            flights[run.case, run.seed] = flown(run, state="now")
    text = introduction_text(flights, runs)
    assert "from 8 flights of `scenarios/article.toml`" in text
    assert "30 to 40 s in formation each as planned" in text
    assert "2 to 3 of each of 3 cases, and none of 1 more." in text
    assert "7 minutes were simulated in 1 minutes of wall time" in text  # 8 of 50 s, in 10 s each
    assert "the same sources give the same numbers" in text
    assert "the current one" not in text
    flights[BASE.name, 1] = replace(flights[BASE.name, 1], digest="other", state="before")
    text = introduction_text(flights, runs)
    assert "1 of the flights are of other states of the sources than the current one**, 2 states" in text
    assert "same sources" not in text
    assert "same winds" not in text
    assert "cannot be assigned to one state" not in text
    assert "cannot be assigned to one state" in introduction_text(flights, runs, changed=True)
    assert "without a flight of any of the 4 cases" in introduction_text({}, runs)
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
    assert result.exit_code == exit_status.FAILED
    numbers = {each["name"]: each for each in json.loads(result.stdout)["checks"]}
    assert numbers["shape error with FTM, 8 UAVs, 5 N, mean"]["met"] is True
    assert numbers["shape error with GPS alone over that with FTM, same case"]["value"] == pytest.approx(1.0)
    assert numbers["shape error with GPS alone over that with FTM, same case"]["at_least"] == 5.0


def test_unknown_group_is_a_one_line_error():
    result = run_cli("--only", "wind_agents,nonsense")
    assert result.exit_code == exit_status.BAD_INPUT
    assert "nonsense" in result.stderr
    assert result.stderr.count("\n") <= 2
