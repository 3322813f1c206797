"""Measure how well one vehicle flies: ``python scripts/validate_vehicle.py``. See `harness.validation`."""

import os

from harness import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from harness.validation.cli import validate_app

if __name__ == "__main__":
    validate_app()
