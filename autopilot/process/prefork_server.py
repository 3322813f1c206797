"""``python -m autopilot.process.prefork_server``: the process that a swarm's vehicles are forked from.

It imports all that a vehicle needs and flies a rehearsal before it says that it is ready, so a vehicle starts
within milliseconds, and warm. That counts beyond the start: forked vehicles have code, compiled kernels and
bytecode in the same physical memory, and a processor's cache that held them for one has them for the next.
"""

import argparse
import gc
import os
import socket
import sys

from autopilot.__main__ import main as vehicle_main
from autopilot.process.warm_up import RehearsalError, rehearse
from foundation.processes.child_protocol import Finished, Ready, emit
from foundation.processes.prefork import serve, show_name

NAME = "hangar"


def main() -> int:
    """Fork vehicles until told to stop; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m autopilot.process.prefork_server",
        description="The process that a swarm's vehicles are forked from.",
    )
    parser.add_argument(
        "--fork-fd", type=int, required=True, help="inherited Unix socket that says what to fork"
    )
    parser.add_argument("--supervised", action="store_true", help="accepted for likeness: it always is")
    arguments = parser.parse_args()
    show_name(NAME)
    with socket.socket(fileno=arguments.fork_fd) as line:
        try:
            warm_up()
        except RehearsalError as error:
            sys.stderr.write(f"{NAME}: {error}\n")
            return 2
        emit(Ready(name=NAME, pid=os.getpid()))
        serve(line, vehicle_main)
    emit(Finished(name=NAME))
    return 0


def warm_up() -> None:
    """Have everything loaded that a vehicle will run, and out of the garbage collector's way.

    A collection writes into the head of every object it looks at, which would give each vehicle a copy of its
    own of every page. Uncompiled kernels have nothing to load, and take too long. Raises RehearsalError.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":
        rehearse()
    gc.collect()
    gc.freeze()


if __name__ == "__main__":
    sys.exit(main())
