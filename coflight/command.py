"""The ``coflight`` command: one word for each thing that coflight does, each loaded when it is called.

Exit status: that of the command called; 0 for help; 2 for an unknown command, with one line on stderr.
"""

import atexit
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

from foundation.exit_status import BAD_INPUT, FAILED, FINE
from foundation.kernels import cache_folder
from foundation.kernels.cache_trust import UntrustedCache
from foundation.standard_streams import open_missing
from harness.launch.interrupts import exiting_at_once, ignore_interrupts
from harness.scenario import packaged

USAGE = "usage: coflight COMMAND [ARGUMENTS]   (coflight COMMAND --help)"


class Command(NamedTuple):
    """What a word of the command line calls."""

    summary: str
    module: str
    function: str
    """A function of the arguments that returns the exit status, or an application of typer."""
    first: tuple[str, ...] = ()
    """Arguments that come before the user's."""


COMMANDS = {
    "fly": Command("fly a scenario and report what came out", "harness.cli.fly", "main"),
    "hold": Command("start a swarm that waits for ground stations", "harness.cli.fly", "main", ("--hold",)),
    "report": Command("show a run, make missing tables, draw figures again", "harness.cli.report", "main"),
    "replay": Command("show a run in the viewer Rerun", "harness.cli.replay", "main"),
    "shell": Command("open a shell on a vehicle of a running swarm", "harness.cli.shell", "main"),
    "campaign": Command("fly many runs into one table", "harness.cli.campaign", "main"),
    "radio": Command("simulate the radio alone", "netsim.lab.cli", "main"),
    "antenna": Command("compute antenna patterns alone", "antenna.lab.cli", "main"),
    "bench": Command("measure what flying costs", "studies.bench.cli", "bench_app"),
    "study": Command("measure vehicle, radio, antenna or formation against references", __name__, "study"),
    "export": Command(
        "write the antenna of a run as a NEC deck, or its flight", "harness.cli.export", "main"
    ),
    "scenarios": Command("list the scenarios that come with coflight", __name__, "list_scenarios"),
}
STUDIES = {
    "vehicle": Command("one vehicle against PX4 and requirements", "studies.vehicle.cli", "validate_app"),
    "radio": Command("the radio against ns-3 and Bianchi's model", "studies.radio.cli", "validate_radio_app"),
    "antenna": Command("the solvers against NEC2", "studies.antenna.cli", "validate_antenna_app"),
    "codesign": Command("what ranging does for the formation", "studies.codesign.cli", "codesign_app"),
    "article": Command("the article's cases and statements", "studies.article.cli", "article_app"),
    "soak": Command("what grows in long flights and many swarms", "studies.soak.cli", "soak_app"),
    "chaos": Command("how flights end whose processes fail", "studies.chaos.cli", "chaos_app"),
    "attacks": Command("flights that are attacked from outside", "studies.attacks.cli", "attacks_app"),
    "programs": Command("iperf3, ping, babeld against the channel", "studies.programs.cli", "programs_app"),
    "vehicle-cost": Command("what a step of one vehicle costs", "studies.vehicle.bench_cli", "bench_app"),
    "radio-cost": Command("what the radio costs", "studies.radio.bench_cli", "bench_radio_app"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    open_missing()
    if arguments is None:
        # the last of the calls at the end, which takes tenths of a second: a signal has no effect then
        atexit.register(ignore_interrupts)
        arguments = sys.argv[1:]
    return _dispatch("coflight", COMMANDS, USAGE, arguments)


def study(arguments: Sequence[str]) -> int:
    """Run one study; returns the exit status."""
    usage = "usage: coflight study STUDY [ARGUMENTS]   (coflight study STUDY --help)"
    return _dispatch("coflight study", STUDIES, usage, arguments)


def list_scenarios(arguments: Sequence[str]) -> int:
    """Print the names of the packaged scenarios and campaigns, one a line; returns the exit status."""
    if unknown := [each for each in arguments if each != "--help"]:
        print(f"coflight scenarios: {unknown[0]}: it takes no arguments", file=sys.stderr)
        return BAD_INPUT
    print(*packaged.names(), sep="\n")
    return FINE


def _dispatch(program: str, commands: dict[str, Command], usage: str, arguments: Sequence[str]) -> int:
    name, *rest = arguments or ("--help",)
    if name in {"--help", "-h", "help"}:
        width = max(map(len, commands))
        print(usage, "", *(f"  {word:{width}}  {each.summary}" for word, each in commands.items()), sep="\n")
        return FINE
    if name == "--version":
        print(f"coflight {_version()}")
        return FINE
    if name not in commands:
        words = ", ".join(commands)
        print(f"{program}: there is no command {name!r}; expected one of {words}", file=sys.stderr)
        return BAD_INPUT
    command = commands[name]
    sys.argv = [f"{program} {name}", *rest]  # usage lines name the command
    with exiting_at_once(f"{program} {name}: broken off before the start"):
        try:
            os.environ.update(
                cache_folder.environment()
            )  # read when numba is imported, which the module may do
        except UntrustedCache as error:
            print(f"{program} {name}: {error}", file=sys.stderr)
            return FAILED
        called: Callable[..., Any] = getattr(import_module(command.module), command.function)
    status = called([*command.first, *rest])
    return status if isinstance(status, int) else FINE


def _version() -> str:
    try:
        return version("coflight")
    except PackageNotFoundError:
        return "of a checkout that is not installed"
