"""What flying costs, against a floor: ``python scripts/bench.py``. See `harness.bench`."""

import os

from harness import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from harness.bench.cli import bench_app

if __name__ == "__main__":
    bench_app()
