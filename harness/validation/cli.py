"""The validation's command line. Exit status: 0 all that is required is met, 1 it is not, 2 bad input."""

from pathlib import Path
from typing import Annotated

import msgspec
import typer
from msgspec.structs import replace
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from harness import kernel_cache
from harness.validation.campaign import SUBJECTS, run
from harness.validation.plan import QUICK, Plan
from harness.validation.report import Section, markdown, show, write
from harness.validation.standard_output import keep_stdout

FINE, MISSED, BAD_INPUT = 0, 1, 2
WIDTH = 120
"""Columns where there is no terminal to ask."""

INTRODUCTION = """How well one vehicle flies: the autopilot as it flies in a swarm, over the swarm's physics
and sensors, in one process (`harness.validation.solo`). Every number comes from

    python scripts/validate_vehicle.py

which flies everything again and takes some minutes on two cores; with `--out docs` it writes this page and
its figures. All flights follow from their seeds: the same sources give the same numbers.
"""

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
    subjects = [name.strip() for name in only.split(",") if name.strip()]
    unknown = [name for name in subjects if name not in SUBJECTS]
    if unknown or not subjects:
        messages.print(f"validate_vehicle: --only {only!r}: expected some of {', '.join(SUBJECTS)}")
        raise typer.Exit(BAD_INPUT)
    plan = QUICK if quick else Plan()
    if seeds is not None:
        plan = replace(plan, seeds=seeds)
    kernel_cache.prepare(messages.print)
    stdout = keep_stdout()
    sections = _run(plan, subjects, out, messages)
    if out is not None:
        write(out / "validation.md", markdown(sections, introduction=INTRODUCTION))
    if json:
        print(msgspec.json.encode(_numbers(sections)).decode(), file=stdout)
    else:
        show(Console(file=stdout, highlight=False, width=None if stdout.isatty() else WIDTH), sections)
    missed = [check.name for section in sections for check in section.checks if not check.passed]
    raise typer.Exit(MISSED if missed else FINE)


def _run(plan: Plan, subjects: list[str], out: Path | None, messages: Console) -> list[Section]:
    """Fly it all, with a line of progress for every subject."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=messages) as progress:
        tasks: dict[str, TaskID] = {}

        def note(subject: str, done: int, total: int) -> None:
            if subject not in tasks:
                tasks[subject] = progress.add_task(subject, total=total)
            progress.update(tasks[subject], completed=done)
            if done == total and not messages.is_terminal:  # where no bar is drawn
                progress.console.print(f"{subject}: {total} done")

        return run(plan, subjects, images=out / "images" if out is not None else None, progress=note)


def _numbers(sections: list[Section]) -> list[dict[str, object]]:
    return [
        {
            "section": section.title, "name": check.name, "value": check.value, "unit": check.unit,
            "at_least": check.at_least, "at_most": check.at_most, "px4": check.px4, "met": check.passed,
        }
        for section in sections
        for check in section.checks
    ]  # fmt: skip
