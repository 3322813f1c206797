"""Runs an external program as a child of a run: ``python -m harness.launch.external_process --config FILE``.

Implements the child protocol of `foundation.processes.child_protocol` for it: sends Ready with the program's
process id, and ends it on Stop or at the end of stdin. The program's output goes to stderr, which is the
child's log. When this wrapper ends for any reason, so does the program.
"""

import argparse
import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from foundation.processes.child_protocol import Finished, Ready, Stop, commands, emit
from foundation.processes.parent_death import end_with_parent_process
from foundation.processes.scheduling import yield_when_woken

TERM_GRACE_S = 2.0
"""Wall time that the program has between SIGTERM and SIGKILL."""
_SHELL_SIGNAL_BASE = 128


class AutopilotError(ValueError):
    """An external autopilot cannot be started as configured; the text is one line for the user."""


class ExternalProcessConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A program: its command, and the details of its `Ready`."""

    name: str
    command: tuple[str, ...]
    environment: dict[str, str]
    """Added to the inherited environment."""
    folder: str
    """Working folder."""
    details: dict[str, Any] = {}
    yields: bool = True
    """Whether it and its threads preempt no other process when they are woken, as coflight's own vehicles."""


def run(config: ExternalProcessConfig) -> int:
    """Run the program until it ends or is stopped; returns the exit status. Raises OSError."""
    wrapper = os.getpid()

    def prepare() -> None:
        if config.yields:
            yield_when_woken()
        end_with_parent_process(wrapper)

    program = subprocess.Popen(
        config.command,
        stdin=subprocess.DEVNULL,
        stdout=sys.stderr,
        cwd=config.folder,
        env=os.environ | config.environment,
        process_group=0,
        preexec_fn=prepare if sys.platform == "linux" else None,  # noqa: PLW1509  no thread runs yet
    )
    inbox: queue.SimpleQueue[Stop | int] = queue.SimpleQueue()
    commands(Stop, inbox)
    threading.Thread(target=lambda: inbox.put(program.wait()), name="program", daemon=True).start()
    emit(Ready(name=config.name, pid=program.pid, details=config.details))
    ended = inbox.get()
    if isinstance(ended, int):
        return ended if ended >= 0 else _SHELL_SIGNAL_BASE - ended
    _end(program)
    emit(Finished(name=config.name, details={}))
    return 0


def _end(program: "subprocess.Popen[bytes]") -> None:
    """End the program and its process group."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            program.wait(TERM_GRACE_S)


def main() -> int:
    """Parse the command line and run the program; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m harness.launch.external_process", description="An external program in a run."
    )
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the program's command")
    parser.add_argument("--supervised", action="store_true", help="accepted for uniformity, no effect")
    arguments = parser.parse_args()
    try:
        config = msgspec.json.decode(arguments.config.read_bytes(), type=ExternalProcessConfig)
        return run(config)
    except (OSError, msgspec.DecodeError) as error:
        sys.stderr.write(f"external process: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
