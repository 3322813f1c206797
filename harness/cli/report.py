"""``coflight report RUN``: the results of a run or campaign that has ended, and its figures drawn again.

A run without tables, because its launcher was interrupted or killed, gets them.

Exit status: 0 fine, 1 the tables cannot be written, 2 no such run or tables of another version, 130
interrupted by Ctrl-C; all but 0 with one line on stderr.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import pyarrow.parquet as pq
import typer
from rich.console import Console

from foundation.exit_status import BAD_INPUT, FAILED, FINE, INTERRUPTED
from foundation.system_error import in_words
from harness.campaign.store import TABLES, is_campaign
from harness.cli.progress import summary_table
from harness.launch.interrupts import interruptible
from harness.records.freed_memory import map_large_blocks
from harness.records.manifest import altered_tables
from harness.records.run_folder import NotARun, RunFolder, read_scenario

_BROKEN_OFF = "coflight: broken off: the same command starts again\n"


class _NotWritten(Exception):
    """Tables cannot be written; the text is one line."""


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def report(
    run: Annotated[Path, typer.Argument(help="Folder of a run or campaign that has ended.", metavar="RUN")],
    *,
    figures: Annotated[
        bool, typer.Option("--figures", help="Draw the figures and report.html again.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="The summary alone on stdout.")] = False,
) -> None:
    """Show what came out of a run or campaign; make the tables of a run that was interrupted before that."""
    if (run / TABLES[0]).exists():
        _report_campaign(run, figures=figures, json=json)
        return
    if not run.exists():
        raise NotARun(f"{run}: there is no such folder")
    if is_campaign(run):
        raise NotARun(f"{run}: a campaign that is not complete: its coflight campaign command continues it")
    folder, messages = RunFolder(run), Console(stderr=True, highlight=False, markup=False)
    was_reported = folder.is_reported()
    if not was_reported and folder.manifest.exists():
        from harness.report.report import finish_later  # noqa: PLC0415  slow to import, rarely needed

        map_large_blocks()
        try:
            finish_later(folder)
        except OSError as error:
            if folder.is_reported():
                raise _NotWritten(
                    f"the tables are written, figures or report.html are not: {in_words(error)}; "
                    f"coflight report {run} --figures makes them"
                ) from None
            raise _NotWritten(
                f"the tables cannot be written: {in_words(error)}; the raw logs are kept in {folder.raw}"
            ) from None
        messages.print(f"tables and figures made of {folder.raw}", soft_wrap=True)
    scenario = read_scenario(folder)
    summary = _summary(folder)
    if was_reported and (altered := altered_tables(folder)):  # others are made just now
        messages.print(
            f"warning: {folder.path}: {', '.join(altered)}: not as the run wrote it, by manifest.json",
            soft_wrap=True,
        )
    if figures:
        from harness.report.report import draw_again  # noqa: PLC0415  as above

        try:
            formed_us = None if summary["formed_s"] is None else round(summary["formed_s"] * 1e6)
            drawn = draw_again(folder, scenario, formed_us=formed_us)
        except (KeyError, ValueError):
            raise NotARun(f"{folder.path}: its tables are not of the scenario in its manifest") from None
        messages.print(f"drawn into {folder.figures}: {', '.join(drawn)}", soft_wrap=True)
        messages.print(f"written: {folder.page}", soft_wrap=True)
    if json:
        sys.stdout.write(folder.summary.read_text(encoding="utf-8"))
    else:
        try:
            shown = summary_table(summary)
        except (KeyError, TypeError):
            raise NotARun(f"{folder.summary}: no coflight of this version wrote it") from None
        Console(highlight=False, markup=False).print(shown)


def _report_campaign(folder: Path, *, figures: bool, json: bool) -> None:
    from harness.campaign.figures import draw_table  # noqa: PLC0415  slow to import, for campaigns only
    from harness.campaign.page import write_page  # noqa: PLC0415  as above
    from harness.cli.campaign import print_table  # noqa: PLC0415  as above

    path = folder / TABLES[0]
    try:
        drawn = draw_table(path) if figures else []
        if figures:
            write_page(path)
        print_table(pq.read_table(path), folder, drawn, flown_now=0, json=json)
    except (KeyError, ValueError):
        raise NotARun(f"{path}: no campaign of this version wrote it: fly the campaign again") from None


def _summary(folder: RunFolder) -> dict[str, Any]:
    try:
        return msgspec.json.decode(folder.summary.read_bytes(), type=dict[str, Any])
    except FileNotFoundError:
        raise NotARun(f"{folder.path}: it has no summary.json") from None
    except msgspec.DecodeError as error:
        raise NotARun(f"{folder.summary}: not JSON: {error}") from None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    try:
        with interruptible():
            status = app(args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        sys.stderr.write(_BROKEN_OFF)
        return INTERRUPTED
    except typer.TyperException as error:
        return _refuse(error.format_message())
    except NotARun as error:
        return _refuse(str(error))
    except _NotWritten as error:
        _refuse(str(error))
        return FAILED
    except OSError as error:
        return _refuse(in_words(error))
    if status == INTERRUPTED:  # typer's status for Ctrl-C
        sys.stderr.write(_BROKEN_OFF)
    return status if isinstance(status, int) else FINE


def _refuse(line: str) -> int:
    sys.stderr.write(f"coflight: {line}\n")
    return BAD_INPUT
