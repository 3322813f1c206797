"""Command line of the vehicle benchmark. Exit status: 0 a step is within its time limit, 1 it is not."""

from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from foundation.exit_status import FAILED, FINE
from harness.launch import kernel_cache
from studies.common.command_line import JsonOption, keep_stdout
from studies.vehicle.bench import LIMIT_US, StepCost, measure, measure_without_compiler, record_flight

bench_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@bench_app.command()
def bench(
    seconds: Annotated[float, typer.Option(help="Length of the flight.", min=20.0)] = 60.0,
    repeats: Annotated[int, typer.Option(help="Number of passes; the fastest counts.", min=1)] = 3,
    json: JsonOption = False,  # noqa: FBT002
) -> None:
    """Replay a recorded flight to a vehicle and print the time of its steps in microseconds."""
    messages = Console(stderr=True, highlight=False, markup=False)
    kernel_cache.prepare(messages.print)
    stdout = keep_stdout()
    messages.print(f"recording and replaying a flight of {seconds:g} s")
    recording = record_flight(seconds)
    costs = {
        "streams off": measure(recording, streams=False, repeats=repeats),
        "streams on": measure(recording, streams=True, repeats=repeats),
        "off, ULog": measure(recording, streams=False, repeats=repeats, ulog=True),
        "off, no compiler": measure_without_compiler(recording),
    }
    if json:
        print(msgspec.json.encode({"limit_us": LIMIT_US, **costs}).decode(), file=stdout)
    else:
        steps = len(recording.stream) - recording.armed_from
        Console(file=stdout, highlight=False, width=100).print(_table(costs, steps))
    raise typer.Exit(FINE if costs["streams off"].step_us <= LIMIT_US else FAILED)


def _table(costs: dict[str, StepCost], steps: int) -> Table:
    table = Table(title=f"Microseconds per step, mean of {steps} steps since arming", title_justify="left")
    table.add_column("part")
    for name in costs:
        table.add_column(name, justify="right")
    for part in next(iter(costs.values())).parts_us:
        table.add_row(part, *(f"{cost.parts_us.get(part, 0.0):.1f}" for cost in costs.values()))
    table.add_section()
    table.add_row("whole step", *(f"{cost.step_us:.1f}" for cost in costs.values()), style="bold")
    table.add_row("99 % quantile, wall time", *(f"{cost.longest_us:.0f}" for cost in costs.values()))
    table.add_row("decode and encode only", *(f"{cost.floor_us:.1f}" for cost in costs.values()))
    table.add_row("limit", f"{LIMIT_US:g}", "", "")
    return table
