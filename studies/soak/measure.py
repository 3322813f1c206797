"""Memory, descriptors and processor time of a process. An I/O module."""

import psutil
from msgspec import Struct

_MB = 1e6


class Measured(Struct, frozen=True, kw_only=True):
    """One measurement of one process."""

    private_mb: float
    """Memory that is freed when the process ends (USS)"""
    shared_mb: float
    """Its share of the memory of all processes (PSS), or USS where the system has no PSS"""
    descriptors: int
    threads: int
    cpu_s: float
    """User and system time since its start, s"""


def measure(pid: int) -> Measured:
    """Return the present state of a process. Raises psutil.NoSuchProcess."""
    process = psutil.Process(pid)
    memory, times = process.memory_full_info(), process.cpu_times()
    return Measured(
        private_mb=memory.uss / _MB,
        shared_mb=getattr(memory, "pss", memory.uss) / _MB,
        descriptors=process.num_fds(),
        threads=process.num_threads(),
        cpu_s=times.user + times.system,
    )
