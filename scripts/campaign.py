"""Many flights and one table: ``python scripts/campaign.py CAMPAIGN.toml``. See docs/how-to/campaigns.md."""

import os
import sys

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is later

from harness.cli.campaign import main

if __name__ == "__main__":
    sys.exit(main())
