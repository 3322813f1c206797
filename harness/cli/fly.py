"""The command line: fly a scenario, show it, and report it.

Exit status: 0 success, 1 the run failed, 2 bad input, 130 interrupted by Ctrl-C. An error is one report on
stderr.
"""

import contextlib
import itertools
import sys
import traceback
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import typer
from rich.console import Console

from foundation.exit_status import BAD_INPUT, FAILED, FINE, INTERRUPTED
from foundation.standard_streams import lasting_output
from foundation.system_error import described, in_words
from harness.cli.keyboard import Keyboard
from harness.cli.out_option import out_folder
from harness.cli.progress import FlightDisplay, Stage, display_for, summary_table
from harness.cli.view_options import FlightView
from harness.launch.interrupts import interruptible
from harness.launch.profiling import profile_table
from harness.launch.run_messages import SetupError, SwarmError
from harness.launch.swarm import Swarm
from harness.records.freed_memory import map_large_blocks
from harness.records.run_folder import RunFolder
from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.scenario_file import load
from harness.view.viewer import ViewerError
from harness.world.faults import MOST_TIME_S

SLOWEST, FASTEST = 1.0 / 64.0, 64.0
"""Speeds that keys lead to: at the first a step takes 0.25 s; few machines keep the other."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class ExitFailure(Exception):
    """The run ends with this status and line."""

    def __init__(self, status: int, line: str) -> None:
        super().__init__(line)
        self.status = status


def _speed(text: str) -> float | Literal["max"]:
    if text == "max":
        return "max"
    try:
        factor = float(text)
    except ValueError:
        factor = 0.0
    if not 0.0 < factor < float("inf"):
        raise typer.BadParameter(f"{text!r}: expected a factor above 0, or 'max'", param_hint="--speed")
    return factor


def _port_offset(text: str) -> int | Literal["auto"]:
    if text == "auto":
        return "auto"
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(
            f"{text!r}: expected a number, or 'auto'", param_hint="--port-offset"
        ) from None


@app.command()
def fly(
    scenario: Annotated[
        Path, typer.Argument(help="TOML file, or the name of a packaged scenario.", metavar="SCENARIO")
    ],
    *,
    speed: Annotated[
        str | None,
        typer.Option(
            help="Simulated against wall time; 'max', the default without programs, is as fast as it goes.",
            metavar="max|FACTOR",
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Simulated seconds in formation.")] = None,
    hold: Annotated[
        bool,
        typer.Option(
            "--hold",
            help="Do not form: all vehicles wait on the ground for a ground station, until Ctrl-C or for"
            " --duration, at speed 1 unless --speed is given.",
        ),
    ] = False,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    agents: Annotated[
        int | None, typer.Option(help="Number of UAVs: the first places of the formation.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="New or empty folder for what comes out; default runs/NAME-DATE-TIME.",
            parser=out_folder,
            metavar="FOLDER",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="Override a field of the scenario.", metavar="PATH=VALUE"),
    ] = None,
    port_offset: Annotated[
        str | None,
        typer.Option(
            help="Added to every port, for a second swarm on one machine: 1000, 2000 ...; 'auto', the default"
            " without --hold, is 0, or the first thousand with which all ports are free.",
            metavar="auto|N",
        ),
    ] = None,
    one_process: Annotated[
        bool,
        typer.Option(
            "--one-process",
            help="Fly in this process, on one processor: the same results byte for byte, but without"
            " connections from outside: no ground station, companion or guest of the radio.",
        ),
    ] = False,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Show the flight in the viewer Rerun (pip install coflight[view]); without a display in a"
            " browser, at the address that is printed.",
        ),
    ] = False,
    web: Annotated[
        bool, typer.Option("--web", help="The same in a browser, also on a machine with a display.")
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option(help="Record what the viewer shows; the program rerun opens it.", metavar="FILE.rrd"),
    ] = None,
    profile: Annotated[
        bool, typer.Option("--profile", help="Report processor time by process and part.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="The summary alone on stdout.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Fly a swarm, with its radio, and report what came out."""
    messages = Console(stderr=True, highlight=False, markup=False)
    named = {
        "run.duration_s": duration,
        "run.seed": seed,
        "agents": agents,
        "onboard.hold": "true" if hold else None,
    }
    overrides = [f"{path}={value}" for path, value in named.items() if value is not None]
    display: FlightDisplay | None = None
    swarm: Swarm | None = None
    shown: FlightView | None = None
    try:
        plan = load(scenario, [*(settings or []), *overrides])
        out = out or _free_folder(plan.name)
        waits = plan.onboard.hold
        if one_process:
            _check_one_process(plan, profile=profile, port_offset=port_offset)
        factor = _speed(speed or ("1" if waits or plan.has_network else "max"))
        display = display_for(messages, forms=plan.forms)
        if view or web or record is not None:
            shown = FlightView(out, window=view, web=web, record=record, note=display.note)
        live = shown is not None
        if one_process:
            from harness.launch.one_process import OneProcessSwarm  # noqa: PLC0415  loads the physics, which prints a line

            swarm = OneProcessSwarm(
                plan, speed=factor, out=out, on_message=display.on_message, live_records=live
            )
        else:
            swarm = Swarm(
                plan,
                speed=factor,
                out=out,
                ports="scenario",
                port_offset=_port_offset(port_offset or ("0" if waits else "auto")),
                on_message=display.on_message,
                profile_from_s=0.0 if profile else None,
                live_records=live,
            )
        endless = waits and duration is None
        broken_off = _fly(swarm, display, until_interrupted=endless, shown=shown)
        display.close()
        _report(swarm, broken_off, messages, as_json=json, endless=endless)
        if shown is not None:
            shown.keep_open()
    except BaseException as error:  # noqa: BLE001  every end has its status
        if display is not None:
            display.close()
        if debug:
            traceback.print_exc()
        if isinstance(error, KeyboardInterrupt) and swarm is not None and swarm.has_records:
            swarm.stop()
            error = ExitFailure(INTERRUPTED, f"broken off: {_left(swarm.path)}")
        raise _failure(error) from None
    finally:
        if shown is not None:
            shown.close()


