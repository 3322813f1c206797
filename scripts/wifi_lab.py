"""The 802.11 emulator alone: ``python scripts/wifi_lab.py saturation --stations 10``. See `netsim.lab`."""

import sys

from netsim.lab.cli import main

if __name__ == "__main__":
    sys.exit(main())
