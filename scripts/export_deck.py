"""A run in other formats: ``python scripts/export_deck.py RUN --time 60 --out array.nec``.

See `harness.cli.export`.
"""

import os
import sys

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from harness.cli.export import main

if __name__ == "__main__":
    sys.exit(main())
