"""Return of freed memory to the system, between the parts of a report: allocators keep it otherwise."""

import ctypes
import gc
from typing import Any

import pyarrow as pa

LARGE_BLOCK_BYTES = 262_144
"""Least block that is mapped by itself, and unmapped when it is freed"""
_M_MMAP_THRESHOLD = -3
"""Option of glibc's mallopt"""


def map_large_blocks() -> None:
    """Allocate each large block of memory by itself from now on: its memory is returned when it is freed.

    Without this, glibc raises the limit with each large block that is freed, up to 32 MB, and the blocks
    below it leave gaps. For coflight's own commands: it concerns all of the process.
    """
    set_option = _glibc("mallopt")
    if set_option is not None:
        set_option(_M_MMAP_THRESHOLD, LARGE_BLOCK_BYTES)


def return_freed_memory() -> None:
    """Collect garbage, and return what Arrow's and glibc's allocators keep; takes some milliseconds."""
    gc.collect()  # figures, whose parts refer to each other
    pa.default_memory_pool().release_unused()
    trim = _glibc("malloc_trim")
    if trim is not None:
        trim(0)


def _glibc(name: str) -> Any:  # noqa: ANN401  a foreign function
    """Return a function of the C library, None if it is another one."""
    return getattr(ctypes.CDLL(None), name, None)
