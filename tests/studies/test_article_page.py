"""Tests of plan, measures, page and command line of the reproduction, without flights (10 s)."""

import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pyarrow as pa
import pytest
from msgspec import structs
from rich.console import Console
from typer.testing import CliRunner

from antenna.solvers.nec2c import Nec2cFailed
from antenna.solvers.parallel import WorkerError, compute_patterns
from foundation import exit_status
from harness.campaign import CampaignError
from harness.campaign.definition import expand
from harness.records.flight import Flight
from harness.report import flown_array
from reference.exit_statuses import RESULTS
from studies.article import cli, page
from studies.article import retained_flights as kept_module
from studies.article.campaign_data import CSV_COLUMNS, csv_row, read_cells
from studies.article.evidence import Evidence
from studies.article.monte_carlo import WIND_PHIS_DEG, draw, ideal_gains
from studies.article.plan import (
    ARTICLE,
    CHANGES,
    CROWDED,
    CROWDED_FTM_PERIOD_S,
    EXPLAINING,
    KEPT,
    QUICK,
    UNCROWDED,
    ArticlePlan,
    campaigns,
)
from studies.article.retained_flights import (
    VARIANTS,
    FigurePatterns,
    figure_patterns_of,
    kept_flights,
    separate,
)
from studies.article.statements import STATEMENTS, judge_all
from studies.common.report import markdown

SMALL = ArticlePlan(seeds=2, duration_s=6.0, wavelengths_m=(5.0, 10.0), winds_n=(0.0, 5.0), draws=20)


# ---- plan


@pytest.mark.parametrize("plan", [ArticlePlan(), QUICK], ids=["whole", "quick"])
def test_all_flights_of_the_plans_have_valid_scenarios(plan):
    """All scenarios load; the article's campaign has each wavelength in each wind with each seed."""
    made = {name: expand(campaign, state="") for name, campaign in campaigns(plan).items()}
    combinations = {(*run.swept, run.seed) for run in made[ARTICLE]}
    assert len(combinations) == len(plan.wavelengths_m) * len(plan.winds_n) * plan.seeds
    assert {run.scenario.antenna.wavelength_m for run in made[ARTICLE]} == set(plan.wavelengths_m)
    assert {run.scenario.wind.mean_n for run in made[ARTICLE]} == set(plan.winds_n)
    assert {run.digest for run in made[KEPT]} <= {run.digest for run in made[ARTICLE]}  # flown once
    assert {run.case for run in made[EXPLAINING]} == set(CHANGES)
    crowded = made.get(CROWDED, [])
    by_case = {case: [run for run in crowded if run.case == case] for case in (CROWDED, UNCROWDED)}
    assert {len(runs) for runs in by_case.values()} == {plan.crowded_seeds}
    for often, usual in zip(by_case[CROWDED], by_case[UNCROWDED], strict=True):  # equal except the period
        assert often.seed == usual.seed
        assert often.scenario.onboard.ftm_period_s == CROWDED_FTM_PERIOD_S
        onboard = structs.replace(often.scenario.onboard, ftm_period_s=usual.scenario.onboard.ftm_period_s)
        assert structs.replace(often.scenario, onboard=onboard) == usual.scenario
    others = {run.digest for run in made[EXPLAINING] + by_case[CROWDED]}
    assert len(others) == len(made[EXPLAINING]) + plan.crowded_seeds  # each change has an effect
    assert not others & {run.digest for run in made[ARTICLE]}
    assert list(made)[-1] == ARTICLE  # its table remains in the folder
    assert all(campaign.keep for campaign in campaigns(plan).values())


# ---- values from tables


def table(campaign, *, gains, **columns):
    """Make a campaign's table with the series ``gains`` (by row) and the given columns."""
    runs = expand(campaign, state="")
    base = {"case": [run.case for run in runs]}
    for number, path in enumerate(campaign.sweep):
        base[path] = [run.swept[number] for run in runs]
    base["seed"] = [run.seed for run in runs]
    rows = pa.table(
        base | {name: [value(row) for row in range(len(runs))] for name, value in columns.items()}
    )
    return SimpleNamespace(
        runs=runs, rows=rows, column=lambda name: rows.column(name).to_pylist(),
        series=lambda row, name="gains": gains(row) if name == "gains" else None,
    )  # fmt: skip


