"""Command line of the reproduction: fly the missing flights, evaluate the statements, write the page.

Exit status: 0 all flights completed, 1 some flights or the cluster failed, 2 bad input, 130 interrupted; the
same command then continues. A negative verdict is a result, not a failure. An error is one line.
"""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, TextIO

import msgspec
import typer
from msgspec.structs import replace
from rich.console import Console

from foundation import exit_status
from foundation.system_error import described
from harness.campaign import Campaign, CampaignError, ClusterError, Table, run
from harness.campaign.definition import expand
from harness.campaign.display import CampaignDisplay
from harness.campaign.running import known
from harness.campaign.store import FAILED, PLAIN_FLIGHT, Store
from harness.campaign.worker import sources_state
from harness.launch import kernel_cache
from harness.launch.interrupts import interruptible
from studies.article import page
from studies.article.campaign_data import CSV_COLUMNS, csv_row, read_cells
from studies.article.evidence import Evidence
from studies.article.monte_carlo import WAVELENGTHS_M as DRAWN_M
from studies.article.monte_carlo import WIND_PHIS_DEG, array_of, draw, frequency_mhz, ideal_gains, tilted
from studies.article.patterns import read_pattern
from studies.article.plan import FIGURE_WAVELENGTH_M, FIGURE_WIND_N, KEPT, QUICK, ArticlePlan, campaigns
from studies.article.retained_flights import figure_flights, figure_patterns_of, kept_flights, separate
from studies.article.statements import StatementVerdict, count, judge_all
from studies.common.command_line import (
    keep_stdout,
    progress_lines,
    result_console,
)
from studies.common.report import Section, show, write_csv, write_page

PROGRAM = "reproduce_article"
RUNS, QUICK_RUNS = Path("runs") / "article", Path("runs") / "article-quick"

article_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@article_app.command()
def article(
    quick: Annotated[  # noqa: FBT002
        bool, typer.Option("--quick", help="Few and short flights at 5, 10 and 20 m; takes minutes.")
    ] = False,
    seeds: Annotated[
        int | None, typer.Option(help="Flights of each wavelength in each wind.", min=1, max=1000)
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Simulated seconds in formation.", min=6.0, max=600.0)
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Worker processes; default one for each processor.", min=1, max=1024)
    ] = None,
    runs: Annotated[
        Path | None,
        typer.Option(help=f"Folder of finished flights; default {RUNS}, or {QUICK_RUNS} with --quick."),
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Repeat failed flights.")] = False,  # noqa: FBT002
    json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(help=f"Folder for {page.FILE_NAME}, {page.CSV_NAME} and images/; by default no page."),
    ] = None,
) -> None:
    """Fly the article's formation and compare each of its statements with the results."""
    messages = Console(stderr=True, highlight=False, markup=False)
    plan = QUICK if quick else ArticlePlan()
    plan = replace(plan, seeds=seeds or plan.seeds, duration_s=duration or plan.duration_s)
    stdout = keep_stdout()
    try:
        with interruptible():
            tables = _fly(
                campaigns(plan), runs or (QUICK_RUNS if quick else RUNS),
                workers=workers or os.cpu_count() or 1, retry=retry, messages=messages,
            )  # fmt: skip
            results = _measure(plan, tables, messages)
            sections = page.sections(results)
            if out is not None:
                _write(results, sections, out, quick=quick)
            _print(results, sections, out, json=json, stdout=stdout)
    except KeyboardInterrupt:
        messages.print("interrupted: the same command continues from here")
        raise typer.Exit(exit_status.INTERRUPTED) from None
    except Exception as error:  # noqa: BLE001  every error has a status and a line
        status, line = _ending(error)
        messages.print(f"{PROGRAM}: {line}", soft_wrap=True, markup=False)
        raise typer.Exit(status) from None
    raise typer.Exit(exit_status.FAILED if results.broken else exit_status.FINE)


def _ending(error: Exception) -> tuple[int, str]:
    match error:
        case ClusterError() | kernel_cache.CompileError():
            return exit_status.FAILED, str(error)
        case CampaignError():
            return exit_status.BAD_INPUT, str(error)
        case _:
            return exit_status.FAILED, described(error)


