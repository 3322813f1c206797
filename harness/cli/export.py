"""Exports a run: an antenna as a NEC deck for nec2c and xnec2c, the flight in wide form, or all as MCAP.

Exit status: 0 success, 2 bad input or no antenna at that time, with one line on stderr, 130
interrupted.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from antenna.model.array_deck import deck_of
from antenna.model.geometry import ElementsTouch
from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.nec2c import Nec2cFailed
from antenna.solvers.selection import make_backend
from foundation.exit_status import BAD_INPUT, FINE, INTERRUPTED
from foundation.system_error import in_words
from harness.launch.interrupts import interruptible
from harness.records.run_folder import NotARun, RunFolder, read_scenario
from harness.records.tables import read_flight
from harness.records.wide import FORMATS, write_wide
from harness.report.flown_array import NoFeed, describe_touch, living, snapshot_at

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class DeckRefused(Exception):
    """There is no deck; the text is the reason in one line."""


class FlightRefused(Exception):
    """There is no flight to export, or no file for it; the text is the reason in one line."""


@app.command()
def export(
    run: Annotated[Path, typer.Argument(help="Folder of a run that has ended.", metavar="RUN")],
    *,
    time: Annotated[
        float | None,
        typer.Option(
            help="Write the antenna with its feeds at the recorded instant nearest to this time, in simulated"
            " seconds since the start, as a NEC deck.",
            metavar="S",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File of the deck; stdout without it.", metavar="FILE")
    ] = None,
    wide: Annotated[
        Path | None,
        typer.Option(
            help="Write flight.parquet with one row per instant and a group of columns for each UAV, such as"
            " uav0.pos_ned_m.n, to this file. Parquet keeps the descriptions of the columns.",
            metavar="FILE.parquet|FILE.csv",
        ),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(
            help="Write the whole run to this file for Foxglove and PlotJuggler: the scene, and all tables as"
            " messages with the times of the simulation. Only its owner can read it.",
            metavar="FILE.mcap",
        ),
    ] = None,
) -> None:
    """Write a run: its antenna as a NEC deck (--time), its flight as one table (--wide), or all (--mcap)."""
    if [time, wide, mcap].count(None) != 2:
        raise typer.BadParameter(
            "give one of --time, for a NEC deck, --wide, for the flight, and --mcap, for the whole run"
        )
    if out is not None and time is None:
        raise typer.BadParameter(
            "--out is the file of the deck of --time; --wide and --mcap name their own file"
        )
    if mcap is not None:
        _write_mcap(run, mcap)
    elif wide is not None:
        _write_flight(run, wide)
    elif time is not None:
        deck = deck_at(run, time)
        if out is None:
            sys.stdout.write(deck)
        else:
            out.write_text(deck, encoding="ascii")


def _write_flight(run: Path, target: Path) -> None:
    flight = RunFolder(run).flight
    if not flight.is_file():
        raise NotARun(f"{run}: no run that has ended: it has no {flight.name}")
    if target.suffix not in FORMATS:
        raise FlightRefused(f"--wide {target}: expected a name that ends in {' or '.join(FORMATS)}")
    if target.resolve() == flight.resolve():
        raise FlightRefused(f"--wide {target}: this is the run's own table; name another file")
    try:
        write_wide(flight, target)
    except (KeyError, ValueError) as error:
        raise FlightRefused(f"{flight}: not the flight of a run: {error.args[0]}") from None


def _write_mcap(run: Path, target: Path) -> None:
    from harness.export.run_export import SUFFIX, write_mcap  # noqa: PLC0415  slow to import, for --mcap only

    if target.suffix != SUFFIX:
        raise FlightRefused(f"--mcap {target}: expected a name that ends in {SUFFIX}")
    if target.is_dir():
        raise FlightRefused(f"--mcap {target}: it is a folder; name a file")
    try:
        write_mcap(RunFolder(run), target)
    except (KeyError, ValueError) as error:
        raise FlightRefused(f"{run}: its tables are not of the scenario in its manifest: {error}") from None


def deck_at(run: Path, time_s: float) -> str:
    """Return the deck of the recorded instant nearest to a simulated time; raises DeckRefused, OSError.

    The elements are those of the living vehicles, in their order.
    """
    folder = RunFolder(run)
    scenario = read_scenario(folder)
    try:
        flight = read_flight(folder, scenario)
    except (KeyError, ValueError):
        raise DeckRefused(f"{folder.flight}: not the flight of this manifest's scenario") from None
    times_s = flight.time_us * 1e-6
    if not len(flight) or not times_s[0] <= time_s <= times_s[-1]:
        there = f"has t = {times_s[0]:.3f} to {times_s[-1]:.3f} s" if len(flight) else "has no instant"
        raise DeckRefused(f"--time {time_s:g}: the run {there}")
    t = int(np.abs(times_s - time_s).argmin())
    vehicles = living(flight, t)
    try:
        snapshot = snapshot_at(flight, t, scenario.antenna)
        (pattern,) = make_backend(scenario.antenna).patterns([snapshot])
        if isinstance(pattern, ElementsTouch):
            raise pattern
    except ElementsTouch as touch:
        raise DeckRefused(f"t = {times_s[t]:.3f} s: {describe_touch(touch, vehicles)}") from None
    except (NoFeed, BackendUnavailable, Nec2cFailed) as error:
        raise DeckRefused(f"t = {times_s[t]:.3f} s: {error}") from None
    at = f"{scenario.name}, t = {times_s[t]:.3f} s, UAVs {', '.join(map(str, vehicles))}"
    return deck_of(snapshot, scenario.antenna, pattern, comments=[at])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    try:
        with interruptible():
            status = app(args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=False)
    except typer.TyperException as error:
        return _refuse(error.format_message())
    except (DeckRefused, FlightRefused, NotARun) as error:
        return _refuse(str(error))
    except OSError as error:
        return _refuse(in_words(error))
    if status == INTERRUPTED:  # typer's status for Ctrl-C
        sys.stderr.write("coflight: broken off: the same command starts again\n")
    return status if isinstance(status, int) else FINE


def _refuse(line: str) -> int:
    sys.stderr.write(f"coflight: {line}\n")
    return BAD_INPUT