def of_gains(values):
    return pa.table({"max_gain_dbi": pa.array(values, pa.float64())})


def test_cell_has_all_instants_of_its_seeds():
    """Seed 1: 12 and 13 dBi and a missing instant; seed 2 failed. The rms of one error is that error."""
    campaign = campaigns(SMALL)[ARTICLE]
    made = table(
        campaign, gains=lambda row: of_gains([12.0, None, 13.0 + row]) if row % 2 == 0 else None,
        **{
            "status": lambda row: "failed" if row % 2 else "completed",
            "collisions": lambda row: None if row % 2 else 2,
            "agents": lambda row: None if row % 2 else 8,
            "formation_rms_m.shape_horizontal": lambda row: None if row % 2 else 0.13,
            "ftm.requested": lambda row: None if row % 2 else 100,
            "ftm.completed": lambda row: None if row % 2 else 90,
        },
    )  # fmt: skip
    cells = read_cells(made)
    assert list(cells) == [(ARTICLE, w, n) for w in SMALL.wavelengths_m for n in SMALL.winds_n]
    first = cells[ARTICLE, 5.0, 0.0]
    assert first.max_gain_dbi.tolist() == [12.0, 13.0]
    assert (first.flights, first.completed, first.collided, first.missing) == (2, 1, 1, 1)
    assert (first.ftm_requested, first.ftm_completed, first.busy_fraction) == (100, 90, None)
    assert [run.seed for run in first.runs] == [1, 2]
    assert first.between_flights_db is None  # one flight has gains
    assert first.sigma_m == pytest.approx(0.13 / math.sqrt(2.0 - 3.0 / 8.0))  # 16 degrees of freedom less 3
    row = dict(zip(CSV_COLUMNS, csv_row(first), strict=True))
    assert (row["mean_dbi"], row["q50_dbi"], row["missing"]) == (12.5, 12.5, 1)
    assert row["channel_busy_fraction"] is None
    assert row["between_flights_db"] is None


def test_deviation_between_flights_is_that_of_their_means():
    """Means of 12 and 13 dBi deviate by 1 / sqrt(2), for any instants."""
    made = table(
        campaigns(SMALL)[ARTICLE], gains=lambda row: of_gains([11.0 + row % 2, 13.0 + row % 2]),
        status=lambda _: "completed",
    )  # fmt: skip
    cell = read_cells(made)[ARTICLE, 5.0, 0.0]
    assert cell.between_flights_db == pytest.approx(math.sqrt(0.5))
    row = dict(zip(CSV_COLUMNS, csv_row(cell), strict=True))
    assert row["between_flights_db"] == cell.between_flights_db
    assert cell.of([2]).max_gain_dbi.tolist() == [12.0, 14.0]


def test_cell_without_a_pattern_has_no_values():
    campaign = campaigns(SMALL)[ARTICLE]
    cells = read_cells(table(campaign, gains=lambda _: None, status=lambda _: "failed"))
    cell = cells[ARTICLE, 5.0, 0.0]
    assert (cell.statistics, cell.peak_per_db, cell.sigma_m) == (None, None, None)
    assert all(len(each.max_gain_dbi) == 0 for each in cells.values())


def test_equal_gains_have_an_infinite_peak():
    campaign = campaigns(SMALL)[CROWDED]
    made = table(campaign, gains=lambda _: of_gains([13.0, 13.0]), status=lambda _: "completed")
    cells = read_cells(made)
    assert list(cells) == [(CROWDED, 10.0, 5.0), (UNCROWDED, 10.0, 5.0)]
    assert all(cell.peak_per_db == math.inf for cell in cells.values())


