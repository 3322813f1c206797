"""``python -m netsim --config FILE``: the 802.11 emulator of one run."""

import argparse
import os
import sys
from pathlib import Path

from foundation.kernels import cache_folder

if "--supervised" not in sys.argv:  # the launcher sets the environment of a supervised process
    os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from netsim.transport.server import run
from netsim.transport.zenoh_session import TransportError


def main() -> int:
    """Run the emulator until it is stopped; return 2, after one line on stderr, if it fails."""
    parser = argparse.ArgumentParser(prog="python -m netsim", description="The 802.11 emulator of one run.")
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the emulator's settings")
    parser.add_argument(
        "--interval-fd", type=int, required=True, help="inherited stream socket to the time master"
    )
    parser.add_argument("--supervised", action="store_true", help="read commands on stdin; exit at its end")
    arguments = parser.parse_args()
    try:
        run(arguments.config, arguments.interval_fd, supervised=arguments.supervised)
    except (TransportError, OSError, ValueError) as error:  # ValueError: invalid settings
        print(f"radio: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