def _free_folder(name: str) -> Path:
    """Return the default folder of a run, with a number if another run began in the same second."""
    path = Path("runs") / f"{name}-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
    others = (path.with_name(f"{path.name}-{number}") for number in itertools.count(2))
    return next(each for each in itertools.chain([path], others) if not each.exists())


def _check_one_process(plan: Scenario, *, profile: bool, port_offset: str | None) -> None:
    if plan.has_network:
        line = "--one-process has no network: [[programs]] and [network] need several processes"
        raise ExitFailure(BAD_INPUT, line)
    if plan.onboard.hold:
        raise ExitFailure(BAD_INPUT, "--hold waits for a ground station, and none can connect to one process")
    if profile:
        line = "--profile needs several processes; it cannot be combined with --one-process"
        raise ExitFailure(BAD_INPUT, line)
    if port_offset is not None:
        raise ExitFailure(BAD_INPUT, "--port-offset has no effect with --one-process, which opens no port")


def _on_key(key: str, swarm: Swarm, display: FlightDisplay) -> None:
    """Pause, resume or change the speed, according to the key."""
    with contextlib.suppress(SwarmError):  # it may have just ended
        if key == " ":
            (swarm.resume if swarm.stands else swarm.pause)()
            display.note(f"paused at t = {swarm.simulated_s:.2f} s" if swarm.stands else "going on")
        elif key in "+-" and swarm.speed != "max":
            speed = swarm.speed
            # not past what keys are for, but from beyond it only towards it
            faster, slower = max(speed, min(2.0 * speed, FASTEST)), min(speed, max(0.5 * speed, SLOWEST))
            swarm.set_speed(faster if key == "+" else slower)
            display.note(f"speed {swarm.speed:g}")


def _keys(swarm: Swarm, *, until_interrupted: bool) -> str:
    """Return a line with the keys that have an effect."""
    keys = ["space pauses and goes on"]
    if swarm.speed != "max":
        keys.append("+ and - change the speed")
    if until_interrupted:
        keys.append("Ctrl-C ends the hold and writes the results")
    return "; ".join(keys)


def _fly(
    swarm: Swarm, display: FlightDisplay, *, until_interrupted: bool, shown: FlightView | None = None
) -> SwarmError | KeyboardInterrupt | None:
    """Start, form, hold and stop. Returns what broke it off, if there are records all the same."""
    run = swarm.scenario.run
    display.note(f"{swarm.scenario.name}: {swarm.scenario.agents} UAVs, seed {run.seed}, into {swarm.path}")
    try:
        swarm.start()
    except KeyboardInterrupt:
        line = "broken off during the start: no process is left, and nothing was written"
        raise ExitFailure(INTERRUPTED, line) from None
    try:
        processes = "one process is" if len(swarm.pids) == 1 else f"{len(swarm.pids)} processes are"
        display.note(f"{processes} ready")
        if shown is not None:
            shown.begin()
        holds, forms = swarm.scenario.onboard.hold, swarm.scenario.forms
        for line in swarm.addresses if holds else ():
            display.note(line)
        with Keyboard(
            lambda key: _on_key(key, swarm, display)
        ) as keyboard:  # from here on keys have an effect
            if keyboard.listening:
                display.note(_keys(swarm, until_interrupted=until_interrupted))
            if forms:
                display.begin(Stage(f"forming (then {run.duration_s:g} s)", forming=True))
                swarm.run_until_formed(timeout_s=run.reach_timeout_s)
            if until_interrupted:
                display.begin(Stage("holding until Ctrl-C"))
                swarm.run_for(MOST_TIME_S)
            else:
                name = "holding" if holds else "in formation" if forms else "flying"
                display.begin(Stage(name, end_s=swarm.truth.t_s + run.duration_s))
                swarm.run_for(run.duration_s)
    except (SwarmError, KeyboardInterrupt) as error:
        return error
    finally:
        _stop(swarm, display)
        if shown is not None:
            shown.end_feed()
    return None