def kept_table(tilt_rad):
    """Make a table of retained flights in their places with equal tilt, in formation from 1 s on."""
    campaign = campaigns(SMALL)[KEPT]
    runs = expand(campaign, state="")

    def flight(row):
        places, times_us = runs[row].scenario.places_ned_m(), np.arange(0, 2_000_001, 20_000)
        q = [math.cos(tilt_rad / 2.0), math.sin(tilt_rad / 2.0), 0.0, 0.0]
        agents, columns = len(places), {"time_us": np.repeat(times_us, len(places))}
        for name, labels, values in (
            ("pos_ned_m", "ned", places), ("q_ned_frd", "wxyz", np.tile(q, (agents, 1))),
            ("desired_pos_ned_m", "ned", places), ("onboard_pos_ned_m", "ned", places),
        ):  # fmt: skip
            for k, label in enumerate(labels):
                columns[f"{name}.{label}"] = np.tile(values[:, k], len(times_us))
        return pa.table(columns | {"alive": np.ones(agents * len(times_us), bool)})

    made = table(campaign, gains=lambda _: None, formed_s=lambda row: None if row == 0 else 1.0)
    made.series = lambda row, name: flight(row) if name == "flight" else None
    return made


def test_retained_flights_are_solved_in_all_variants():
    """In their places and upright they are ideal; the whole loss is due to tilt."""
    flights = list(kept_flights(kept_table(0.3)))
    assert len(flights) == 7  # of eight, one was not formed
    assert all(isinstance(each.flight, Flight) and each.flight.time_us[0] == 1_000_000 for each in flights)
    reported = []
    found = separate(flights[:2], done=reported.append)
    assert reported == [1, 2]
    for each in found:
        assert each.loss_db("upright") == pytest.approx(0.0, abs=1e-3)
        assert each.loss_db("in place") == pytest.approx(each.loss_db("flown"), abs=1e-3)
        assert each.loss_db("flown") > 0.01
        assert each.tilt_rms_deg == pytest.approx(math.degrees(0.3))
        assert each.turned_rms_deg == pytest.approx(0.0, abs=1e-6)


def without_patterns(kept):
    """Put two vehicles of a flight into the same place at all instants."""
    touching = kept.flight.pos_ned_m.copy()
    touching[:, 1] = touching[:, 0]
    return replace(kept, flight=replace(kept.flight, pos_ned_m=touching))


def test_flight_without_patterns_is_skipped():
    """For example if antennas always touch; the other flight is not affected."""
    flights = list(kept_flights(kept_table(0.1)))[:2]
    assert flights[0].scenario.antenna.wavelength_m == flights[1].scenario.antenna.wavelength_m
    reported = []
    assert separate([without_patterns(flights[0])], done=reported.append) == []
    assert reported == [1]
    (found,) = separate([without_patterns(flights[0]), flights[1]])
    assert found.mean_dbi == separate(flights[1:])[0].mean_dbi
    assert figure_patterns_of(without_patterns(flights[0])) is None


def test_figure_4_solves_each_array_once(monkeypatch):
    """K instants in each of three variants, then the ideal and the median instant: 3 K + 2 patterns."""
    kept = next(each for each in kept_flights(kept_table(0.1)) if each.scenario.antenna.wavelength_m == 10.0)
    instants = len(kept.flight.sampled(kept.scenario.antenna.snapshot_rate_hz).time_us)
    solved = []

    def counted(config, snapshots, **options):
        solved.append((config.grid_deg, len(snapshots)))
        return compute_patterns(config, snapshots, **options)

    for module in (kept_module, flown_array):
        monkeypatch.setattr(module, "compute_patterns", counted)
    found = figure_patterns_of(kept)
    assert sum(count for _, count in solved) == 3 * instants + 2
    assert {grid_deg for grid_deg, _ in solved} == {flown_array.FIGURE_GRID_DEG}
    assert set(found.means) == set(VARIANTS)
    # all instants are equal, so mean and median are one pattern, and the upright one is ideal
    assert found.median.gain_dbi == pytest.approx(found.means["flown"].gain_dbi, abs=1e-3)
    assert found.ideal.gain_dbi == pytest.approx(found.means["upright"].gain_dbi, abs=1e-3)


