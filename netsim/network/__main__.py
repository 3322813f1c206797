"""``python -m netsim.network --config FILE``: interfaces and programs of a run's vehicles.

The process becomes the parent of PID 1 of a PID namespace, which does the work.
"""

import argparse
import os
import sys
from pathlib import Path

from netsim.network.namespaces import run_as_first_process


def main() -> int:
    """Serve until a command to stop; return 2, after one line on stderr, if it fails."""
    parser = argparse.ArgumentParser(
        prog="python -m netsim.network", description="Network interfaces and programs of a run's vehicles."
    )
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the settings")
    parser.add_argument("--supervised", action="store_true", help="read commands on stdin; exit at its end")
    arguments = parser.parse_args()
    pid = os.getpid()

    def serve(outer_proc: int) -> int:
        # imported in the new process: no thread may run before it
        from netsim.network.host import run  # noqa: PLC0415

        run(arguments.config, outer_proc, pid=pid, supervised=arguments.supervised)
        return 0

    try:
        return run_as_first_process(serve)
    except (OSError, ValueError) as error:  # ValueError: invalid settings
        print(f"network: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
