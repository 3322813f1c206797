"""PX4s in coflight and with a bare simulator: ``python scripts/bench_px4.py``. See `studies.bench`."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.bench.px4_cli import px4_bench_app

if __name__ == "__main__":
    px4_bench_app()
