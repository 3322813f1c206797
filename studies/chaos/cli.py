"""Command line of the chaos study. Exit status: 0 all as required, 1 not all, 2 bad input, 130 Ctrl-C."""

import contextlib
import resource
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console

from foundation.exit_status import BAD_INPUT, FAILED, FINE, INTERRUPTED
from harness.launch import kernel_cache
from harness.launch.interrupts import interruptible
from harness.records.versions import checkout
from studies.chaos import records, small_disk
from studies.chaos.faults import Fault, plan
from studies.chaos.flight import Outcome
from studies.chaos.page import page, write
from studies.chaos.records import FlightRecord
from studies.chaos.side_by_side import fly_all
from studies.common.command_line import JsonOption
from studies.common.record_lines import RecordsError, append_record

chaos_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@chaos_app.command()
def main(
    flights: Annotated[int, typer.Option(help="Number of flights, of about 10 s each.", min=1)] = 20,
    seed: Annotated[int, typer.Option(help="Seed of the faults.", min=0)] = 1,
    only: Annotated[
        str, typer.Option(help="Fly only faults whose title has this text.", show_default="all")
    ] = "",
    beside: Annotated[int, typer.Option(help="Flights at the same time.", min=1)] = 1,
    file: Annotated[
        Path | None,
        typer.Option(
            "--records", help="File that gets each flight; those in it are not flown.", metavar="FILE"
        ),
    ] = None,
    again: Annotated[  # noqa: FBT002
        bool, typer.Option("--again", help="Repeat once each flight that did not end as required.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the page chaos.md.", metavar="DIR")] = None,
    json: JsonOption = False,  # noqa: FBT002
) -> None:
    """Fly with random faults of the run's processes, and judge how each flight ends."""
    messages = Console(stderr=True, highlight=False, markup=False)
    faults = plan(flights, seed)
    chosen = {number: fault for number, fault in enumerate(faults) if only in fault.title}
    try:
        flown = [] if file is None else records.read(file, faults, seed)
    except RecordsError as error:
        messages.print(f"coflight study chaos: {error}", soft_wrap=True)
        raise typer.Exit(BAD_INPUT) from None
    kernel_cache.prepare(messages.print)
    state = checkout()
    commit = "" if state is None else state.commit + ("-dirty" if state.dirty else "")

    def keep(number: int, outcome: Outcome, *, is_again: bool) -> None:
        flown.append(FlightRecord(seed=seed, number=number, commit=commit, again=is_again, outcome=outcome))
        if file is not None:
            append_record(file, flown[-1])
        messages.print(f"{number}: {'again: ' if is_again else ''}{_line(outcome)}", soft_wrap=True)

    before = len(flown)
    first, _ = records.first_and_again(flown)
    not_permitted = _without_disk(chosen)
    left_out = not_permitted - first.keys()
    if left_out:
        messages.print(
            f"{len(left_out)} flights with a full disk are left out: this machine permits no mount namespace",
            soft_wrap=True,
        )
    try:
        with interruptible():
            missing = [each for each in chosen.items() if each[0] not in {*first, *left_out}]
            _fly(missing, beside, lambda *each: keep(*each, is_again=False))
            first, repeated = records.first_and_again(flown)
            if again:
                bad = [
                    (number, fault)
                    for number, fault in chosen.items()
                    if number in first
                    and first[number].outcome.complaints
                    and number not in {*repeated, *not_permitted}
                ]
                _fly(bad, beside, lambda *each: keep(*each, is_again=True))
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None
    if len(flown) > before:
        mean_s = _processor_s() / (len(flown) - before)
        messages.print(
            f"{mean_s:.1f} s of processor time a flight, without processes that outlive a launcher"
        )
    counted = [each for each in flown if each.number in chosen]
    text = page(
        counted, flights=flights, seed=seed, beside=None if before else beside, left_out=len(left_out)
    )
    if out is not None:
        messages.print(f"written to {write(out, text)}")
    first, _ = records.first_and_again(counted)
    outcomes = [first[number].outcome for number in sorted(first)]
    if json:
        sys.stdout.write(msgspec.json.encode({"flights": outcomes}).decode() + "\n")
    elif out is None:
        sys.stdout.write(text)
    raise typer.Exit(FAILED if any(outcome.complaints for outcome in outcomes) else FINE)


def _fly(faults: list[tuple[int, Fault]], beside: int, keep: Callable[[int, Outcome], None]) -> None:
    with contextlib.closing(fly_all(faults, beside)) as flights:
        for number, outcome in flights:
            keep(number, outcome)


def _processor_s() -> float:
    """Return the processor time of this process and of the children that have ended."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def _without_disk(chosen: dict[int, Fault]) -> set[int]:
    """Return the numbers of the flights that this machine does not permit."""
    disks = {number for number, fault in chosen.items() if fault.target == "disk"}
    if not disks or small_disk.is_permitted(Path(tempfile.gettempdir())):
        return set()
    return disks


def _line(outcome: Outcome) -> str:
    if not outcome.reached and not outcome.complaints:
        return f"{outcome.fault.line}: ended before its fault: {outcome.last_line}"
    judgement = "; ".join(outcome.complaints) or "as required"
    return (
        f"{outcome.fault.line}: status {outcome.status} after {outcome.ended_s:.1f} s, {judgement}: "
        f"{outcome.last_line}"
    )
