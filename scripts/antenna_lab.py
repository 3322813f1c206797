"""The swarm's antenna alone: ``python scripts/antenna_lab.py pattern --formation 4x2``. See `antenna.lab`."""

import os
import sys

from foundation.kernels import cache_folder

os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from antenna.lab.cli import main

if __name__ == "__main__":
    sys.exit(main())
