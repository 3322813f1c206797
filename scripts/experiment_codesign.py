"""What ranging does for the formation: ``python scripts/experiment_codesign.py``. See `studies.codesign`."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.codesign.cli import codesign_app

if __name__ == "__main__":
    codesign_app()
