"""The command line of campaigns.

Exit status: 0 all runs completed, 1 some runs or the cluster failed, 2 bad input, 130 interrupted: the same
command continues the campaign. An error is one report on stderr.
"""

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import pyarrow as pa
import typer
from rich.console import Console
from rich.table import Table as Shown

from foundation import exit_status
from foundation.system_error import described
from harness.campaign.cluster import check_address
from harness.campaign.definition import KEPT, Campaign, Run, expand, load
from harness.campaign.display import CampaignDisplay
from harness.campaign.running import known, run
from harness.campaign.store import (
    FAILED,
    PAGE,
    PLAIN_FLIGHT,
    TABLES,
    CampaignError,
    ClusterError,
    Flown,
    Store,
)
from harness.campaign.values import toml_text
from harness.campaign.worker import sources_state
from harness.cli.out_option import out_folder
from harness.launch import kernel_cache
from harness.launch.interrupts import interruptible

WIDTH = 120
"""Columns without a terminal."""

campaign_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class BrokenOff(Exception):
    """Ctrl-C, which typer would convert to an exit status without a message."""


@campaign_app.command()
def campaign(
    file: Annotated[Path, typer.Argument(help="TOML file of the campaign.", metavar="CAMPAIGN")],
    *,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for runs and table; default runs/NAME.", parser=out_folder, metavar="FOLDER"
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes that fly; default one per processor.", min=1, max=1024)
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Fly on the workers of this dask scheduler, with the certificates of dask's settings.",
            metavar="tls://HOST:PORT",
        ),
    ] = None,
    unencrypted: Annotated[
        bool,
        typer.Option(
            "--unencrypted",
            help="Permit a scheduler tcp://HOST:PORT, on a network that only its users reach.",
        ),
    ] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="Override a field of the scenario in all runs.", metavar="PATH=VALUE"),
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option(help=f"Keep a series of every run: {', '.join(KEPT)}.", metavar="SERIES"),
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Fly failed runs again.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the runs without flying them.")] = False,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> int:
    """Fly every combination of a campaign file, and write one table of the results with its figures."""
    try:
        plan = load(file, settings or (), keep or ())
        out = out or Path("runs") / plan.name
        if scheduler is not None and workers is not None:
            raise CampaignError("--scheduler: it has its own workers, so --workers cannot be given")
        check_address(scheduler, unencrypted=unencrypted)
        if dry_run:
            _print_plan(plan, out, retry=retry, json=json)
            return exit_status.FINE
        messages = Console(stderr=True, highlight=False, markup=False)
        runs, _, missing = _planned(plan, out, retry=retry)
        total = len({each.digest for each in runs})
        messages.print(f"{total} flights, {len(missing)} of them to be flown; into {out}", soft_wrap=True)
        with CampaignDisplay(messages, plan, total=total, kept=total - len(missing)) as display:
            table = run(
                plan,
                out=out,
                runs=runs,
                workers=workers,
                scheduler=scheduler,
                unencrypted=unencrypted,
                retry=retry,
                progress=display.on_landed,
                note=display.note,
            )
        from harness.campaign.figures import draw_table  # noqa: PLC0415  slow to import, needed at the end
        from harness.campaign.page import write_page  # noqa: PLC0415  as above

        drawn = draw_table(table.parquet)
        write_page(table.parquet)
    except KeyboardInterrupt:
        raise BrokenOff from None
    fine = print_table(table.rows, out, drawn, flown_now=len(missing), json=json)
    return exit_status.FINE if fine and not display.failed else exit_status.FAILED


def _planned(
    plan: Campaign, out: Path, *, retry: bool, note: Callable[[str], None] = lambda _line: None
) -> tuple[list[Run], dict[str, Flown], list[Run]]:
    """Return all runs, the stored flights, and the missing runs; creates no folder. ``note``: see `known`."""
    runs = expand(plan, state=sources_state(PLAIN_FLIGHT.measured_by))
    if not out.exists() or not any(out.iterdir()):
        return runs, {}, list({each.digest: each for each in runs}.values())
    return runs, *known(plan, runs, Store(out), retry=retry, note=note)


def print_table(rows: pa.Table, folder: Path, figures: Sequence[str], *, flown_now: int, json: bool) -> bool:
    """Print the numbers of runs by status, and the files; returns whether no run has failed."""
    counts = Counter(rows.column("status").to_pylist())
    tables = [str(folder / name) for name in TABLES]
    drawn = [str(folder / name) for name in figures]
    if json:
        result = {
            "runs": len(rows),
            "flown": flown_now,
            **{status: counts.get(status, 0) for status in ("completed", "not_formed", FAILED)},
            **dict(zip(("parquet", "csv"), tables, strict=True)),
            "figures": drawn,
        }
        _print_json(result)
    else:
        ends = ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in sorted(counts.items()))
        page = [str(path)] if (path := folder / PAGE).exists() else []
        sys.stdout.write("\n".join([f"{len(rows)} runs: {ends}", *tables, *drawn, *page]) + "\n")
    return not counts.get(FAILED)


def _print_plan(plan: Campaign, out: Path, *, retry: bool, json: bool) -> None:
    messages = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
    runs, flown, missing = _planned(plan, out, retry=retry, note=messages.print)
    if json:
        listed = [
            {
                "case": each.case, **dict(zip(plan.sweep, each.swept, strict=True)), "seed": each.seed,
                "digest": each.digest, "status": _status(each, flown),
            }
            for each in runs
        ]  # fmt: skip
        _print_json({"runs": listed, "to_be_flown": len(missing)})
        return
    shown = Shown("case", *plan.sweep, "seed", "status")
    for each in runs:
        shown.add_row(each.case, *map(toml_text, each.swept), str(each.seed), _status(each, flown))
    console = Console(highlight=False, width=None if sys.stdout.isatty() else WIDTH)
    console.print(shown)
    console.print(f"{len(runs)} runs, {len(missing)} to be flown")


def _status(each: Run, flown: dict[str, Flown]) -> str:
    return flown[each.digest].status if each.digest in flown else "to be flown"


def _print_json(content: object) -> None:
    sys.stdout.write(msgspec.json.encode(content).decode() + "\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    try:
        with interruptible():
            status = campaign_app(
                args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=False
            )
    except BaseException as error:  # noqa: BLE001  every error has a status and a line
        status, line = _ending(error)
        if line:
            sys.stderr.write(f"campaign: {line}\n")
    return status if isinstance(status, int) else exit_status.FINE


def _ending(error: BaseException) -> tuple[int, str]:
    match error:
        case ClusterError() | kernel_cache.CompileError():
            return exit_status.FAILED, str(error)
        case CampaignError():
            return exit_status.BAD_INPUT, str(error)
        case typer.TyperException():
            return exit_status.BAD_INPUT, error.format_message()
        case BrokenOff() | KeyboardInterrupt() | typer.Abort():
            return exit_status.INTERRUPTED, "broken off: the same command goes on from here"
        case SystemExit():  # the reader of the output has closed it
            return exit_status.FAILED, ""
        case _:
            return exit_status.FAILED, described(error)
