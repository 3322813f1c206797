"""Command line of the radio benchmark. Exit status: 0 limits met, 1 a limit is exceeded, 2 bad input."""

import shlex
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from foundation.exit_status import BAD_INPUT, FAILED, FINE
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load
from studies.codesign.cases import ARTICLE
from studies.common.command_line import JsonOption
from studies.radio import bench
from studies.radio.saturation_section import MODES

bench_radio_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@bench_radio_app.command()
def bench_radio(
    stations: Annotated[int, typer.Option(help="Number of saturated stations.", min=1, max=1000)] = 20,
    rate_mbps: Annotated[int, typer.Option(help=f"Data rate, one of {', '.join(map(str, MODES))}.")] = 6,
    seconds: Annotated[float, typer.Option(help="Simulated time.", min=0.5)] = 10.0,
    peer: Annotated[
        str,
        typer.Option(
            help="Program that simulates the same case; run in turn with ours. The ratio of speeds depends "
            "on what it spends time on, such as traffic that its queues drop.",
            metavar="COMMAND",
        ),
    ] = "",
    peer_seconds: Annotated[
        float | None, typer.Option(help="Simulated time of the peer, if not --seconds.", min=0.5)
    ] = None,
    scenario: Annotated[Path, typer.Option(help="Scenario whose traffic is replayed.")] = ARTICLE,
    repeats: Annotated[int, typer.Option(help="Number of repetitions; the medians count.", min=1)] = 3,
    json: JsonOption = False,  # noqa: FBT002
) -> None:
    """Measure the run time of the emulated radio, and its speed relative to a peer program."""
    messages = Console(stderr=True, highlight=False, markup=False)
    if rate_mbps not in MODES:
        messages.print(f"bench_radio: --rate-mbps {rate_mbps}: expected one of {', '.join(map(str, MODES))}")
        raise typer.Exit(BAD_INPUT)
    try:
        swarm = load(scenario)
        saturated = bench.bench_saturated(
            stations=stations, rate_mbps=rate_mbps, seconds=seconds, peer=shlex.split(peer),
            peer_s=peer_seconds or seconds, repeats=repeats,
        )  # fmt: skip
        article = bench.bench_article(swarm, seconds=2.0 * seconds, repeats=repeats)
    except (ScenarioError, OSError, subprocess.CalledProcessError) as error:
        messages.print(f"bench_radio: {error}")
        raise typer.Exit(BAD_INPUT) from None
    if json:
        sys.stdout.write(msgspec.json.encode({"saturated": saturated, "article": article}).decode() + "\n")
    else:
        console = Console(file=sys.stdout, highlight=False, width=110)
        console.print(_saturated_table(saturated))
        console.print(_article_table(article, swarm.name))
    slow = saturated.faster_wall is not None and saturated.faster_wall < bench.FASTER_LIMIT
    raise typer.Exit(FAILED if slow or article.with_messages.cpu_s > bench.REAL_TIME_LIMIT else FINE)


def _saturated_table(cost: bench.SaturatedCost) -> Table:
    table = Table(
        title=f"{cost.stations} saturated stations at {cost.rate_mbps} Mbit/s, per simulated second",
        title_justify="left",
    )
    for column in ("", "wall, s", "processor, s", "real-time factor", "peer's time over ours"):
        table.add_column(column, justify="left" if not column else "right")
    for name, one in (("process", cost.process), ("without start-up", cost.run)):
        table.add_row(name, *_cells(one), f"{cost.peer.wall_s / one.wall_s:.1f}" if cost.peer else "")
    if cost.peer is not None:
        table.add_row("peer's process", *_cells(cost.peer), "")
    return table


def _article_table(cost: bench.ArticleCost, name: str) -> Table:
    table = Table(
        title=(
            f"{cost.stations} UAVs' traffic ({name}): {cost.frames:.0f} frames a second, "
            f"{100 * cost.steps_run:.0f} % of the steps not idle; per simulated second"
        ),
        title_justify="left",
    )
    for column in ("", "wall, s", "processor, s", "real-time factor"):
        table.add_column(column, justify="left" if not column else "right")
    table.add_row("emulator", *_cells(cost.emulator))
    table.add_row("with messages", *_cells(cost.with_messages))
    table.add_row(f"Python's event queue only ({cost.events:.0f} events)", *_cells(cost.floor))
    table.add_row("limit", "", f"{bench.REAL_TIME_LIMIT:.4f}", "")
    return table


def _cells(cost: bench.RadioCost) -> tuple[str, str, str]:
    return f"{cost.wall_s:.4f}", f"{cost.cpu_s:.4f}", f"{1.0 / cost.wall_s:.1f}"
