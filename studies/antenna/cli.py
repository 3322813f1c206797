"""The command line of the antenna's validation: see `studies.common.command_line`."""

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
"""In the page's order."""
ALONE = ("speed",)
"""Measured when nothing else runs."""
INTRODUCTION = """The batch solver beside NEC2, in PyNEC and in the program nec2c, and all of them beside
closed forms and reference numbers. Every number comes from

    python scripts/validate_antenna.py

which computes everything again and takes some minutes on two cores; with `--out docs` it writes this page,
its figures and `antenna-validation.csv`, the checks in full. All formations follow from their seeds: the same
sources give the same numbers, but for the speed.
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
        float | None, typer.Option(help="Of the benchmark, about.", min=0.0, max=3_600.0)
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print only the numbers, as JSON.")] = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(help=f"Folder for {PAGE.file_name}, {TABLE} and images/; none writes nothing."),
    ] = None,
) -> None:
    """Measure how right the antenna's solvers are: against NEC2, closed forms and reference numbers."""
    messages = Console(stderr=True, highlight=False)
    names = chosen("validate_antenna", only, SUBJECTS, messages)
    plan = QUICK_ANTENNA if quick else AntennaPlan()
    if seconds is not None:
        plan = replace(plan, benchmark_s=seconds)
    judged: dict[str, Section] = {}
    for alone in (False, True):
        wanted = {name: one for name, one in SUBJECTS.items() if name in names and (name in ALONE) == alone}
        if wanted:
            found = run_with_progress(plan, wanted, out=out, messages=messages)
            judged |= dict(zip(wanted, found, strict=True))
    sections = [judged[name] for name in SUBJECTS if name in judged]
    if out is not None:
        write_table(out / TABLE, sections)
    report_and_exit(sections, page=PAGE, out=out, json=json, stdout=sys.stdout, px4=False)


def write_table(path: Path, sections: Sequence[Section]) -> None:
    """Write all checks with all digits."""
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
