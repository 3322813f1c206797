"""Content of a page as data: cards, sections with facts, tables and figures, all of them plain text.

The template escapes every text. Texts of figures are escaped where they are made (`encoding.plot_text`).
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

from harness.report.page.plots import Plot


@dataclass(frozen=True, slots=True)
class Link:
    """A text that leads to a file of the folder, or to a part of the page."""

    text: str
    target: str
    """Relative, with letters that a URL needs quoted"""


Cell = str | Link


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table; cells of ``numeric`` columns stand on the right."""

    heads: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""
    note: str = ""
    numeric: Sequence[int] = ()
    is_long: bool = False
    """Whether it scrolls within a limited height"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Card:
    """A result at the head of the page."""

    label: str
    value: str
    detail: str = ""
    tone: str = ""
    """``good``, ``bad`` or nothing"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Section:
    """A part of the page with a title."""

    key: str
    title: str
    text: str = ""
    facts: Sequence[tuple[str, Cell]] = ()
    plots: Sequence[Plot] = ()
    tables: Sequence[Table] = ()
    replay: Mapping[str, Any] | None = None
    """Data of the 3-D replay, which stands before the figures"""
    replay_note: str = ""
    source: str = ""
    """A long text, such as settings, that is unfolded on demand"""
    source_title: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Page:
    """A page."""

    kind: str
    """What it reports, such as ``Run``"""
    title: str
    subtitle: Sequence[str]
    badge: str
    badge_tone: str
    notes: Sequence[str] = ()
    """Lines of warning below the title"""
    cards: Sequence[Card] = ()
    sections: Sequence[Section] = ()
    vehicles: Sequence[str] = ()
    """Colours of the vehicles, for switches that show and hide them"""
    footer: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)
    """Further data for the script"""

    def payload(self) -> dict[str, Any]:
        """Return the data for the script."""
        plots = [plot for section in self.sections for plot in section.plots]
        replay = next((each.replay for each in self.sections if each.replay is not None), None)
        return {
            "plots": {plot.key: plot.content() for plot in plots},
            "replay": replay,
            "vehicles": list(self.vehicles),
            **self.extra,
        }


def file_link(name: str) -> Link:
    """Return a link to a file of the page's folder; bytes of its name that are not UTF-8 show as U+FFFD."""
    encoded = os.fsencode(name)
    return Link(encoded.decode(errors="replace"), quote(encoded))


def number(value: float | None, form: str = ".3f", unit: str = "") -> str:
    """Return a number with its unit; a dash for None."""
    if value is None:
        return "–"
    text = f"{value:{form}} {unit}".rstrip()
    return text[1:] if text.startswith("-") and not text.strip("-0. " + unit) else text


def count(value: float | None) -> str:
    """Return a whole number in groups of three digits; a dash for None."""
    return "–" if value is None else f"{int(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def percent(part: float, whole: float, form: str = ".2f") -> str:
    """Return a share as text; a dash of nothing."""
    return f"{100.0 * part / whole:{form}} %" if whole else "–"


def size_text(size_bytes: int) -> str:
    """Return the size of a file."""
    if size_bytes < 1_000:
        return f"{size_bytes} B"
    return f"{size_bytes / 1e3:.0f} kB" if size_bytes < 1_000_000 else f"{size_bytes / 1e6:.1f} MB"
