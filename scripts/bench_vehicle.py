"""What a step of one vehicle costs: ``python scripts/bench_vehicle.py``. See `studies.vehicle.bench`."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.vehicle.bench_cli import bench_app

if __name__ == "__main__":
    bench_app()
