"""Memory that is freed goes back to the system."""

import subprocess
import sys

import pytest

BLOCKS, BLOCK_BYTES = 1_000, 100_000
PROGRAM = f"""
import ctypes, psutil
from harness.records.freed_memory import map_large_blocks, return_freed_memory
map_large_blocks()
blocks = [bytearray({BLOCK_BYTES}) for _ in range({BLOCKS})]
last = bytearray({BLOCK_BYTES})  # the heap ends with it
del blocks
before_bytes = psutil.Process().memory_info().rss
return_freed_memory()
print(before_bytes - psutil.Process().memory_info().rss)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's allocator")
def test_gaps_between_blocks_are_returned():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 0.8 * BLOCKS * BLOCK_BYTES
