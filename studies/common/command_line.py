"""Shared parts of the studies' command lines. Exit status: 0 all checks met, 1 not all, 2 bad input."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Generic, NoReturn, TextIO, TypeVar

import msgspec
import typer
from msgspec import Struct
from msgspec.structs import replace
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from foundation.exit_status import BAD_INPUT, FAILED, FINE
from harness.launch import kernel_cache
from harness.records.versions import checkout
from studies.common.job_records import JobRecords
from studies.common.record_lines import RecordsError
from studies.common.report import Section, show, write_csv, write_page
from studies.common.runner import WORKERS, Subject, run_subjects

WIDTH = 120
"""Columns of the output if it is not a terminal."""
CHECK_FIELDS = ("name", "value", "unit", "at_least", "at_most")
RecordsOption = Annotated[
    Path | None,
    typer.Option(help="Keep results in this file, and take those that it has: to measure in pieces."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print only the numbers, as one JSON object.")]
P = TypeVar("P")


class Page(Struct, frozen=True, kw_only=True):
    """File name, title and introduction of a study's page."""

    file_name: str
    title: str
    introduction: str
    csv_name: str | None = None
    """File of all checks with all digits"""


class Validation(Struct, Generic[P], frozen=True, kw_only=True):
    """A study that measures some subjects and compares them with requirements."""

    program: str
    page: Page
    subjects: dict[str, Subject[P]]
    """In the order of the page"""
    stages: tuple[tuple[str, ...], ...] = ()
    """Order of execution: a stage starts when the one before is complete; by default all are one stage"""
    workers: int = WORKERS
    """Jobs that run at a time"""
    has_kernels: bool = True
    has_bullet: bool = False
    """Whether PyBullet is used, which prints on standard output"""
    px4: bool = False
    """Include the numbers of a real PX4"""

    def run(
        self, plan: P, only: str, *, out: Path | None, json: bool, records: Path | None = None
    ) -> NoReturn:
        """Measure the subjects in ``--only``, report them and exit with the status of the checks.

        Results are kept in the file ``records``, and taken from it.
        """
        messages = Console(stderr=True, highlight=False, markup=False)
        names = chosen(self.program, only, self.subjects, messages)
        kept = None if records is None else self._records(records, messages)
        if self.has_kernels:
            kernel_cache.prepare(messages.print)
        stdout = keep_stdout() if self.has_bullet else sys.stdout
        judged: dict[str, Section] = {}
        for stage in self.stages or (tuple(self.subjects),):
            subjects = {name: self.subjects[name] for name in stage if name in names}
            if subjects:
                with progress_lines(messages) as note, _refused(self.program, messages):
                    judged |= run_subjects(plan, subjects, progress=note, records=kept, workers=self.workers)
        sections = [judged[name] for name in self.subjects if name in judged]
        page = self.page
        if kept is not None:
            used = [job for name in names for jobs in self.subjects[name].jobs(plan).values() for job in jobs]
            pieces = f"\nMeasured in pieces, with the commits {', '.join(kept.commits_of(used))}.\n"
            page = replace(page, introduction=page.introduction + pieces)
        report_and_exit(sections, page=page, out=out, json=json, stdout=stdout, px4=self.px4)

    def _records(self, path: Path, messages: Console) -> JobRecords:
        """Return the records of a file; exit with an error message if it cannot be read."""
        state = checkout()
        commit = "unknown" if state is None else state.commit[:8] + (" and changes" if state.dirty else "")
        with _refused(self.program, messages):
            return JobRecords(path, commit)


@contextlib.contextmanager
def _refused(program: str, messages: Console) -> Iterator[None]:
    """Exit with an error message if records of results cannot be used."""
    try:
        yield
    except RecordsError as error:
        messages.print(f"{program}: --records: {error}", soft_wrap=True)
        raise typer.Exit(BAD_INPUT) from None


def keep_stdout() -> TextIO:
    """Return a stream for the results, and redirect standard output to standard error.

    Bullet prints a line on standard output, at its import or when the process ends.
    """
    sys.stdout.flush()
    stdout = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return stdout


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


def report_and_exit(
    sections: list[Section], *, page: Page, out: Path | None, json: bool, stdout: TextIO, px4: bool = False
) -> NoReturn:
    """Write the page if ``out`` is given, print the result and exit with the status of the checks."""
    checks = [(section, check) for section in sections for check in section.checks]
    if out is not None:
        write_page(out, page.file_name, sections, title=page.title, introduction=page.introduction)
        if page.csv_name is not None:
            rows = [
                (section.title, *(getattr(check, name) for name in CHECK_FIELDS), check.passed)
                for section, check in checks
            ]
            write_csv(out / page.csv_name, ("section", *CHECK_FIELDS, "met"), rows, all_digits=True)
    if json:
        fields = (*CHECK_FIELDS, *(("px4",) if px4 else ()))
        numbers = [
            {"section": section.title, **{name: getattr(check, name) for name in fields}, "met": check.passed}
            for section, check in checks
        ]
        print(msgspec.json.encode({"checks": numbers}).decode(), file=stdout)
    else:
        show(result_console(stdout), sections, px4=px4)
    raise typer.Exit(FINE if all(check.passed for _, check in checks) else FAILED)


def result_console(stdout: TextIO) -> Console:
    """Return a console for tables."""
    return Console(file=stdout, highlight=False, width=None if stdout.isatty() else WIDTH)


def repeated_command(script: str, *options: tuple[str, bool]) -> str:
    """Return the command of a script with those options that are set."""
    return " ".join([f"python scripts/{script}", *(text for text, is_set in options if is_set)])
