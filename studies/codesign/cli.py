"""Command line of the co-design experiment: fly the missing flights, judge the results, write the page.

Exit status as in `studies.common.command_line`, and 130 after an interruption: the same command continues.
"""

import os
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace
from rich.console import Console

from foundation.exit_status import BAD_INPUT, INTERRUPTED
from harness.campaign.display import CampaignDisplay
from harness.campaign.running import run
from harness.campaign.store import CampaignError, Store
from harness.campaign.worker import present_state
from harness.launch import kernel_cache
from harness.launch.interrupts import interruptible
from studies.codesign.book import Book
from studies.codesign.cases import QUICK, CodesignPlan, groups
from studies.codesign.factor_sections import judge_baselines, judge_beacon_period, judge_ranging
from studies.codesign.introduction import command, introduction
from studies.codesign.results import FLYING, campaign, known, make_runs, state
from studies.codesign.sections import Judge, judge_wavelength, judge_wind_agents
from studies.codesign.tables import write_tables
from studies.codesign.trouble_section import judge_trouble
from studies.common.command_line import (
    JsonOption,
    Page,
    chosen,
    keep_stdout,
    progress_lines,
    report_and_exit,
)
from studies.common.report import Section

DATA = Path("runs") / "codesign"
STALE_HELP = "Accept stored flights of other source states."
JUDGES: dict[str, Judge] = {
    "wind_agents": judge_wind_agents,
    "wavelength": judge_wavelength,
    "beacon_period": judge_beacon_period,
    "ranging": judge_ranging,
    "baselines": judge_baselines,
    "trouble": judge_trouble,
}
ESTIMATOR = "estimator"
"""Group without flights"""
GROUPS = (ESTIMATOR, *JUDGES)

codesign_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@codesign_app.command()
def codesign(
    quick: Annotated[bool, typer.Option("--quick", help="Two short flights of each case.")] = False,  # noqa: FBT002
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(GROUPS)}.", metavar="GROUP,GROUP")
    ] = ",".join(GROUPS),
    seeds: Annotated[int | None, typer.Option(help="Flights of each case.", min=1)] = None,
    duration: Annotated[
        float | None, typer.Option(help="Simulated seconds in formation.", min=6.0, max=600.0)
    ] = None,
    data: Annotated[Path, typer.Option(help="Folder of finished flights.")] = DATA,
    workers: Annotated[int, typer.Option(help="Concurrent flights.", min=1)] = min(2, os.cpu_count() or 1),
    stale: Annotated[bool, typer.Option("--stale", help=STALE_HELP)] = False,  # noqa: FBT002
    retry: Annotated[bool, typer.Option("--retry", help="Repeat broken flights.")] = False,  # noqa: FBT002
    json: JsonOption = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for codesign-results.md, CSV tables and images/; by default no file is written."
        ),
    ] = None,
) -> None:
    """Measure the effect of ranging over the radio on the formation error."""
    messages = Console(stderr=True, highlight=False, markup=False)
    names = chosen("experiment_codesign", only, GROUPS, messages)
    plan = QUICK if quick else CodesignPlan()
    plan = replace(plan, seeds=seeds or plan.seeds, duration_s=duration or plan.duration_s)
    stdout = keep_stdout()
    by_group = {name: cases for name, cases in groups(plan).items() if name in names}
    cases = [case for cases in by_group.values() for case in cases]
    store, began_with = Store(data), state()
    runs = make_runs(cases, plan, of_state=began_with)
    flights = known(runs, store, stale=stale, retry=retry)
    missing = [each for each in runs if (each.case, each.seed) not in flights]
    messages.print(f"{len(runs)} flights, {len(missing)} of them missing; stored in {data}")
    made_by = command(plan, () if set(names) == set(GROUPS) else names, quick=quick, stale=stale)
    estimated, changed = None, False
    if missing or ESTIMATOR in names:
        try:
            with interruptible():
                kernel_cache.prepare(messages.print)
                if ESTIMATOR in names:
                    with store.alone():
                        estimated = _study(plan, data, workers=workers, messages=messages)
                with CampaignDisplay(messages, campaign(plan), total=len(missing), kept=0) as display:
                    run(
                        campaign(plan), out=data, runs=missing, workers=workers, retry=retry,
                        progress=display.on_landed, note=display.note, flying=FLYING,
                    )  # fmt: skip
        except KeyboardInterrupt:
            messages.print("interrupted: the same command continues from here")
            raise typer.Exit(INTERRUPTED) from None
        except (CampaignError, kernel_cache.CompileError) as error:
            messages.print(f"experiment_codesign: {error}")
            raise typer.Exit(BAD_INPUT) from None
        flights |= known(missing, store)
        changed = present_state(FLYING.measured_by) != began_with
        if changed:
            messages.print("the sources changed during the run: its flights cannot be assigned to one state")
    book = Book(plan=plan, flights=flights)
    sections = [judge(book) for name, judge in JUDGES.items() if name in names]
    if estimated is not None:
        sections.insert(0, estimated)
    if out is not None:
        write_tables(out, cases, book)
    page = Page(
        file_name="codesign-results.md",
        title="Co-design: results",
        introduction=introduction(book, runs, made_by=made_by, changed=changed),
    )
    report_and_exit(sections, page=page, out=out, json=json, stdout=stdout)


def _study(plan: CodesignPlan, data: Path, *, workers: int, messages: Console) -> Section:
    """Run the studies of `estimator_section`."""
    from studies.codesign.estimator_section import judge_estimator, studies  # noqa: PLC0415  numba reads its cache folder at import

    with progress_lines(messages) as note:
        results = studies(plan, data, workers=workers, done=lambda done, total: note(ESTIMATOR, done, total))
    return judge_estimator(results)
