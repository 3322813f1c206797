"""What the emulated radio costs: ``python scripts/bench_radio.py``. See `studies.radio.bench`."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.radio.bench_cli import bench_radio_app

if __name__ == "__main__":
    bench_radio_app()
