"""Child processes for tests of supervisors, and functions that wait for their messages and states."""

import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from harness.launch.supervisor import Supervisor

WALL_LIMIT_S = 20.0
"""Wall time limit of every wait; far longer than any of them takes on a busy machine."""
_LAUNCHER = """
import sys
from pathlib import Path
from harness.launch.supervisor import Supervisor
from foundation.processes.child_protocol import Ready
supervisor = Supervisor(Path(sys.argv[1]))
{start}
ready = 0
while ready < len(supervisor.pids):
    message = supervisor.receive(10.0)
    ready += message is not None and isinstance(message[1], Ready)
print(*supervisor.pids.values(), flush=True)
while True:
    supervisor.receive(10.0)
"""


def python(code: str) -> list[str]:
    """Return the command line of a Python program."""
    return [sys.executable, "-c", textwrap.dedent(code)]


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Poll until a condition is true; raises AssertionError with ``what`` after `WALL_LIMIT_S`."""
    deadline = time.monotonic() + WALL_LIMIT_S
    while not condition():
        assert time.monotonic() < deadline, f"not in time: {what}"
        time.sleep(0.005)


def receive(supervisor: Supervisor, kind: type, name: str) -> object:
    """Return the next message of a kind from a child; raises AssertionError after `WALL_LIMIT_S`."""
    deadline = time.monotonic() + WALL_LIMIT_S
    while time.monotonic() < deadline:
        message = supervisor.receive(deadline - time.monotonic())
        if message is not None and message[0] == name and isinstance(message[1], kind):
            return message[1]
    raise AssertionError(f"no {kind.__name__} from {name}")


def alive(pid: int) -> bool:
    """Return whether a process exists and is no zombie."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def launcher_and_children(start: str, child: str, folder: Path, *, ends_by: signal.Signals) -> list[int]:
    """Signal a launcher when all its children are ready, and wait for their end; returns their pids.

    ``start`` is the code that starts them with ``supervisor``; ``child``, their program, is its
    ``sys.argv[2]``.
    """
    launcher_code = _LAUNCHER.format(start=textwrap.dedent(start))
    command = [sys.executable, "-c", launcher_code, str(folder), textwrap.dedent(child)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as launcher:
        assert launcher.stdout is not None
        pids = [int(pid) for pid in launcher.stdout.readline().split()]
        launcher.send_signal(ends_by)
        try:
            launcher.communicate(timeout=WALL_LIMIT_S)
        finally:
            launcher.kill()
    wait_for(lambda: not any(alive(pid) for pid in pids), f"children's end after {ends_by.name}")
    return pids
