"""What flying costs, against a floor: ``python scripts/bench.py``. See `studies.bench`."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.bench.cli import bench_app

if __name__ == "__main__":
    bench_app()
