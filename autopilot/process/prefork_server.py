"""``python -m autopilot.process.prefork_server``: the process from which a swarm's processes are forked.

They are coflight's vehicles, and the applications beside PX4s. It imports all modules of both and runs the
warm-up before it reports that it is ready, so they start within milliseconds. Forked processes also share
code, compiled kernels and bytecode in the same physical memory, and thereby the processor's caches.
"""

import argparse
import gc
import os
import socket
import sys
from collections.abc import Sequence

from autopilot.__main__ import main as vehicle_main
from autopilot.process.companion import main as application_main
from autopilot.process.iteration import APPLICATION
from autopilot.process.warm_up import warm_up
from foundation.kernels.warm_up import WarmUpError
from foundation.processes.child_protocol import Finished, Ready, emit
from foundation.processes.prefork import serve, show_name

NAME = "prefork"


def main() -> int:
    """Fork processes until the socket is closed; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m autopilot.process.prefork_server",
        description="The process from which a swarm's processes are forked.",
    )
    parser.add_argument(
        "--fork-fd", type=int, required=True, help="inherited Unix socket with the fork requests"
    )
    parser.add_argument("--supervised", action="store_true", help="accepted, without effect")
    arguments = parser.parse_args()
    show_name(NAME)
    with socket.socket(fileno=arguments.fork_fd) as line:
        if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":  # otherwise there is nothing to load
            try:
                warm_up()
            except WarmUpError as error:
                sys.stderr.write(f"{NAME}: {error}\n")
                return 2
        # A later collection writes to the header of every object that it visits, which would copy every page
        # for each process: frozen objects are not visited. No collection before: the memory that it frees
        # lies between objects on shared pages, and each process would copy the page for its next object.
        gc.freeze()
        emit(Ready(name=NAME, pid=os.getpid()))
        serve(line, run)
    emit(Finished(name=NAME))
    return 0


def run(arguments: Sequence[str]) -> int:
    """Run a forked process with its command line; return its exit status."""
    if arguments and arguments[0] == APPLICATION:
        return application_main(arguments[1:])
    return vehicle_main(arguments)


if __name__ == "__main__":
    sys.exit(main())
