"""Fly a scenario: ``python scripts/launch_swarm.py scenarios/article.toml``. See `harness.cli.fly`."""

import os
import sys

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from harness.cli.fly import main

if __name__ == "__main__":
    sys.exit(main())
