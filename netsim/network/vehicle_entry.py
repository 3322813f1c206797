"""Run a command on a vehicle of a running swarm, from another process of the same user.

``python -m netsim.network.vehicle_entry HOLDER_PID COMMAND ...``: a program of its own, because a process
with several threads cannot enter a user namespace, and numerical libraries start threads.
"""

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from netsim.network.enter import CANNOT_EXECUTE, NOT_FOUND
from netsim.network.namespaces import set_namespace

_KINDS = ("user", "mnt", "net", "pid")
"""In the order in which they are entered: the user namespace permits the others."""


def enter_vehicle(holder_pid: int, command: Sequence[str]) -> int:
    """Run a command in the namespaces of a vehicle's holder and return its exit status, 128 + n for signal n.

    ``holder_pid`` is of `Ready.details`, ``holders``. Standard streams, environment and working folder are
    the caller's. To be called with one thread; the caller's namespaces change. Raises OSError if the
    holder does not exist or is of another user.
    """
    namespaces = [os.open(f"/proc/{holder_pid}/ns/{kind}", os.O_RDONLY | os.O_CLOEXEC) for kind in _KINDS]
    folder = Path.cwd()
    for namespace in namespaces:
        set_namespace(namespace)
        os.close(namespace)
    os.chdir(folder)  # the mount namespace has set it to the root
    # The PID namespace, which holds the children of the process that enters it, ends when all of them are
    # reaped. The kernel reaps this one by itself, also while this process is stopped.
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    for number in (signal.SIGINT, signal.SIGQUIT):  # they are the command's
        signal.signal(number, signal.SIG_IGN)
    reader, writer = os.pipe()
    if os.fork() == 0:
        os.close(reader)
        os.write(writer, bytes([_run(command)]))
        os._exit(0)
    os.close(writer)
    status = os.read(reader, 1)
    return status[0] if status else 128 + signal.SIGKILL


def _run(command: Sequence[str]) -> int:
    """Run a command as a child of this process and return its exit status, 128 + n for signal n."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    pid = os.fork()
    if pid == 0:
        for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGPIPE):
            signal.signal(number, signal.SIG_DFL)
        try:
            os.execvp(command[0], list(command))  # noqa: S606  there is no shell
        except OSError as error:
            os.write(2, f"{command[0]}: {error.strerror}\n".encode())
            os._exit(NOT_FOUND if isinstance(error, FileNotFoundError) else CANNOT_EXECUTE)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return status if status >= 0 else 128 - status


def main() -> int:
    """Run the command of the arguments; returns its exit status, or 2 with one line on stderr."""
    holder_pid, *command = sys.argv[1:]
    try:
        return enter_vehicle(int(holder_pid), command)
    except OSError as error:
        os.write(2, f"coflight: the vehicle cannot be entered: {error.strerror}\n".encode())
        return 2


if __name__ == "__main__":
    sys.exit(main())
