"""Set the cache folder of compiled kernels for this process and its children, by the state of the sources."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is later
