"""What the command lines of the validations share. Exit status: 0 all is met, 1 it is not, 2 bad input."""

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
"""Columns where there is no terminal to ask."""
P = TypeVar("P")


class Page(Struct, frozen=True, kw_only=True):
    """What is written of a validation."""

    file_name: str
    title: str
    introduction: str


def chosen(program: str, only: str, names: Iterable[str], messages: Console) -> list[str]:
    """Names in ``--only``; ends the program with one line if they are not among ``names``."""
    wanted = [name.strip() for name in only.split(",") if name.strip()]
    if not wanted or not set(wanted) <= set(names):
        messages.print(f"{program}: --only {only!r}: expected some of {', '.join(names)}")
        raise typer.Exit(BAD_INPUT)
    return wanted


@contextlib.contextmanager
def progress_lines(
    messages: Console,
) -> Iterator[tuple[Callable[[str, int, int], None], Callable[[str], None]]]:
    """Show a bar for everything that is named, or where no bar is drawn a line now and then.

    Gives two functions: one is told a name, how much of it is done and how much there is, the other a line
    that stays.
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

        yield note, lambda line: progress.console.print(line, markup=False)


def run_with_progress(
    plan: P, subjects: Mapping[str, Subject[P]], *, out: Path | None, messages: Console
) -> list[Section]:
    """Do it all, with a line of progress for every subject; figures go to `figures_folder` of ``out``."""
    with progress_lines(messages) as (note, _):
        images = None if out is None else figures_folder(out)
        return run_subjects(plan, subjects, images=images, progress=note)


def tell(
    sections: list[Section], *, page: Page, out: Path | None, json: bool, stdout: TextIO, px4: bool
) -> NoReturn:
    """Write the page if there is a folder for it, print the result, and end the program by it.

    ``px4``: numbers of a real PX4 stand beside ours.
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
