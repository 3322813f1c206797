"""Results of a validation: checks against requirements and tables, as Markdown and on the terminal."""

import os
from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct
from rich.console import Console
from rich.table import Table as RichTable

PASSED, FAILED = "yes", "**no**"


class Check(Struct, frozen=True, kw_only=True):
    """One number and its required range; ``at_least`` and ``at_most`` are inclusive, None is no bound."""

    name: str
    value: float
    unit: str = ""
    at_least: float | None = None
    at_most: float | None = None
    px4: str = ""
    """The same number of a real PX4, if it was measured"""

    @property
    def passed(self) -> bool:
        """Whether the value lies within its bounds; not-a-number does not."""
        above = self.at_least is None or self.value >= self.at_least
        return above and (self.at_most is None or self.value <= self.at_most)

    @property
    def requirement(self) -> str:
        """Bounds as text."""
        if self.at_least is not None and self.at_most is not None:
            return f"{_number(self.at_least)} to {_number(self.at_most)}"
        if self.at_most is not None:
            return f"at most {_number(self.at_most)}"
        return f"at least {_number(self.at_least)}" if self.at_least is not None else ""

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """Name, value, requirement and verdict."""
        verdict = PASSED if self.passed else FAILED
        return self.name, f"{_number(self.value)} {self.unit}".rstrip(), self.requirement, verdict


class ReportTable(Struct, frozen=True, kw_only=True):
    """Table of numbers that explain the checks."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


class Section(Struct, frozen=True, kw_only=True):
    """One subject of a report."""

    title: str
    conditions: str
    """How it was measured: Markdown paragraphs"""
    checks: tuple[Check, ...]
    tables: tuple[ReportTable, ...] = ()
    figures: tuple[tuple[str, str], ...] = ()
    """(file name, what it shows)"""


def figures_folder(out: Path) -> Path:
    """Return the folder for figures of pages in ``out``: ``../images`` where it exists, else ``images``."""
    shared = out.parent / "images"
    return shared if shared.is_dir() else out / "images"


def figures_link(out: Path | None) -> str:
    """Return the path of the figures' folder from a page in ``out``, with slashes."""
    return "images" if out is None else Path(os.path.relpath(figures_folder(out), out)).as_posix()


def markdown(
    sections: Sequence[Section],
    *,
    introduction: str,
    title: str = "Validation of one vehicle",
    figures: str = "images",
) -> str:
    """Return the whole page; its figures are in ``images/`` beside it."""
    parts = [f"# {title}\n", introduction]
    for section in sections:
        parts += [f"## {section.title}\n", section.conditions]
        columns: tuple[str, ...] = ("what", "measured", "required", "met")
        with_px4 = any(check.px4 for check in section.checks)
        if with_px4:
            columns = (*columns[:2], "PX4", *columns[2:])
        rows = [
            (*check.cells[:2], check.px4, *check.cells[2:]) if with_px4 else check.cells
            for check in section.checks
        ]
        if rows:
            parts.append(_markdown_table(columns, rows))
        for table in section.tables:
            parts += [f"{table.caption}\n", _markdown_table(table.columns, table.rows)]
        parts += [f"![{shows}]({figures}/{name})\n" for name, shows in section.figures]
    return "\n".join(parts).rstrip() + "\n"


def write(path: Path, text: str) -> None:
    """Write the page; creates its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def show(console: Console, sections: Sequence[Section], *, px4: bool = True) -> None:
    """Print checks and tables, with a column for a real PX4's numbers if ``px4``."""
    for section in sections:
        table = RichTable(title=section.title, title_justify="left", title_style="bold")
        for column in ("what", "measured", "required", "met", *(("PX4",) if px4 else ())):
            table.add_column(column)
        for check in section.checks:
            name, value, requirement, _ = check.cells
            met = "[green]yes[/]" if check.passed else "[bold red]no[/]"
            table.add_row(name, value, requirement, met, *((check.px4,) if px4 else ()))
        console.print(table if section.checks else f"[bold]{section.title}[/]")
        for more in section.tables:
            detail = RichTable(title=more.caption, title_justify="left", title_style="italic")
            for column in more.columns:
                detail.add_column(column)
            for row in more.rows:
                detail.add_row(*row)
            console.print(detail)


def _markdown_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _number(value: float) -> str:
    """Format with three significant digits, without exponent from 1e-4 to 1e5."""
    if value == 0.0 or 1e-4 <= abs(value) < 1e5:
        digits = f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
        return "0" if digits == "-0" else digits
    return f"{value:.1e}"
