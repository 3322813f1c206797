"""Fly a scenario: ``python scripts/launch_swarm.py scenarios/article.toml``. See `harness.cli`."""

import sys

from harness.cli import main

if __name__ == "__main__":
    sys.exit(main())
