"""Shared parts of the validations' command lines. Exit status: 0 all checks met, 1 not all, 2 bad input."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NoReturn, TextIO, TypeVar

import msgspec
import typer
from msgspec import Struct
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from studies.common.report import Section, figures_folder, figures_link, markdown, show, write
from studies.common.runner import Subject, run_subjects

FINE, MISSED, BAD_INPUT = 0, 1, 2
WIDTH = 120
"""Columns of the output if it is not a terminal."""
P = TypeVar("P")


class Page(Struct, frozen=True, kw_only=True):
    """File name, title and introduction of a validation's page."""

    file_name: str
    title: str
    introduction: str


def chosen(program: str, only: str, names: Iterable[str], messages: Console) -> list[str]:
    """Return the names in ``--only``; exit with an error message if one is not among ``names``."""
    selected = [name.strip() for name in only.split(",") if name.strip()]
    if not selected or not set(selected) <= set(names):
        messages.print(f"{program}: --only {only!r}: expected some of {', '.join(names)}")
        raise typer.Exit(BAD_INPUT)
    return selected


@contextlib.contextmanager
def progress_lines(messages: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress bar for each name; without a terminal, print a line when a name is complete.

    Yields a function that takes a name, the number of its finished jobs and their total.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=messages) as progress:
        tasks: dict[str, TaskID] = {}

        def note(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = progress.add_task(name, total=total)
            progress.update(tasks[name], completed=done)
            if done == total and not messages.is_terminal:
                progress.console.print(f"{name}: {total} done")

        yield note


def run_with_progress(
    plan: P, subjects: Mapping[str, Subject[P]], *, out: Path | None, messages: Console
) -> list[Section]:
    """Run all subjects with a progress line for each; figures are written to ``images`` in ``out``."""
    with progress_lines(messages) as note:
        images = None if out is None else figures_folder(out)
        return run_subjects(plan, subjects, images=images, progress=note)


def report_and_exit(
    sections: list[Section], *, page: Page, out: Path | None, json: bool, stdout: TextIO, px4: bool
) -> NoReturn:
    """Write the page if ``out`` is given, print the result and exit with the status of the checks.

    ``px4``: include the numbers of a real PX4.
    """
    if out is not None:
        text = markdown(sections, title=page.title, introduction=page.introduction, figures=figures_link(out))
        write(out / page.file_name, text)
    if json:
        print(msgspec.json.encode(_numbers(sections, px4=px4)).decode(), file=stdout)
    else:
        console = Console(file=stdout, highlight=False, width=None if stdout.isatty() else WIDTH)
        show(console, sections, px4=px4)
    met = all(check.passed for section in sections for check in section.checks)
    raise typer.Exit(FINE if met else MISSED)


def _numbers(sections: list[Section], *, px4: bool) -> list[dict[str, object]]:
    return [
        {
            "section": section.title, "name": check.name, "value": check.value, "unit": check.unit,
            "at_least": check.at_least, "at_most": check.at_most, **({"px4": check.px4} if px4 else {}),
            "met": check.passed,
        }
        for section in sections
        for check in section.checks
    ]  # fmt: skip
