"""Command line of the antenna's validation: see `studies.common.command_line`."""

from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from studies.antenna import agreement, ideal, limits, sensitivity, speed
from studies.antenna.plan import QUICK_ANTENNA, AntennaPlan
from studies.common.command_line import JsonOption, Page, Validation
from studies.common.runner import Subject

SUBJECTS: dict[str, Subject[AntennaPlan]] = {
    "ideal": Subject(ideal.jobs, ideal.judge),
    "agreement": Subject(agreement.jobs, agreement.judge),
    "sensitivity": Subject(sensitivity.jobs, sensitivity.judge),
    "limits": Subject(limits.jobs, limits.judge),
    "speed": Subject(speed.jobs, speed.judge),
}
INTRODUCTION = """The batch solver compared with NEC2, in PyNEC and in the program nec2c, and all three
compared with closed forms and reference results. All numbers are produced by

    python scripts/validate_antenna.py

which repeats all computations in some minutes on two cores; with `--out docs/results` it writes this page,
its figures and `antenna-validation.csv`, the checks with all digits. All formations are determined by their
seeds: the same sources give the same numbers, except for the speed.
"""
VALIDATION = Validation(
    program="validate_antenna",
    page=Page(
        file_name="antenna-validation.md", title="Validation of the antenna", introduction=INTRODUCTION,
        csv_name="antenna-validation.csv",
    ),
    subjects=SUBJECTS,
    stages=(("ideal", "agreement", "sensitivity", "limits"), ("speed",)),  # nothing else runs beside speed
    has_kernels=False,
)  # fmt: skip

validate_antenna_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@validate_antenna_app.command()
def validate_antenna(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer formations, a shorter benchmark.")] = False,  # noqa: FBT002
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(SUBJECTS)}.", metavar="NAME,NAME")
    ] = ",".join(SUBJECTS),
    seconds: Annotated[
        float | None, typer.Option(help="Approximate length of the benchmark.", min=0.0, max=3_600.0)
    ] = None,
    json: JsonOption = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for antenna-validation.md, antenna-validation.csv and images/; by default none."
        ),
    ] = None,
) -> None:
    """Compare the antenna solvers with NEC2, closed forms and reference results."""
    plan = QUICK_ANTENNA if quick else AntennaPlan()
    if seconds is not None:
        plan = replace(plan, benchmark_s=seconds)
    VALIDATION.run(plan, only, out=out, json=json)
