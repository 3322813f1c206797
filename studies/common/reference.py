"""Reference results: tables in studies/reference; its README states their origin."""

import csv
from pathlib import Path

REFERENCE = Path(__file__).parents[1] / "reference"


def reference_table(name: str) -> list[dict[str, str]]:
    """Return the rows of a table by column."""
    with (REFERENCE / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
