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
    pid = os.fork()  # a PID namespace holds the children of the process that enters it
    if pid == 0:
        try:
            os.execvp(command[0], list(command))  # noqa: S606  there is no shell
        except OSError as error:
            os.write(2, f"{command[0]}: {error.strerror}\n".encode())
            os._exit(NOT_FOUND if isinstance(error, FileNotFoundError) else CANNOT_EXECUTE)
    for number in (signal.SIGINT, signal.SIGQUIT):  # they are the command's
        signal.signal(number, signal.SIG_IGN)
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
