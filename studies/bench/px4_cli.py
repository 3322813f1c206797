"""Command line of the comparison with PX4s. Exit status: 0 done, 1 failed, 2 bad input, 130 interrupted."""

import sys
from typing import Annotated

import msgspec
import typer
from rich.console import Console

from harness.launch import px4
from harness.launch.interrupts import interruptible
from harness.scenario.scenario_file import load
from studies.bench.bench import SCENARIOS
from studies.bench.command_errors import errors_end_the_command
from studies.bench.px4_bench import Px4Plan, compare, sheet
from studies.bench.tables import terminal_table

px4_bench_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
_WIDTH = 150


@px4_bench_app.command()
def main(
    build: Annotated[
        str, typer.Option(help="Folder of a PX4 SITL build.", envvar="COFLIGHT_PX4_BUILD", metavar="FOLDER")
    ],
    user: Annotated[
        str | None,
        typer.Option(help="User of the PX4s, if this one is root.", envvar="COFLIGHT_PX4_USER"),
    ] = None,
    agents: Annotated[int, typer.Option(help="Number of UAVs.", min=1)] = 8,
    duration: Annotated[float, typer.Option(help="Simulated seconds of each measurement.", min=1.0)] = 20.0,
    repeats: Annotated[int, typer.Option(help="Repetitions of all measurements, in turns.", min=1)] = 3,
    seed: Annotated[int, typer.Option(help="Seed of every flight.", min=0)] = 1,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="Setting of the scenario with PX4s; repeatable.", metavar="KEY=VALUE"),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="All results as JSON on stdout.")] = False,  # noqa: FBT002
) -> None:
    """Compare swarms of own vehicles and of PX4s with PX4s that have a bare lockstep simulator."""
    messages = Console(stderr=True, highlight=False, markup=False)
    plan = Px4Plan(
        build=build, user=user, settings=tuple(settings or ()), agents=agents, duration_s=duration,
        repeats=repeats, seed=seed,
    )  # fmt: skip
    with errors_end_the_command(messages):
        # bad input is reported before the first flight
        px4.check_start(load(SCENARIOS / "article.toml", [f"agents={agents}", *plan.px4_settings()]))
        with interruptible():
            found = compare(plan, lambda line: messages.print(line, soft_wrap=True))
    if json:
        sys.stdout.write(msgspec.json.format(msgspec.json.encode(found), indent=2).decode() + "\n")
        return
    console = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else _WIDTH)
    console.print(sheet(found).title, style="bold")
    console.print(terminal_table(sheet(found)))