def _stop(swarm: Swarm, display: FlightDisplay) -> None:
    """Stop the processes. Raises ExitFailure after a Ctrl-C meanwhile, which takes effect at the end."""
    try:
        swarm.stop()
    except KeyboardInterrupt:
        swarm.stop()
        raise ExitFailure(INTERRUPTED, f"broken off: {_left(swarm.path)}") from None
    for line in swarm.forced:
        display.note(line)


def _report(
    swarm: Swarm,
    broken_off: SwarmError | KeyboardInterrupt | None,
    messages: Console,
    *,
    as_json: bool,
    endless: bool,
) -> None:
    """Turn the records into results and show them; raises ``broken_off`` in the end.

    Ctrl-C is how an ``endless`` hold ends. Raises ExitFailure without results.
    """
    interrupted = isinstance(broken_off, KeyboardInterrupt)
    messages.print("writing down what was flown" if interrupted else "computing patterns and figures")
    map_large_blocks()
    try:
        summary = swarm.summary(
            draw=not interrupted, interrupted=interrupted and not endless, held=interrupted and endless
        )
    except KeyboardInterrupt:
        raise ExitFailure(INTERRUPTED, f"broken off: {_left(swarm.path)}") from None
    except Exception as error:  # the cause of the end has precedence
        line = f"the results cannot be written: {described(error)}; {_left(swarm.path)}, once they can be"
        if broken_off is None:
            raise ExitFailure(FAILED, line) from error
        messages.print(line, soft_wrap=True)
    else:
        if as_json:
            sys.stdout.write(msgspec.json.format(msgspec.json.encode(summary), indent=2).decode() + "\n")
        else:
            Console(highlight=False, markup=False).print(summary_table(summary))
            if swarm.profile:
                step_us = swarm.scenario.run.step_us
                Console(highlight=False, markup=False).print(profile_table(swarm.profile, step_us=step_us))
        messages.print(f"written to {swarm.path}: {', '.join(_written(swarm.path))}", soft_wrap=True)
    if isinstance(broken_off, SwarmError):
        raise broken_off
    if swarm.records_lost is not None:
        raise SwarmError(swarm.records_lost)
    if broken_off is not None and not endless:
        line = f"broken off: every process is stopped, the records are kept in {swarm.path}"
        raise ExitFailure(INTERRUPTED, line)


def _left(path: Path) -> str:
    """Return what a run has whose results are not complete, and the command that completes them."""
    folder = RunFolder(path)
    if folder.is_reported():
        made_by = f"coflight report {path} --figures makes them"
        return f"the tables are written, figures or report.html are not: {made_by}"
    megabytes = sum(raw.stat().st_size for raw in folder.raw.glob("*.bin")) / 1e6
    return (
        f"no table is written; {megabytes:.1f} MB of raw logs are kept in {folder.raw}: "
        f"coflight report {path} makes the tables of them"
    )


def _failure(error: BaseException) -> ExitFailure:
    """Return the exit status and the line of an error."""
    match error:
        case ExitFailure():
            return error
        case ScenarioError() | SetupError() | ViewerError():
            return ExitFailure(BAD_INPUT, str(error))
        case typer.TyperException():
            return ExitFailure(BAD_INPUT, error.format_message())
        case SwarmError():
            return ExitFailure(FAILED, str(error))
        case KeyboardInterrupt() | typer.Abort():
            return ExitFailure(INTERRUPTED, "broken off before the start")
        case _:
            return ExitFailure(FAILED, described(error))


def _written(folder: Path) -> list[str]:
    """Return the names of a run's files with content, figures last."""
    paths = [*sorted(folder.glob("*")), *sorted(folder.glob("figures/*"))]
    return [path.relative_to(folder).as_posix() for path in paths if path.is_file() and path.stat().st_size]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    status = FINE
    try:
        with lasting_output():
            status = _run(sys.argv[1:] if arguments is None else arguments)
    except OSError as error:
        with contextlib.suppress(OSError):  # standard error may be the one
            print(f"coflight: output is lost: {in_words(error)}", file=sys.stderr)
        return status or FAILED
    return status


def _run(arguments: Sequence[str]) -> int:
    with interruptible() as interrupt:
        try:
            status = app(args=list(arguments), standalone_mode=False)
        except BaseException as error:  # noqa: BLE001  every end has its status and its line
            interrupt.finish()
            failure = _failure(error)
            print(f"coflight: {failure}", file=sys.stderr)
            return failure.status
        interrupt.finish()
    return status if isinstance(status, int) else FINE