def test_median_instant_has_the_median_gain():
    """The tilt increases, which lowers the gain: the middle instant has the median."""
    kept = next(each for each in kept_flights(kept_table(0.0)) if each.scenario.antenna.wavelength_m == 10.0)
    flight = kept.flight
    half_rad = np.linspace(0.05, 0.25, len(flight.time_us))
    q = np.zeros_like(flight.q_ned_frd)
    q[..., 0], q[..., 1] = np.cos(half_rad)[:, None], np.sin(half_rad)[:, None]
    found = figure_patterns_of(replace(kept, flight=replace(flight, q_ned_frd=q)))
    assert found.time_s == pytest.approx((flight.time_us[0] + flight.time_us[-1]) / 2e6, abs=0.051)


# ---- the page


@pytest.fixture(scope="module")
def results():
    cells = {}
    for campaign in campaigns(SMALL).values():
        if campaign.name != KEPT:
            made = table(
                campaign, gains=lambda row: of_gains([12.0, 12.5, 13.0 + 0.01 * row]),
                **{"status": lambda _: "completed", "agents": lambda _: 8,
                   "formation_rms_m.shape_horizontal": lambda _: 0.1},
            )  # fmt: skip
            cells |= read_cells(made)
    ideals = ideal_gains((5.0, 10.0))
    pattern = ideals["batch"][10.0]
    figure = FigurePatterns(
        seed=1, time_s=30.0, ideal=pattern, median=pattern, means=dict.fromkeys(VARIANTS, pattern)
    )
    evidence = Evidence(
        cells=cells, ideals=ideals, separations=separate(list(kept_flights(kept_table(0.1)))[2:]),
        patterns=figure.readings(), drawn=draw(20, sigmas_m=(0.1, 0.5)),
    )  # fmt: skip
    return page.Results(plan=SMALL, evidence=evidence, judged=judge_all(evidence), figure=figure,
                        broken=["article, seed 9: fell"])  # fmt: skip


def test_page_contains_all_statements_cases_and_flights(results, tmp_path):
    found = results
    sections = page.sections(found)
    cli._write(found, sections, tmp_path, quick=False)
    text = (tmp_path / page.FILE_NAME).read_text(encoding="utf-8")
    for statement in STATEMENTS:
        assert statement.said in text
        assert statement.criterion in text
        assert statement.known in " ".join(text.split())
    for name in CHANGES:
        assert f"| {name} |" in text
    for wavelength_m in SMALL.wavelengths_m:
        for wind_n in SMALL.winds_n:
            assert f"| {wavelength_m:g} | {wind_n:g} | 2 of 2 |" in text
    assert "article, seed 9: fell" in text
    assert "python scripts/reproduce_article.py --seeds 2 --duration 6 --out docs/results" in text
    shown = [line.split("](")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")]
    assert len(shown) == 6
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in shown)
    rows = (tmp_path / page.CSV_NAME).read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + len(found.evidence.cells)


def test_page_without_retained_flights_states_it(results):
    found = results
    evidence = Evidence(cells=found.evidence.cells, ideals=found.evidence.ideals, separations=[], patterns={},
                        drawn=found.evidence.drawn)  # fmt: skip
    bare = page.Results(plan=SMALL, evidence=evidence, judged=judge_all(evidence), figure=None)
    text = markdown(page.sections(bare), title="", introduction=page.introduction(bare, quick=True))
    assert "No flight of this case was retained." in text
    assert "not measured" in text
    assert "--quick" in text


def test_page_is_written_if_all_flights_failed(results, tmp_path):
    cells = read_cells(table(campaigns(SMALL)[ARTICLE], gains=lambda _: None, status=lambda _: "failed"))
    evidence = Evidence(cells=cells, ideals=results.evidence.ideals, separations=[], patterns={},
                        drawn=results.evidence.drawn)  # fmt: skip
    bare = page.Results(plan=SMALL, evidence=evidence, judged=judge_all(evidence), figure=None)
    cli._write(bare, page.sections(bare), tmp_path, quick=False)
    text = (tmp_path / page.FILE_NAME).read_text(encoding="utf-8")
    assert "| 5 | 0 | 0 of 2 | 0 | 0 | 0 | – |" in text
    assert (tmp_path / "images" / "article-figure3.png").exists()


