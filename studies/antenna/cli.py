"""Command line of the antenna's validation: see `studies.common.command_line`."""

import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace
from rich.console import Console

from studies.antenna import agreement, ideal, limits, sensitivity, speed
from studies.antenna.plan import QUICK_ANTENNA, AntennaPlan
from studies.common.command_line import Page, chosen, report_and_exit, run_with_progress
from studies.common.report import Section
from studies.common.runner import Subject

SUBJECTS: dict[str, Subject[AntennaPlan]] = {
    "ideal": Subject(ideal.jobs, ideal.judge),
    "agreement": Subject(agreement.jobs, agreement.judge),
    "sensitivity": Subject(sensitivity.jobs, sensitivity.judge),
    "limits": Subject(limits.jobs, limits.judge),
    "speed": Subject(speed.jobs, speed.judge),
}
"""In the order of the page."""
ALONE = ("speed",)
"""Subjects that are measured while no other subject runs."""
INTRODUCTION = """The batch solver compared with NEC2, in PyNEC and in the program nec2c, and all three
compared with closed forms and reference results. All numbers are produced by

    python scripts/validate_antenna.py

which repeats all computations in some minutes on two cores; with `--out docs/results` it writes this page,
its figures and `antenna-validation.csv`, the checks with all digits. All formations are determined by their
seeds: the same sources give the same numbers, except for the speed.
"""
PAGE = Page(file_name="antenna-validation.md", title="Validation of the antenna", introduction=INTRODUCTION)
TABLE = "antenna-validation.csv"

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
    json: Annotated[bool, typer.Option("--json", help="Print only the numbers, as JSON.")] = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(help=f"Folder for {PAGE.file_name}, {TABLE} and images/; by default none."),
    ] = None,
) -> None:
    """Compare the antenna solvers with NEC2, closed forms and reference results."""
    messages = Console(stderr=True, highlight=False)
    names = chosen("validate_antenna", only, SUBJECTS, messages)
    plan = QUICK_ANTENNA if quick else AntennaPlan()
    if seconds is not None:
        plan = replace(plan, benchmark_s=seconds)
    judged: dict[str, Section] = {}
    for alone in (False, True):
        subjects = {name: one for name, one in SUBJECTS.items() if name in names and (name in ALONE) == alone}
        if subjects:
            found = run_with_progress(plan, subjects, out=out, messages=messages)
            judged |= dict(zip(subjects, found, strict=True))
    sections = [judged[name] for name in SUBJECTS if name in judged]
    if out is not None:
        write_table(out / TABLE, sections)
    report_and_exit(sections, page=PAGE, out=out, json=json, stdout=sys.stdout, px4=False)


def write_table(path: Path, sections: Sequence[Section]) -> None:
    """Write all checks as CSV with all digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("section", "name", "value", "unit", "at_least", "at_most", "met"))
        for one in sections:
            for check in one.checks:
                table.writerow((
                    one.title, check.name, check.value, check.unit, check.at_least, check.at_most,
                    check.passed,
                ))  # fmt: skip
