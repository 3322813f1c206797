"""Plan, readings, page and command line of the reproduction, without flights (10 s)."""

import csv
import io
import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from harness.article import cli, page
from harness.article.draws import draw, ideal_gains
from harness.article.evidence import Evidence
from harness.article.kept import VARIANTS, FigurePatterns, kept_flights, separate
from harness.article.plan import (
    ARTICLE,
    CHANGES,
    CROWDED,
    EXPLAINING,
    KEPT,
    QUICK,
    Plan,
    campaigns,
)
from harness.article.readings import CSV_COLUMNS, csv_text, read_cells
from harness.article.statements import STATEMENTS, judge_all
from harness.campaign import CampaignError
from harness.campaign.definition import expand
from harness.flight import Flight
from harness.validation.report import markdown

SMALL = Plan(seeds=2, duration_s=6.0, wavelengths_m=(5.0, 10.0), winds_n=(0.0, 5.0), draws=20)


# ---- what is flown


@pytest.mark.parametrize("plan", [Plan(), QUICK], ids=["whole", "quick"])
def test_every_flight_of_the_plans_can_be_flown(plan):
    """All scenarios load; the article's campaign has every wavelength in every wind with every seed."""
    made = {name: expand(campaign, state="") for name, campaign in campaigns(plan).items()}
    combinations = {(*run.swept, run.seed) for run in made[ARTICLE]}
    assert len(combinations) == len(plan.wavelengths_m) * len(plan.winds_n) * plan.seeds
    assert {run.scenario.antenna.wavelength_m for run in made[ARTICLE]} == set(plan.wavelengths_m)
    assert {run.scenario.wind.mean_n for run in made[ARTICLE]} == set(plan.winds_n)
    assert {run.digest for run in made[KEPT]} <= {run.digest for run in made[ARTICLE]}  # flown once
    assert {run.case for run in made[EXPLAINING]} == set(CHANGES)
    crowded = made.get(CROWDED, [])
    assert len(crowded) == plan.crowded_seeds
    others = {run.digest for run in made[EXPLAINING] + crowded}
    assert len(others) == len(made[EXPLAINING]) + len(crowded)  # each change changes something
    assert not others & {run.digest for run in made[ARTICLE]}
    assert list(made)[-1] == ARTICLE  # its table stays in the folder
    assert all(campaign.keep for campaign in campaigns(plan).values())


# ---- numbers out of tables


def table(campaign, *, gains, **columns):
    """Make a table as the campaign's, whose series are ``gains`` (by row) and whose numbers are these."""
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


def test_a_cell_has_all_instants_of_its_seeds():
    """Seed 1: 12 and 13 dBi and a missing instant; seed 2 failed. Rms of the one shape error is itself."""
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
    assert first.sigma_m == pytest.approx(0.13 / math.sqrt(2.0 - 3.0 / 8.0))  # 16 degrees of freedom less 3
    row = next(csv.DictReader(io.StringIO(csv_text([first]))))
    assert tuple(row) == CSV_COLUMNS
    assert (row["mean_dbi"], row["q50_dbi"], row["missing"]) == ("12.5", "12.5", "1")
    assert row["channel_busy_fraction"] == ""


def test_without_a_pattern_a_cell_has_no_numbers():
    campaign = campaigns(SMALL)[ARTICLE]
    cells = read_cells(table(campaign, gains=lambda _: None, status=lambda _: "failed"))
    cell = cells[ARTICLE, 5.0, 0.0]
    assert (cell.statistics, cell.peak_per_db, cell.sigma_m) == (None, None, None)
    assert all(len(each.max_gain_dbi) == 0 for each in cells.values())


def test_gains_that_do_not_differ_have_an_infinite_peak():
    campaign = campaigns(SMALL)[CROWDED]
    made = table(campaign, gains=lambda _: of_gains([13.0, 13.0]), status=lambda _: "completed")
    (key,), (cell,) = zip(*read_cells(made).items(), strict=True)
    assert key == (CROWDED, 10.0, 5.0)
    assert cell.peak_per_db == math.inf


def kept_table(tilt_rad):
    """Make a table of kept flights that stand in their places, tilted alike, from 1 s on in formation."""
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


def test_kept_flights_are_solved_as_they_flew_upright_and_in_their_places():
    """In their places and upright they are ideal; all that tilt costs is tilt's."""
    flights = list(kept_flights(kept_table(0.3)))
    assert len(flights) == 7  # of eight, one was not formed
    assert all(isinstance(each.flight, Flight) and each.flight.time_us[0] == 1_000_000 for each in flights)
    told = []
    found = separate(flights[:2], done=told.append)
    assert told == [1, 2]
    for each in found:
        assert each.loss_db("upright") == pytest.approx(0.0, abs=1e-3)
        assert each.loss_db("in place") == pytest.approx(each.loss_db("flown"), abs=1e-3)
        assert each.loss_db("flown") > 0.01
        assert each.tilt_rms_deg == pytest.approx(math.degrees(0.3))
        assert each.turned_rms_deg == pytest.approx(0.0, abs=1e-6)


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


