"""Measure how well one vehicle flies: ``python scripts/validate_vehicle.py``. See `studies.vehicle`."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.vehicle.cli import validate_app

if __name__ == "__main__":
    validate_app()
