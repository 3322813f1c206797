"""Run the reference programs and write their tables: ``python scripts/ns3_references.py``."""

import csv
import os
import subprocess
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import track

from foundation.exit_status import BAD_INPUT, FAILED
from studies.ns3.cases import LONGEST_PPDU_US, Arguments, Table, tables

RUN_LIMIT_S = 3_600.0
"""Wall time after which a run has failed."""

ns3_references_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@ns3_references_app.command()
def ns3_references(
    build: Annotated[Path, typer.Option(help="Folder of the built programs.")] = Path("build/ns3"),
    out: Annotated[Path, typer.Option(help="Folder for the tables.")] = Path("studies/reference"),
    only: Annotated[str, typer.Option(help="Some of the tables.", metavar="NAME,NAME")] = ",".join(
        table.name for table in tables()
    ),
    workers: Annotated[
        int, typer.Option(help="Runs at a time; those that measure time run alone.", min=1)
    ] = os.cpu_count() or 1,
) -> None:
    """Run ns-3's reference programs and write one table for each kind of runs."""
    known = {table.name: table for table in tables()}
    names = only.split(",")
    if unknown := [name for name in names if name not in known]:
        _end(f"--only: no table is called {unknown[0]}; there are {', '.join(known)}", BAD_INPUT)
    for name in names:
        if not (build / known[name].program).is_file():
            _end(f"{build / known[name].program} is not there: build it (studies/ns3/README.md)", BAD_INPUT)
    out.mkdir(parents=True, exist_ok=True)
    for name in names:
        table = known[name]
        try:
            printed = _printed(table, build, workers)
            rows = list(track(printed, description=name, total=len(table.runs)))
        except (subprocess.SubprocessError, ValueError) as error:
            _end(f"{name}: {error}", FAILED)
        _write(out / f"{name}.csv", table.columns, [row for row in rows if _may_be_sent(table, row)])


def _printed(table: Table, build: Path, workers: int) -> Iterator[list[str]]:
    """Yield the printed values of each run, in order.

    Raises subprocess.SubprocessError if a run fails or exceeds `RUN_LIMIT_S`, ValueError if it prints
    another number of values than the table has columns.
    """
    command = (build / table.program).resolve()
    with ThreadPoolExecutor(1 if table.alone else workers) as pool:
        for values in pool.map(lambda run: _run(command, run), table.runs):
            if len(values) != len(table.columns):
                raise ValueError(f"{len(values)} values for {len(table.columns)} columns")
            yield values


def _may_be_sent(table: Table, row: list[str]) -> bool:
    """Return whether the PPDU of a row is within the standard's longest; ns-3's formula has no limit."""
    return table.name != "ns3_he_airtime" or float(row[-1]) <= LONGEST_PPDU_US


def _run(command: Path, arguments: Arguments) -> list[str]:
    options = [f"--{name}={value}" for name, value in arguments.items()]
    done = subprocess.run(
        [str(command), *options], stdout=subprocess.PIPE, text=True, check=True, timeout=RUN_LIMIT_S
    )
    return done.stdout.strip().split(",")


def _write(path: Path, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def _end(message: str, status: int) -> None:
    typer.echo(f"ns3_references: {message}", err=True)
    raise typer.Exit(status)
