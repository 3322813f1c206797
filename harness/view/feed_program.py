"""``python -m harness.view.feed_program ARGUMENTS``: the feed, `harness.view.feed`, of a flight.

Its imports, which take seconds, yield the processors to every other process too.
"""

import sys

from foundation.kernels.use_cache import use_kernel_cache
from foundation.processes.scheduling import run_when_idle


def main() -> int:
    """Follow a flight; returns the exit status."""
    run_when_idle()
    from harness.view import feed  # noqa: PLC0415  not before the line above

    use_kernel_cache()
    return feed.main()


if __name__ == "__main__":
    sys.exit(main())
