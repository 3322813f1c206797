"""What a step of one vehicle costs: ``python scripts/bench_vehicle.py``. See `harness.validation.bench`."""

import os

from harness import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from harness.validation.bench_cli import bench_app

if __name__ == "__main__":
    bench_app()
