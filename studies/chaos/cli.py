"""Command line of the chaos study. Exit status: 0 all as required, 1 not all, 130 interrupted."""

import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console

from foundation.exit_status import FAILED, FINE, INTERRUPTED
from harness.launch import kernel_cache
from harness.launch.interrupts import interruptible
from studies.chaos.faults import plan
from studies.chaos.flight import Outcome, fly_in_temporary_folder
from studies.chaos.page import page, write
from studies.common.command_line import JsonOption

chaos_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@chaos_app.command()
def main(
    flights: Annotated[int, typer.Option(help="Number of flights, of about 15 s each.", min=1)] = 20,
    seed: Annotated[int, typer.Option(help="Seed of the faults.", min=0)] = 1,
    only: Annotated[str, typer.Option(help="Fly only faults whose title has this text.")] = "",
    out: Annotated[Path | None, typer.Option(help="Folder for the page chaos.md.", metavar="DIR")] = None,
    json: JsonOption = False,  # noqa: FBT002
) -> None:
    """Fly with random faults of the run's processes, and judge how each flight ends."""
    messages = Console(stderr=True, highlight=False, markup=False)
    kernel_cache.prepare(messages.print)
    outcomes: list[Outcome] = []
    try:
        with interruptible():
            for fault in plan(flights, seed):
                if only not in fault.title:
                    continue
                outcome = fly_in_temporary_folder(fault)
                outcomes.append(outcome)
                messages.print(_line(outcome), soft_wrap=True)
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None
    text = page(outcomes, flights=flights, seed=seed)
    if out is not None:
        messages.print(f"written to {write(out, text)}")
    if json:
        sys.stdout.write(msgspec.json.encode({"flights": outcomes}).decode() + "\n")
    elif out is None:
        sys.stdout.write(text)
    raise typer.Exit(FAILED if any(outcome.complaints for outcome in outcomes) else FINE)


def _line(outcome: Outcome) -> str:
    title = f"{outcome.fault.title} after {outcome.fault.delay_s:g} s"
    if not outcome.reached:
        return f"{title}: not reached: {outcome.last_line}"
    judgement = "; ".join(outcome.complaints) or "as required"
    return f"{title}: status {outcome.status} after {outcome.ended_s:.1f} s, {judgement}: {outcome.last_line}"
