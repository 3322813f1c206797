"""Command line of the soak study: see `studies.common.command_line`."""

from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from studies.common.command_line import JsonOption, Page, RecordsOption, Validation
from studies.common.runner import Subject
from studies.soak import flight_section, repeats_section, size_section, swarms_section
from studies.soak.plan import QUICK_SOAK, SoakPlan

SUBJECTS: dict[str, Subject[SoakPlan]] = {
    "flights": Subject(flight_section.jobs, flight_section.judge),
    "swarms": Subject(swarms_section.jobs, swarms_section.judge),
    "repeats": Subject(repeats_section.jobs, repeats_section.judge),
    "sizes": Subject(size_section.jobs, size_section.judge),
}
INTRODUCTION = """Long flights, many swarms, repeated flights and large swarms: what grows, what differs and
what it costs. All numbers are produced by

    coflight study soak

which takes some hours on two cores; with `--out docs/results` it writes this page. `--hours`, `--swarms` and
`--repeats` shorten it, `--only` selects sections, and with `--records FILE` it can be broken off and
continued.
"""
VALIDATION = Validation(
    program="coflight study soak",
    page=Page(file_name="soak.md", title="Long flights and many swarms", introduction=INTRODUCTION),
    subjects=SUBJECTS,
    stages=tuple((name,) for name in SUBJECTS),  # beside each other they would measure each other
    has_bullet=True,
)

soak_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@soak_app.command()
def soak(
    quick: Annotated[bool, typer.Option("--quick", help="A minute of each; judges no memory.")] = False,  # noqa: FBT002
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(SUBJECTS)}.", metavar="NAME,NAME")
    ] = ",".join(SUBJECTS),
    hours: Annotated[
        float | None, typer.Option(help="Simulated hours of the long flights together.", min=0.01)
    ] = None,
    swarms: Annotated[int | None, typer.Option(help="Swarms in one process.", min=4)] = None,
    repeats: Annotated[int | None, typer.Option(help="Flights of one seed.", min=2)] = None,
    records: RecordsOption = None,
    json: JsonOption = False,  # noqa: FBT002
    out: Annotated[
        Path | None, typer.Option(help="Folder for soak.md; without it no file is written.")
    ] = None,
) -> None:
    """Measure growth in long flights and many swarms, equal hashes under load, and large swarms."""
    plan = QUICK_SOAK if quick else SoakPlan()
    hours = plan.hours if hours is None else hours
    plan = replace(
        plan,
        hours=hours,
        piece_s=min(plan.piece_s, hours * 3_600.0),
        swarms=swarms or plan.swarms,
        repeats=repeats or plan.repeats,
    )
    VALIDATION.run(plan, only, out=out, json=json, records=records)
