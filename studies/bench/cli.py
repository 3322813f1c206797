"""Command line of the benchmark. Exit status: 0 measured, 1 failure, 2 bad input, 130 interrupted."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from foundation.exit_status import FAILED, INTERRUPTED
from harness.launch.interrupts import interruptible
from harness.scenario.scenario_file import load
from studies.bench.bench import BenchPlan, bench, to_json
from studies.bench.command_errors import end, errors_end_the_command
from studies.bench.tables import markdown, sheets, terminal_table

AGENTS, QUICK_AGENTS = "1,8,16,32,64", "1,8"
DURATION_S, QUICK_DURATION_S = 20.0, 4.0
REPEATS, QUICK_REPEATS = 3, 1
FLOOR_S, QUICK_FLOOR_S = 3.0, 0.5

bench_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@bench_app.command()
def main(
    agents: Annotated[
        str | None, typer.Option(help=f"Numbers of UAVs; default {AGENTS}.", metavar="N,N,...")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help=f"Simulated seconds in formation; default {DURATION_S:g}.", min=0.1)
    ] = None,
    repeats: Annotated[
        int | None, typer.Option(help=f"Repetitions of floor and flight; default {REPEATS}.", min=1)
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(help="Scenario; default article.toml for up to 8 UAVs, swarm64.toml for more."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of every flight.", min=0)] = 1,
    quick: Annotated[  # noqa: FBT002
        bool,
        typer.Option(
            "--quick", help=f"Defaults of {QUICK_AGENTS} UAVs, {QUICK_DURATION_S:g} s, one repetition."
        ),
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="All results as JSON on stdout.")] = False,  # noqa: FBT002
    as_markdown: Annotated[  # noqa: FBT002
        bool, typer.Option("--markdown", help="Tables as Markdown on stdout.")
    ] = False,
) -> None:
    """Measure the cost of flights, alternating with a floor: a minimal lockstep simulation in Python."""
    messages = Console(stderr=True, highlight=False, markup=False)
    with errors_end_the_command(messages):
        plan = BenchPlan(
            agents=_numbers(agents or (QUICK_AGENTS if quick else AGENTS)),
            duration_s=duration or (QUICK_DURATION_S if quick else DURATION_S),
            repeats=repeats or (QUICK_REPEATS if quick else REPEATS),
            floor_wall_s=QUICK_FLOOR_S if quick else FLOOR_S,
            scenario=scenario,
            seed=seed,
        )
        for number in plan.agents:  # bad input is reported before the first flight
            load(plan.scenario_for(number), [f"agents={number}", f"run.seed={seed}"])
        with interruptible():
            found = bench(plan, lambda line: messages.print(line, soft_wrap=True))
    if json:
        sys.stdout.write(to_json(found) + "\n")
    elif as_markdown:
        sys.stdout.write(markdown(found))
    else:
        console = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 110)
        for sheet in sheets(found):
            console.print(sheet.title, style="bold")
            console.print(terminal_table(sheet))
    if found.failure is not None:
        end(messages, INTERRUPTED if found.broken_off else FAILED, found.failure)


def _numbers(text: str) -> tuple[int, ...]:
    """Read ``1,8,16``. Raises ValueError."""
    words = text.split(",")
    if not all(word.strip().isdecimal() and int(word) > 0 for word in words):
        raise ValueError(f"--agents {text}: expected numbers of UAVs: 1,8,16")
    return tuple(int(word) for word in words)
