"""``coflight shell UAV``: a shell, or one command, in the network of a vehicle of a running swarm.

Exit status: that of the command, 128 + n for signal n; 2 without such a swarm or vehicle, with one line on
stderr.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from foundation.exit_status import BAD_INPUT, FINE
from foundation.system_error import in_words
from harness.launch.process_commands import python_module
from harness.launch.vehicle_network import read_holders
from harness.records.run_folder import NETWORK_FILE, RunFolder

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
_SHELL = "/bin/sh"


class _NoVehicle(Exception):
    """There is no such swarm or vehicle; the text is one line."""


@app.command()
def shell(
    uav: Annotated[int, typer.Argument(help="Number of the vehicle.", min=0, metavar="UAV")],
    command: Annotated[
        list[str] | None,
        typer.Argument(help="Command and arguments, after --; without it a shell.", metavar="[-- COMMAND]"),
    ] = None,
    *,
    run: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the running swarm; default: the newest in runs/ that has a network.",
            metavar="RUN",
        ),
    ] = None,
) -> None:
    """Open a shell in the network namespace of a vehicle of a running swarm, or run a command there."""
    folder = RunFolder(_newest() if run is None else run)
    try:
        holders = read_holders(folder.network)
    except FileNotFoundError:
        line = "no running swarm with [[programs]] or [network]"
        raise _NoVehicle(f"{folder.path}: {line}") from None
    except msgspec.DecodeError as error:
        raise _NoVehicle(f"{folder.network}: {error}") from None
    if not holders:
        raise _NoVehicle(f"{folder.path}: its swarm has ended")
    if uav not in holders:
        raise _NoVehicle(f"{folder.path}: there is no UAV {uav} among {len(holders)}")
    words = command or [os.environ.get("SHELL") or _SHELL]
    entry = python_module("netsim.network.vehicle_entry", str(holders[uav]), *words)
    os.execv(sys.executable, entry)  # noqa: S606  there is no shell


def _newest() -> Path:
    """Return the folder of the swarm in ``runs/`` that was started last."""
    files = sorted(Path("runs").glob(f"*/{NETWORK_FILE}"), key=lambda path: path.stat().st_mtime)
    found = [path for path in files if read_holders(path)]  # a killed launcher leaves its file
    if not found:
        raise _NoVehicle("runs/: no running swarm with [[programs]] or [network]; name its folder by --run")
    return found[-1].parent


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    try:
        status = app(args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=False)
    except typer.TyperException as error:
        return _refuse(error.format_message())
    except _NoVehicle as error:
        return _refuse(str(error))
    except OSError as error:
        return _refuse(in_words(error))
    return status if isinstance(status, int) else FINE


def _refuse(line: str) -> int:
    sys.stderr.write(f"coflight: {line}\n")
    return BAD_INPUT
