"""Command line of the vehicle's validation: see `studies.common.command_line`."""

from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from studies.common.command_line import JsonOption, Page, Validation
from studies.common.runner import Subject
from studies.vehicle import (
    airframe_section,
    attitude_sections,
    estimation_section,
    hover_section,
    move_section,
)
from studies.vehicle.plan import QUICK, VehiclePlan

SUBJECTS: dict[str, Subject[VehiclePlan]] = {
    "px4": Subject(hover_section.px4_jobs, hover_section.judge_px4),
    "hover": Subject(hover_section.hover_jobs, hover_section.judge_hover),
    "steps": Subject(move_section.jobs, move_section.judge),
    "airframes": Subject(airframe_section.jobs, airframe_section.judge),
    "upsets": Subject(attitude_sections.upset_jobs, attitude_sections.judge_upsets),
    "allocation": Subject(attitude_sections.allocation_jobs, attitude_sections.judge_allocation),
    "estimator": Subject(estimation_section.jobs, estimation_section.judge),
}
INTRODUCTION = """Flight performance of a single vehicle: the same autopilot, physics and sensors as in a
swarm, in one process (`studies.vehicle.solo`). All numbers are produced by

    python scripts/validate_vehicle.py

which repeats all flights in some minutes on two cores; with `--out docs/results` it writes this page and
its figures. All flights are determined by their seeds: the same sources give the same numbers.
"""
VALIDATION = Validation(
    program="validate_vehicle",
    page=Page(file_name="validation.md", title="Validation of one vehicle", introduction=INTRODUCTION),
    subjects=SUBJECTS,
    has_bullet=True,
    px4=True,
)

validate_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@validate_app.command()
def validate(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and shorter flights.")] = False,  # noqa: FBT002
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(SUBJECTS)}.", metavar="NAME,NAME")
    ] = ",".join(SUBJECTS),
    seeds: Annotated[int | None, typer.Option(help="Flights of each condition.", min=1)] = None,
    json: JsonOption = False,  # noqa: FBT002
    out: Annotated[
        Path | None, typer.Option(help="Folder for validation.md and images/; without it no file is written.")
    ] = None,
) -> None:
    """Measure the flight performance of one vehicle against its requirements and a real PX4."""
    plan = QUICK if quick else VehiclePlan()
    if seeds is not None:
        plan = replace(plan, seeds=seeds)
    VALIDATION.run(plan, only, out=out, json=json)
