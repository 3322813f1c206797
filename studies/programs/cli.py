"""Command line of the programs study: see `studies.common.command_line`."""

import shutil
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from foundation.exit_status import BAD_INPUT
from netsim.network.namespaces import why_not
from studies.common.command_line import JsonOption, Page, RecordsOption, Validation
from studies.common.runner import Subject
from studies.programs import iperf_section, ping_section, routes_section, tcp_section
from studies.programs.plan import QUICK_PROGRAMS, ProgramsPlan

SUBJECTS: dict[str, Subject[ProgramsPlan]] = {
    "iperf": Subject(iperf_section.jobs, iperf_section.judge),
    "ping": Subject(ping_section.jobs, ping_section.judge),
    "tcp": Subject(tcp_section.jobs, tcp_section.judge),
    "routes": Subject(routes_section.jobs, routes_section.judge),
}
NEEDED = {"iperf": "iperf3", "ping": "ping", "tcp": "iperf3", "routes": "babeld"}
"""Programs that are installed by the system's packages"""
PROGRAM = "coflight study programs"
INTRODUCTION = """[Unmodified programs on vehicles](../how-to/programs.md), whose packets cross the emulated
channel, against the frame log of the same flights and against the channel alone. All numbers are produced by

    coflight study programs

with iperf3, ping and babeld of the system's packages, in half an hour; with `--out docs/results` it writes
this page, and with `--records FILE` it can be broken off and continued. Programs live in wall time. How much
later than its simulated time a packet was, because of the machine, is stated with each flight.
"""
VALIDATION = Validation(
    program=PROGRAM,
    page=Page(
        file_name="programs.md",
        title="Unmodified programs",
        introduction=INTRODUCTION,
        csv_name="programs.csv",
    ),
    subjects=SUBJECTS,
    stages=tuple((name,) for name in SUBJECTS),
    workers=1,  # flights beside each other would make each other's packets late
    has_bullet=True,
)

programs_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@programs_app.command()
def programs(
    quick: Annotated[bool, typer.Option("--quick", help="One short flight of each kind.")] = False,  # noqa: FBT002
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(SUBJECTS)}.", metavar="NAME,NAME")
    ] = ",".join(SUBJECTS),
    records: RecordsOption = None,
    json: JsonOption = False,  # noqa: FBT002
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for programs.md and programs.csv; without it none is written."),
    ] = None,
) -> None:
    """Measure iperf3, ping, TCP with losses and babeld on vehicles against the channel."""
    reason = why_not()
    for name in only.split(","):
        needed = NEEDED.get(name.strip())
        if reason is None and needed is not None and shutil.which(needed) is None:
            reason = f"{needed} is not installed"
    if reason is not None:
        Console(stderr=True, highlight=False, markup=False).print(f"{PROGRAM}: {reason}", soft_wrap=True)
        raise typer.Exit(BAD_INPUT)
    VALIDATION.run(QUICK_PROGRAMS if quick else ProgramsPlan(), only, out=out, json=json, records=records)