def test_evidence_is_read_from_the_tables(monkeypatch):
    """The first flight of figure 4 has no pattern, so the second is used; a failed flight is named."""
    monkeypatch.setattr(cli, "draw", lambda *_, **__: {})
    tables = {
        name: table(
            campaign, gains=lambda row: of_gains([12.0, 13.0 + 0.01 * row]),
            **{"status": lambda row: "failed" if row == 0 else "completed", "reason": lambda _: "fell",
               "formation_rms_m.shape_horizontal": lambda _: 0.1},
        )
        for name, campaign in campaigns(SMALL).items()
    }  # fmt: skip
    flights = [
        without_patterns(each) if each.scenario.run.seed == 1 else each
        for each in kept_flights(kept_table(0.1))
    ]
    monkeypatch.setattr(cli, "kept_flights", lambda _: iter(flights))
    found = cli._measure(SMALL, tables, Console(stderr=True))
    evidence = found.evidence
    assert (found.figure.seed, evidence.solver) == (2, "batch")
    assert set(evidence.frequencies_mhz) == set(SMALL.wavelengths_m)
    assert set(evidence.leaning) == set(WIND_PHIS_DEG)
    assert all(each.seeds == [2] for each in evidence.separations)
    assert {case for case, _, _ in evidence.cells} == {ARTICLE, CROWDED, UNCROWDED, *CHANGES}
    assert "article, antenna.wavelength_m = 5.0, wind.mean_n = 0.0, seed 1: fell" in found.broken
    assert {each.name for each in found.judged} == {each.name for each in STATEMENTS}


# ---- the command line


@pytest.fixture
def command(monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    return lambda *arguments: CliRunner().invoke(cli.article_app, list(arguments))


def test_json_is_one_object_with_all_verdicts(command, monkeypatch, results, tmp_path):
    found = results
    monkeypatch.setattr(cli, "_fly", lambda *_, **__: {})
    monkeypatch.setattr(cli, "_measure", lambda *_: found)
    monkeypatch.setattr(page, "figures", Mock())  # drawn in other tests
    ended = command("--quick", "--json", "--out", str(tmp_path))
    said = json.loads(ended.stdout)
    assert [set(said)] == [set(each.keys) for each in RESULTS if each.command == "study article"]
    assert [each["name"] for each in said["statements"]] == [each.name for each in STATEMENTS]
    assert said["agree"] + said["differ"] + said["not_told_apart"] + said["not_measured"] == len(STATEMENTS)
    assert Path(said["page"]).exists()
    assert (said["failed"], ended.exit_code) == (1, exit_status.FAILED)


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (CampaignError("no room"), exit_status.BAD_INPUT, "no room"),
        (OSError(28, "No space left"), exit_status.FAILED, "No space left on device"),
        (Nec2cFailed("nec2c: no\ngains"), exit_status.FAILED, "Nec2cFailed: nec2c: no"),
        (WorkerError("a worker died"), exit_status.FAILED, "WorkerError: a worker died"),
        (pa.ArrowInvalid("not Parquet"), exit_status.FAILED, "ArrowInvalid: not Parquet"),
        (ValueError(), exit_status.FAILED, "ValueError"),
    ],
)
@pytest.mark.parametrize("step", ["_fly", "_measure"])
def test_error_is_one_line(command, monkeypatch, error, status, line, step):
    def fly(*_, **__):
        raise error

    monkeypatch.setattr(cli, "_fly", lambda *_, **__: {})
    monkeypatch.setattr(cli, step, fly)
    ended = command("--quick")
    assert ended.exit_code == status
    assert ended.stderr == f"reproduce_article: {line}\n"
    assert ended.stdout == ""


def test_interruption_states_that_the_same_command_continues(command, monkeypatch):
    def fly(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_fly", fly)
    ended = command()
    assert ended.exit_code == exit_status.INTERRUPTED
    assert "the same command continues" in ended.stderr


@pytest.mark.parametrize("arguments", [("--seeds", "0"), ("--duration", "1"), ("--workers", "0")])
def test_bad_numbers_are_rejected_before_the_first_flight(command, arguments):
    ended = command(*arguments)
    assert ended.exit_code == exit_status.BAD_INPUT
    assert arguments[0] in ended.stderr
