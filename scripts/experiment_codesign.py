"""What ranging does for the formation: ``python scripts/experiment_codesign.py``. See `harness.codesign`."""

import os

from harness import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from harness.codesign.cli import codesign_app

if __name__ == "__main__":
    codesign_app()
