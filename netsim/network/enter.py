"""``python -m netsim.network.enter NETWORK_FD MOUNTS_FD [--folder FOLDER] -- COMMAND ...``: on a vehicle.

The command runs in the namespaces of inherited descriptors, in a session of its own. It ends with
the PID namespace it is started in. Exit status: 126 if it cannot be executed, 127 if it is not found. Imports
only what it needs, as it precedes each program.
"""

import ctypes
import os
import signal
import sys

_KINDS = {"network": 0x40000000, "mount": 0x00020000}  # CLONE_NEWNET, CLONE_NEWNS of linux/sched.h
CANNOT_EXECUTE, NOT_FOUND = 126, 127


def main(arguments: list[str]) -> int:
    """Execute the command; returns an exit status if that fails, after one line on stderr."""
    marker = arguments.index("--")
    options, command = arguments[:marker], arguments[marker + 1 :]
    try:
        folder = options[3] if options[2:] else os.getcwd()  # noqa: PTH109  without a further import
        for namespace, kind in zip(map(int, options[:2]), _KINDS, strict=True):
            _enter(namespace, kind)
            os.close(namespace)
        os.chdir(folder)  # the mount namespace has set it to the root
        os.setsid()
        for number in (signal.SIGINT, signal.SIGPIPE, signal.SIGXFSZ):  # ignored here, and it is inherited
            signal.signal(number, signal.SIG_DFL)
        os.execvp(command[0], command)  # noqa: S606  there is no shell
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"{command[0]}: {place}{error.strerror}", file=sys.stderr)  # noqa: T201  the program's log
        return NOT_FOUND if isinstance(error, FileNotFoundError) else CANNOT_EXECUTE


def _enter(namespace: int, kind: str) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.setns(namespace, _KINDS[kind]):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), f"{kind} namespace")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
