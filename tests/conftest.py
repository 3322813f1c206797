"""One cache of compiled kernels for this process and all that it starts, keyed by the kernels' sources."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is later
