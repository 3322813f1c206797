"""Command line of the co-design experiment: fly the missing flights, judge the results, write the page.

Exit status as in `studies.common.command_line`, and 130 after an interruption: the same command continues.
"""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace
from rich.console import Console

from harness.campaign.store import CampaignError
from harness.launch import kernel_cache
from harness.launch.interrupts import interruptible
from studies.codesign.book import Book
from studies.codesign.cases import QUICK, CodesignCase, CodesignPlan, groups
from studies.codesign.factor_sections import judge_baselines, judge_beacon_period, judge_ranging
from studies.codesign.introduction import command, introduction
from studies.codesign.results import (
    FLYING,
    CodesignFlown,
    CodesignStore,
    CodesignTask,
    fly_tasks,
    known,
    make_tasks,
    sources_state,
)
from studies.codesign.sections import Judge, judge_wavelength, judge_wind_agents
from studies.codesign.tables import write_csv
from studies.codesign.trouble_section import judge_trouble
from studies.common.command_line import BAD_INPUT, Page, chosen, progress_lines, report_and_exit
from studies.common.report import Section, figures_folder
from studies.common.standard_output import keep_stdout

INTERRUPTED = 130
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
    json: Annotated[bool, typer.Option("--json", help="Print only the numbers, as JSON.")] = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for codesign-results.md, CSV tables and images/; by default no file is written."
        ),
    ] = None,
) -> None:
    """Measure the effect of ranging over the radio on the formation error."""
    messages = Console(stderr=True, highlight=False)
    names = chosen("experiment_codesign", only, GROUPS, messages)
    plan = QUICK if quick else CodesignPlan()
    plan = replace(plan, seeds=seeds or plan.seeds, duration_s=duration or plan.duration_s)
    stdout = keep_stdout()
    by_group = {name: cases for name, cases in groups(plan).items() if name in names}
    store = CodesignStore(data)
    tasks = make_tasks([case for cases in by_group.values() for case in cases], plan, folder=data)
    flights = known(tasks, store, stale=stale)
    if retry:
        flights = {key: flown for key, flown in flights.items() if flown.broken is None}
    missing = [task for task in tasks if (task.case, task.seed) not in flights]
    messages.print(f"{len(tasks)} flights, {len(missing)} of them missing; stored in {store.path}")
    made_by = command(plan, () if set(names) == set(GROUPS) else names, quick=quick, stale=stale)
    estimated, changed = None, False
    if missing or ESTIMATOR in names:
        state = sources_state()
        try:
            with store.alone(), interruptible():
                kernel_cache.prepare(messages.print)
                if ESTIMATOR in names:
                    estimated = _study(plan, data, workers=workers, messages=messages)
                _fly(missing, by_group, store, flights, workers=workers, messages=messages)
        except KeyboardInterrupt:
            messages.print("interrupted: the same command continues from here")
            raise typer.Exit(INTERRUPTED) from None
        except (CampaignError, kernel_cache.CompileError) as error:
            messages.print(f"experiment_codesign: {error}")
            raise typer.Exit(BAD_INPUT) from None
        sources_state.cache_clear()
        changed = sources_state() != state
        if changed:
            messages.print("the sources changed during the run: its flights cannot be assigned to one state")
    book = Book(plan=plan, flights=flights)
    images = None if out is None else figures_folder(out)
    if images is not None:
        images.mkdir(parents=True, exist_ok=True)
    sections = [JUDGES[name](book, images) for name in JUDGES if name in names]
    if estimated is not None:
        sections.insert(0, estimated)
    if out is not None:
        write_csv(out, [case for cases in by_group.values() for case in cases], book)
    page = Page(
        file_name="codesign-results.md",
        title="Co-design: results",
        introduction=introduction(book, tasks, made_by=made_by, changed=changed),
    )
    report_and_exit(sections, page=page, out=out, json=json, stdout=stdout, px4=False)


def _fly(
    missing: Sequence[CodesignTask],
    by_group: dict[str, tuple[CodesignCase, ...]],
    store: CodesignStore,
    flights: dict[tuple[str, int], CodesignFlown],
    *,
    workers: int,
    messages: Console,
) -> None:
    """Fly the missing tasks and add them to ``flights``; a case in several groups counts in the first."""
    from studies.codesign.flights import fly_task  # noqa: PLC0415  numba reads its cache folder at import

    shutil.rmtree(store.folder / FLYING, ignore_errors=True)  # of campaigns that were killed
    group_of: dict[str, str] = {}
    for group, cases in by_group.items():
        for case in cases:
            group_of.setdefault(case.name, group)
    total = dict.fromkeys(group_of.values(), 0)
    done = dict(total)
    for task in missing:
        total[group_of[task.case]] += 1
    with progress_lines(messages) as (note, message):
        for group in total:
            if total[group]:
                note(group, 0, total[group])

        def landed(flown: CodesignFlown) -> None:
            flights[flown.case, flown.seed] = flown
            group = group_of[flown.case]
            done[group] += 1
            note(group, done[group], total[group])
            if flown.broken is not None:
                message(f"{flown.case}, seed {flown.seed}: {flown.broken}")

        fly_tasks(missing, store, fly_task, workers=workers, done=landed)


def _study(plan: CodesignPlan, data: Path, *, workers: int, messages: Console) -> Section:
    """Run the studies of `estimator_section`."""
    from studies.codesign.estimator_section import judge_estimator, studies  # noqa: PLC0415  as in `_fly`

    with progress_lines(messages) as (note, _):
        results = studies(plan, data, workers=workers, done=lambda done, total: note(ESTIMATOR, done, total))
    return judge_estimator(results)
