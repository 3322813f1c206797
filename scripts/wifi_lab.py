"""The 802.11 emulator alone: ``python scripts/wifi_lab.py saturation --stations 10``. See `netsim.lab`."""

import os
import sys

from foundation.kernels import cache_folder

os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from netsim.lab.cli import main

if __name__ == "__main__":
    sys.exit(main())
