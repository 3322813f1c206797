"""``coflight replay RUN``: shows a run that has ended in the viewer Rerun, or writes it as a recording of it.

Exit status: 0 fine, 1 the viewer does not start or ends too early, 2 no such run or no Rerun, 130 interrupted
before the run was sent; all but 0 with one line on stderr.
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from foundation.exit_status import BAD_INPUT, FAILED, FINE, INTERRUPTED
from foundation.kernels.use_cache import use_kernel_cache
from foundation.system_error import in_words
from harness.cli.view_options import NO_DISPLAY, check_record
from harness.launch.interrupts import interruptible
from harness.records.run_folder import NotARun, RunFolder, read_scenario
from harness.view.viewer import Viewer, ViewerError, check_installed, has_display

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class _NotShown(Exception):
    """The viewer does not start, or has ended; the text is one line."""


@app.command()
def replay(
    run: Annotated[Path, typer.Argument(help="Folder of a run that has ended.", metavar="RUN")],
    *,
    web: Annotated[
        bool, typer.Option("--web", help="Show it in a browser, also on a machine with a display.")
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option(
            help="Write a recording that the program rerun opens, and show nothing.", metavar="FILE.rrd"
        ),
    ] = None,
) -> None:
    """Show a run in the viewer Rerun until its window is closed; in a browser until Ctrl-C."""
    if web and record is not None:
        raise typer.BadParameter("--record shows nothing; leave --web out")
    check_installed()
    check_record(record)
    folder = RunFolder(run)
    read_scenario(folder)  # before the viewer is started
    use_kernel_cache()
    from harness.view import feed  # noqa: PLC0415  imports Rerun
    from harness.view.rerun_sink import RerunSink  # noqa: PLC0415  the same

    name = run.resolve().name
    if record is not None:
        try:
            sink = RerunSink(name, file=record)
            feed.replay(folder, sink)
            sink.close()
        except BaseException:
            record.unlink(missing_ok=True)  # half a recording; the same command starts again
            raise
        _say(f"recorded into {record}: rerun {record} opens it")
        return
    in_browser = web or not has_display()
    if in_browser and not web:
        _say(NO_DISPLAY)
    with tempfile.TemporaryDirectory(prefix="coflight-view-") as settings:
        try:
            viewer = Viewer(Path(settings), in_browser=in_browser)
        except ViewerError as error:
            raise _NotShown(str(error)) from None
        with viewer:
            if in_browser:
                _say(f"open {viewer.address}")
            sink = RerunSink(name, url=viewer.url)
            feed.replay(folder, sink)
            if not sink.close():
                raise _NotShown("the viewer ended before the whole run was sent")
            _say("the whole run is sent; " + ("Ctrl-C ends the viewer" if in_browser else "close the window"))
            try:
                viewer.wait()
            except KeyboardInterrupt:
                return  # the usual end


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    try:
        with interruptible():
            status = app(args=list(sys.argv[1:] if arguments is None else arguments), standalone_mode=False)
    except typer.TyperException as error:
        return _refuse(error.format_message(), BAD_INPUT)
    except (NotARun, ViewerError) as error:
        return _refuse(str(error), BAD_INPUT)
    except _NotShown as error:
        return _refuse(str(error), FAILED)
    except (ValueError, msgspec.MsgspecError) as error:
        return _refuse(f"these are not the tables of a run: {error}", BAD_INPUT)
    except OSError as error:
        return _refuse(in_words(error), BAD_INPUT)
    if status == INTERRUPTED:  # typer's status for Ctrl-C
        _say("coflight: broken off: the same command starts again")
    return status if isinstance(status, int) else FINE


def _refuse(line: str, status: int) -> int:
    _say(f"coflight: {line}")
    return status
