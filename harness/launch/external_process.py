"""Runs a program of others as a child of a run: ``python -m harness.launch.external_process --config FILE``.

Speaks the child protocol of `foundation.processes.child_protocol` for it: Ready with the program's process
id, an end when told to stop or when stdin ends. What the program prints goes to stderr, which is the child's
log. However the keeper ends, the program ends with it.
"""

import argparse
import contextlib
import ctypes
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

TERM_GRACE_S = 2.0
"""Wall time that the program has between SIGTERM and SIGKILL."""
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_SHELL_SIGNAL_BASE = 128


class ExternalProcessConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A program, how to start it, and what is said of it when it has started."""

    name: str
    command: tuple[str, ...]
    environment: dict[str, str]
    """Added to the keeper's own."""
    folder: str
    """Where it works."""
    details: dict[str, Any] = {}


def keep(config: ExternalProcessConfig) -> int:
    """Run the program to its end, or to ours; returns the exit status. Raises OSError if it cannot be run."""
    keeper, libc = os.getpid(), ctypes.CDLL(None)

    def die_with_keeper() -> None:
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != keeper:  # which has ended meanwhile
            os._exit(1)

    program = subprocess.Popen(
        config.command,
        stdin=subprocess.DEVNULL,
        stdout=sys.stderr,
        cwd=config.folder,
        env=os.environ | config.environment,
        process_group=0,
        preexec_fn=die_with_keeper if sys.platform == "linux" else None,  # noqa: PLW1509  no thread runs yet
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
    """End the program and what it started in its group."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            program.wait(TERM_GRACE_S)


def main() -> int:
    """Parse the command line and keep; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m harness.launch.external_process", description="A program in a run."
    )
    parser.add_argument("--config", type=Path, required=True, help="JSON file that says what is run")
    parser.add_argument("--supervised", action="store_true", help="accepted for likeness: it always is")
    arguments = parser.parse_args()
    try:
        config = msgspec.json.decode(arguments.config.read_bytes(), type=ExternalProcessConfig)
        return keep(config)
    except (OSError, msgspec.DecodeError) as error:
        sys.stderr.write(f"keeper: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
