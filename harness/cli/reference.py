"""The generated pages of docs/reference: which there are, whether they are current, and writing them.

Their content is made by the modules `harness.cli.reference_*`; `scripts/write_reference.py` is the command.
"""

from collections.abc import Mapping
from pathlib import Path

import typer

from harness.cli.reference_commands import commands_page
from harness.cli.reference_python import python_page
from harness.cli.reference_scenario import SCHEMA_FILE, scenario_page, scenario_schema
from harness.cli.reference_tables import tables_page


def reference_pages(applications: Mapping[str, typer.Typer]) -> dict[str, str]:
    """Return the text of every page by its file name; raises UndocumentedError.

    ``applications``: the command lines to describe, by the name of their script.
    """
    return {
        "scenario.md": scenario_page(),
        SCHEMA_FILE: scenario_schema(),
        "command-line.md": commands_page(applications),
        "tables.md": tables_page(),
        "python-api.md": python_page(),
    }


def outdated(pages: Mapping[str, str], folder: Path) -> list[str]:
    """Return the names of the pages that the folder lacks or has with another text."""
    return [
        name
        for name, text in pages.items()
        if not (folder / name).is_file() or (folder / name).read_text(encoding="utf-8") != text
    ]


def write_pages(pages: Mapping[str, str], folder: Path) -> None:
    """Write the pages into the folder; raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages.items():
        (folder / name).write_text(text, encoding="utf-8")