def _fly(
    plans: Mapping[str, Campaign], folder: Path, *, workers: int, retry: bool, messages: Console
) -> dict[str, Table]:
    """Fly all campaigns into one folder, so that common flights are flown once."""
    tables = {}
    for name, campaign in plans.items():
        runs = expand(campaign, state=sources_state(PLAIN_FLIGHT.measured_by))
        missing = known(campaign, runs, Store(folder), retry=retry)[1]
        total = len({each.digest for each in runs})
        messages.print(
            f"{name}: {total} flights, {len(missing)} of them missing; stored in {folder}",
            soft_wrap=True,
            markup=False,
        )
        with CampaignDisplay(messages, campaign, total=total, kept=total - len(missing)) as display:
            tables[name] = run(
                campaign, out=folder, workers=workers, retry=retry, progress=display.on_landed,
                note=display.note,
            )  # fmt: skip
    return tables


def _measure(plan: ArticlePlan, tables: Mapping[str, Table], messages: Console) -> page.Results:
    """Collect the evidence from the tables and judge all statements."""
    cells = {
        key: cell for name, table in tables.items() if name != KEPT for key, cell in read_cells(table).items()
    }
    with progress_lines(messages) as note:
        drawn = draw(plan.draws, done=lambda done, total: note("random formations", done, total))
        kept = list(kept_flights(tables[KEPT]))
        separations = separate(kept, done=lambda done: note("kept flights", done, len(kept)))
        solved = list(map(figure_patterns_of, figure_flights(kept)))
        drawn_from = [each for each in solved if each is not None]
        figure = drawn_from[0] if drawn_from else None
    leaning = {}
    of_figure = (FIGURE_WAVELENGTH_M, FIGURE_WIND_N)
    windy = next((each for each in separations if (each.wavelength_m, each.wind_n) == of_figure), None)
    if figure is not None and windy is not None:
        step_deg = float(figure.ideal.theta_deg[1])
        leaning = {
            phi_deg: read_pattern(
                tilted(windy.wavelength_m, math.radians(windy.tilt_rms_deg), phi_deg, step_deg), figure.ideal
            )
            for phi_deg in WIND_PHIS_DEG
        }
    evidence = Evidence(
        cells=cells, ideals=ideal_gains(sorted({*plan.wavelengths_m, *DRAWN_M})), separations=separations,
        patterns={} if figure is None else figure.readings(), drawn=drawn, leaning=leaning,
        pattern_flights={each.seed: each.readings() for each in drawn_from},
        solver=array_of(FIGURE_WAVELENGTH_M)[1].backend,
        frequencies_mhz={each: frequency_mhz(each) for each in plan.wavelengths_m},
    )  # fmt: skip
    plans = campaigns(plan)
    broken = {
        each.describe(plans[name]): table.column("reason")[row]
        for name, table in tables.items()
        for row, each in enumerate(table.runs)
        if table.column("status")[row] == FAILED
    }
    return page.Results(
        plan=plan, evidence=evidence, judged=judge_all(evidence), figure=figure,
        broken=[f"{which}: {reason}" for which, reason in broken.items()],
    )  # fmt: skip


def _write(results: page.Results, sections: Sequence[Section], out: Path, *, quick: bool) -> None:
    """Write page, figures and CSV; raises OSError."""
    write_csv(out / page.CSV_NAME, CSV_COLUMNS, map(csv_row, results.evidence.cells.values()))
    introduction = page.introduction(results, quick=quick)
    write_page(out, page.FILE_NAME, sections, title=page.TITLE, introduction=introduction)


def _print(
    results: page.Results, sections: Sequence[Section], out: Path | None, *, json: bool, stdout: TextIO
) -> None:
    if not json:
        show(result_console(stdout), sections, px4=False)
        return
    found = count(results.judged)
    result = {
        "agree": found[StatementVerdict.AGREES],
        "differ": found[StatementVerdict.DIFFERS],
        "not_told_apart": found[StatementVerdict.OPEN],
        "not_measured": found[StatementVerdict.UNKNOWN],
        "failed": len(results.broken),
        "page": None if out is None else str(out / page.FILE_NAME),
        "statements": results.judged,
    }
    print(msgspec.json.encode(result).decode(), file=stdout)
