"""Command line of the radio's validation: see `studies.common.command_line`."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace
from rich.console import Console

from harness.launch import kernel_cache
from studies.common.command_line import Page, chosen, report_and_exit, run_with_progress
from studies.common.runner import Subject
from studies.radio import broadcast_section, error_section, mesh_section, ranging_section, saturation_section
from studies.radio.plan import QUICK_RADIO, RadioPlan

SUBJECTS: dict[str, Subject[RadioPlan]] = {
    "broadcast": Subject(broadcast_section.jobs, broadcast_section.judge),
    "saturation": Subject(saturation_section.jobs, saturation_section.judge),
    "ftm-mesh": Subject(mesh_section.jobs, mesh_section.judge),
    "ftm": Subject(ranging_section.jobs, ranging_section.judge),
    "per": Subject(error_section.jobs, error_section.judge),
}
"""In the order of execution: the longest jobs first."""
ORDER = ("saturation", "broadcast", "per", "ftm", "ftm-mesh")
"""Order of the sections on the page."""
INTRODUCTION = """The 802.11 emulator without a flight, compared with ns-3 3.37, Bianchi's model and the
figures of the standard. All numbers are produced by

    python scripts/validate_radio.py

which repeats all simulations in some minutes on two cores; with `--out docs/results` it writes this page
and its figures. The reference results of ns-3 and Bianchi's model are in `studies/reference`. All runs are
determined by their seeds: the same sources give the same numbers.
"""
PAGE = Page(file_name="radio-validation.md", title="Validation of the radio", introduction=INTRODUCTION)

validate_radio_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@validate_radio_app.command()
def validate_radio(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and shorter runs.")] = False,  # noqa: FBT002
    only: Annotated[str, typer.Option(help=f"Some of {', '.join(ORDER)}.", metavar="NAME,NAME")] = ",".join(
        ORDER
    ),
    seeds: Annotated[int | None, typer.Option(help="Runs of each condition.", min=1)] = None,
    json: Annotated[bool, typer.Option("--json", help="Print only the numbers, as JSON.")] = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for radio-validation.md and images/; without it no file is written."),
    ] = None,
) -> None:
    """Compare the emulated radio with reference results for the same traffic."""
    messages = Console(stderr=True, highlight=False)
    names = chosen("validate_radio", only, ORDER, messages)
    plan = QUICK_RADIO if quick else RadioPlan()
    if seeds is not None:
        plan = replace(plan, seeds=seeds)
    kernel_cache.prepare(messages.print)
    subjects = {name: subject for name, subject in SUBJECTS.items() if name in names}
    judged = dict(zip(subjects, run_with_progress(plan, subjects, out=out, messages=messages), strict=True))
    sections = [judged[name] for name in ORDER if name in judged]
    report_and_exit(sections, page=PAGE, out=out, json=json, stdout=sys.stdout, px4=False)
