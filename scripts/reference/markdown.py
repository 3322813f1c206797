"""Markdown of the generated reference: tables, text of docstrings, units of names."""

import inspect
import re
from collections.abc import Iterable, Sequence

from foundation.unit_names import frame_of, unit_of


class UndocumentedError(RuntimeError):
    """Something that the reference has to describe has no description in the code."""


def unit_and_frame(name: str) -> str:
    """Return the unit, and the frame of a vector, that a name states; empty without a unit."""
    unit = unit_of(name)
    return ", ".join(filter(None, (unit, frame_of(name)))) if unit else ""


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; bars in cells are escaped."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def one_line(text: str) -> str:
    """Return a docstring as one line of Markdown."""
    return code_spans(" ".join(text.split()))


def code_spans(text: str) -> str:
    """Return text with the double backticks of docstrings as code spans of Markdown."""
    return re.sub(r"``(.+?)``", r"`\1`", text)


def paragraphs(text: str) -> str:
    """Return a docstring as Markdown: paragraphs, lists of arguments, indented examples as blocks of code."""
    parts = []
    for block in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        lines = block.rstrip().splitlines()
        if all(line.startswith("    ") for line in lines):
            parts.append("\n".join(["```python", *(line[4:] for line in lines), "```"]))
        elif lines[0].strip() in {"Args:", "Attributes:", "Returns:", "Raises:"}:
            parts.append(f"{lines[0].strip()}\n\n{_arguments(lines[1:])}")
        elif re.match(r"``\w+``(:| )", lines[0]) and len(lines) > 1:
            parts.append(_named(lines))
        else:
            parts.append(one_line(block))
    return "\n\n".join(parts)


def _arguments(lines: Sequence[str]) -> str:
    """Return a list of lines ``name: text``, continued on lines that are indented further."""
    items: list[str] = []
    for line in inspect.cleandoc("\n".join(["", *lines])).splitlines():
        if line.startswith(" ") and items:
            items[-1] += f" {line.strip()}"
        else:
            name, colon, text = line.partition(":")
            items.append(f"- `{name}`:{text}" if colon else f"- {line}")
    return code_spans("\n".join(items))


def _named(lines: Sequence[str]) -> str:
    """Return a list of the lines that begin with a name in backticks, each with those that follow it."""
    items: list[str] = []
    for line in lines:
        if re.match(r"``\w+``(:| )", line) or not items:
            items.append(f"- {line}")
        else:
            items[-1] += f" {line.strip()}"
    return code_spans("\n".join(items))
