"""Command line of the study of attacks: see `studies.common.command_line`."""

from pathlib import Path
from typing import Annotated

import typer

from studies.attacks import (
    bytes_section,
    datagrams_section,
    files_section,
    mavlink_section,
    radio_section,
    slots_section,
)
from studies.attacks.plan import QUICK_ATTACKS, AttacksPlan
from studies.common.command_line import JsonOption, Page, RecordsOption, Validation
from studies.common.runner import Subject

SUBJECTS: dict[str, Subject[AttacksPlan]] = {
    "bytes": Subject(bytes_section.jobs, bytes_section.judge),
    "mavlink": Subject(mavlink_section.jobs, mavlink_section.judge),
    "radio": Subject(radio_section.jobs, radio_section.judge),
    "slots": Subject(slots_section.jobs, slots_section.judge),
    "datagrams": Subject(datagrams_section.jobs, datagrams_section.judge),
    "files": Subject(files_section.jobs, files_section.judge),
}
INTRODUCTION = """Programs attack flying runs from outside, as another user of the machine and as the user of
the run ([what a run trusts](../concepts/trust.md)). Each flight is flown a second time without the attack, up
to the same simulated time: the logs are equal, byte for byte, or the manifest names the cause. Memory is
the growth of a process's private memory, compared with that in the second flight. All numbers are produced by

    coflight study attacks

as root, since only root can start programs as another user; with `--out docs/results` it writes this page,
and with `--records FILE` it can be broken off and continued.
"""
VALIDATION = Validation(
    program="coflight study attacks",
    page=Page(file_name="attacks.md", title="Attacks from outside", introduction=INTRODUCTION),
    subjects=SUBJECTS,
    stages=tuple((name,) for name in SUBJECTS),  # beside each other they would measure each other
    has_bullet=True,
)

attacks_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@attacks_app.command()
def attacks(
    quick: Annotated[bool, typer.Option("--quick", help="Some minutes: small attacks.")] = False,  # noqa: FBT002
    only: Annotated[
        str, typer.Option(help=f"Some of {', '.join(SUBJECTS)}.", metavar="NAME,NAME")
    ] = ",".join(SUBJECTS),
    records: RecordsOption = None,
    json: JsonOption = False,  # noqa: FBT002
    out: Annotated[
        Path | None, typer.Option(help="Folder for attacks.md; without it no file is written.")
    ] = None,
) -> None:
    """Attack flying runs from outside, and compare them with flights without an attack."""
    VALIDATION.run(QUICK_ATTACKS if quick else AttacksPlan(), only, out=out, json=json, records=records)