def test_the_page_names_every_statement_case_and_flight(results, tmp_path):
    found = results
    sections = page.sections(found)
    cli._write(found, sections, tmp_path, quick=False)
    text = (tmp_path / page.FILE_NAME).read_text(encoding="utf-8")
    for statement in STATEMENTS:
        assert statement.said in text
        assert statement.criterion in text
    for name in CHANGES:
        assert f"| {name} |" in text
    for wavelength_m in SMALL.wavelengths_m:
        for wind_n in SMALL.winds_n:
            assert f"| {wavelength_m:g} | {wind_n:g} | 2 of 2 |" in text
    assert "article, seed 9: fell" in text
    assert "python scripts/reproduce_article.py --seeds 2 --duration 6 --out docs" in text
    shown = [line.split("](")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")]
    assert len(shown) == 6
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in shown)
    rows = (tmp_path / page.CSV_NAME).read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + len(found.evidence.cells)


def test_the_page_says_so_when_nothing_was_kept(results):
    found = results
    evidence = Evidence(cells=found.evidence.cells, ideals=found.evidence.ideals, separations=[], patterns={},
                        drawn=found.evidence.drawn)  # fmt: skip
    bare = page.Results(plan=SMALL, evidence=evidence, judged=judge_all(evidence), figure=None)
    text = markdown(page.sections(bare), title="", introduction=page.introduction(bare, quick=True))
    assert "No flight of it was kept." in text
    assert "not measured" in text
    assert "--quick" in text


def test_a_page_comes_out_when_every_flight_has_failed(results, tmp_path):
    cells = read_cells(table(campaigns(SMALL)[ARTICLE], gains=lambda _: None, status=lambda _: "failed"))
    evidence = Evidence(cells=cells, ideals=results.evidence.ideals, separations=[], patterns={},
                        drawn=results.evidence.drawn)  # fmt: skip
    bare = page.Results(plan=SMALL, evidence=evidence, judged=judge_all(evidence), figure=None)
    cli._write(bare, page.sections(bare), tmp_path, quick=False)
    text = (tmp_path / page.FILE_NAME).read_text(encoding="utf-8")
    assert "| 5 | 0 | 0 of 2 | 0 | 0 | 0 | – |" in text
    assert (tmp_path / "images" / page.FIGURE3).exists()


# ---- the command line


@pytest.fixture
def command(monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    return lambda *arguments: CliRunner().invoke(cli.article_app, list(arguments))


def test_json_is_one_object_with_every_verdict(command, monkeypatch, results, tmp_path):
    found = results
    monkeypatch.setattr(cli, "_fly", lambda *_, **__: {})
    monkeypatch.setattr(cli, "_measure", lambda *_: found)
    ended = command("--quick", "--json", "--out", str(tmp_path))
    said = json.loads(ended.stdout)
    assert [each["name"] for each in said["statements"]] == [each.name for each in STATEMENTS]
    assert said["agree"] + said["differ"] + said["not_measured"] == len(STATEMENTS)
    assert Path(said["page"]).exists()
    assert (said["failed"], ended.exit_code) == (1, cli.SOME_FAILED)


@pytest.mark.parametrize(
    ("error", "status"), [(CampaignError("no room"), cli.BAD_INPUT), (OSError("disk full"), cli.SOME_FAILED)]
)
def test_what_stops_it_is_one_line(command, monkeypatch, error, status):
    def fly(*_, **__):
        raise error

    monkeypatch.setattr(cli, "_fly", fly)
    ended = command("--quick")
    assert ended.exit_code == status
    assert ended.stderr == f"reproduce_article: {error}\n"
    assert ended.stdout == ""


def test_ctrl_c_says_that_the_same_command_goes_on(command, monkeypatch):
    def fly(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_fly", fly)
    ended = command()
    assert ended.exit_code == cli.INTERRUPTED
    assert "the same command goes on" in ended.stderr


@pytest.mark.parametrize("arguments", [("--seeds", "0"), ("--duration", "1"), ("--workers", "0")])
def test_bad_numbers_are_refused_before_anything_flies(command, arguments):
    ended = command(*arguments)
    assert ended.exit_code == cli.BAD_INPUT
    assert arguments[0] in ended.stderr
