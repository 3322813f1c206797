"""Command line of the radio's validation: see `studies.common.command_line`."""

from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from studies.common.command_line import JsonOption, Page, Validation
from studies.common.runner import Subject
from studies.radio import broadcast_section, error_section, mesh_section, ranging_section, saturation_section
from studies.radio.plan import QUICK_RADIO, RadioPlan

SUBJECTS: dict[str, Subject[RadioPlan]] = {
    "saturation": Subject(saturation_section.jobs, saturation_section.judge),
    "broadcast": Subject(broadcast_section.jobs, broadcast_section.judge),
    "per": Subject(error_section.jobs, error_section.judge),
    "ftm": Subject(ranging_section.jobs, ranging_section.judge),
    "ftm-mesh": Subject(mesh_section.jobs, mesh_section.judge),
}
INTRODUCTION = """The 802.11 emulator without a flight, compared with ns-3 3.37, Bianchi's model and the
figures of the standard. All numbers are produced by

    python scripts/validate_radio.py

which repeats all simulations in some minutes on two cores; with `--out docs/results` it writes this page
and its figures. The reference results of ns-3 and Bianchi's model are in `studies/reference`. All runs are
determined by their seeds: the same sources give the same numbers.
"""
VALIDATION = Validation(
    program="validate_radio",
    page=Page(file_name="radio-validation.md", title="Validation of the radio", introduction=INTRODUCTION),
    subjects=SUBJECTS,
    stages=(("broadcast", "saturation", "ftm-mesh", "ftm", "per"),),  # the longest jobs first
)

validate_radio_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@validate_radio_app.command()
def validate_radio(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and shorter runs.")] = False,  # noqa: FBT002
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(SUBJECTS)}.", metavar="NAME,NAME")
    ] = ",".join(SUBJECTS),
    seeds: Annotated[int | None, typer.Option(help="Runs of each condition.", min=1)] = None,
    json: JsonOption = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for radio-validation.md and images/; without it no file is written."),
    ] = None,
) -> None:
    """Compare the emulated radio with reference results for the same traffic."""
    plan = QUICK_RADIO if quick else RadioPlan()
    if seeds is not None:
        plan = replace(plan, seeds=seeds)
    VALIDATION.run(plan, only, out=out, json=json)
