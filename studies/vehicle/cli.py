"""The command line of the vehicle's validation: see `studies.common.command_line`."""

from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace
from rich.console import Console

from harness.launch import kernel_cache
from studies.common.command_line import BAD_INPUT, Page, chosen, run_with_progress, tell
from studies.common.standard_output import keep_stdout
from studies.vehicle.campaign import SUBJECTS
from studies.vehicle.plan import QUICK, VehiclePlan

__all__ = ["BAD_INPUT", "validate_app"]

INTRODUCTION = """How well one vehicle flies: the autopilot as it flies in a swarm, over the swarm's physics
and sensors, in one process (`studies.vehicle.solo`). Every number comes from

    python scripts/validate_vehicle.py

which flies everything again and takes some minutes on two cores; with `--out docs/results` it writes this
page and its figures. All flights follow from their seeds: the same sources give the same numbers.
"""
PAGE = Page(file_name="validation.md", title="Validation of one vehicle", introduction=INTRODUCTION)

validate_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@validate_app.command()
def validate(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and shorter flights.")] = False,  # noqa: FBT002
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(SUBJECTS)}.", metavar="NAME,NAME")
    ] = ",".join(SUBJECTS),
    seeds: Annotated[int | None, typer.Option(help="Flights of each condition.", min=1)] = None,
    json: Annotated[bool, typer.Option("--json", help="The numbers alone on stdout.")] = False,  # noqa: FBT002
    out: Annotated[
        Path | None, typer.Option(help="Folder for validation.md and images/; none writes nothing.")
    ] = None,
) -> None:
    """Measure how well one vehicle flies, and compare it with what is required and with a real PX4."""
    messages = Console(stderr=True, highlight=False)
    names = chosen("validate_vehicle", only, SUBJECTS, messages)
    plan = QUICK if quick else VehiclePlan()
    if seeds is not None:
        plan = replace(plan, seeds=seeds)
    kernel_cache.prepare(messages.print)
    stdout = keep_stdout()
    subjects = {name: SUBJECTS[name] for name in names}
    sections = run_with_progress(plan, subjects, out=out, messages=messages)
    tell(sections, page=PAGE, out=out, json=json, stdout=stdout, px4=True)
