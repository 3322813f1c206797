"""Children of tests, and waiting for facts about them: shared by the tests of whatever supervises."""

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
"""Far beyond what any of these waits takes on a busy machine."""
_LAUNCHER = """
import sys
from pathlib import Path
from harness.launch.supervisor import Supervisor
from foundation.processes.child_protocol import Ready
supervisor = Supervisor(Path(sys.argv[1]))
{start}
ready = 0
while ready < len(supervisor.pids):
    heard = supervisor.hear(10.0)
    ready += heard is not None and isinstance(heard[1], Ready)
print(*supervisor.pids.values(), flush=True)
while True:
    supervisor.hear(10.0)
"""


def python(code: str) -> list[str]:
    return [sys.executable, "-c", textwrap.dedent(code)]


def wait_for(fact: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WALL_LIMIT_S
    while not fact():
        assert time.monotonic() < deadline, f"not in time: {what}"
        time.sleep(0.005)


def hear(supervisor: Supervisor, kind: type, name: str) -> object:
    """Next message of that kind from that child."""
    deadline = time.monotonic() + WALL_LIMIT_S
    while time.monotonic() < deadline:
        heard = supervisor.hear(deadline - time.monotonic())
        if heard is not None and heard[0] == name and isinstance(heard[1], kind):
            return heard[1]
    raise AssertionError(f"no {kind.__name__} from {name}")


def alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def launcher_and_children(start: str, child: str, folder: Path, *, ends_by: signal.Signals) -> list[int]:
    """End a launcher by a signal when all its children are ready, and wait until they are gone; their pids.

    ``start`` is how it starts them with its ``supervisor``, ``child`` the program in its ``sys.argv[2]``.
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
