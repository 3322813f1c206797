"""``python -m harness.view.viewer_program ARGUMENTS``: replaces this process by the program of Rerun's wheel.

Its server yields the processors to every other process, so that it does not slow a flight down.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

from foundation.processes.scheduling import run_when_idle


def main() -> None:
    """Become the program."""
    found = find_spec("rerun_cli")
    if found is None or found.origin is None:
        sys.exit("the program of Rerun is not installed")
    if "--serve-web" in sys.argv:
        run_when_idle()
    program = str(Path(found.origin).with_name("rerun"))
    os.execv(program, [program, *sys.argv[1:]])  # noqa: S606  the program is that of the wheel


if __name__ == "__main__":
    main()
