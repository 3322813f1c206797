"""Random load of a machine: processes that compute or change memory. An I/O module."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator

import numpy as np

_WITH_PARENT = """import os, sys, threading
threading.Thread(target=lambda: (sys.stdin.buffer.read(), os._exit(0)), daemon=True).start()
"""
_COMPUTE = "while True: pass"
_CHANGE_MEMORY = "b = bytearray(200_000_000)\nwhile True: b = bytes(b[1:] + b[:1])"
MOST_PROCESSES = 3
_KINDS = ("compute", "change memory")
_MOST_NICE = 10


@contextlib.contextmanager
def busy_processors(count: int) -> Iterator[None]:
    """Run processes that compute."""
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            _start(stack, _COMPUTE, nice=0)
        yield


@contextlib.contextmanager
def random_load(rng: np.random.Generator) -> Iterator[str]:
    """Run up to `MOST_PROCESSES` processes of random kinds and priorities; yields them in words."""
    kinds = [_KINDS[rng.integers(len(_KINDS))] for _ in range(rng.integers(MOST_PROCESSES + 1))]
    with contextlib.ExitStack() as stack:
        for kind in kinds:
            nice = int(rng.integers(_MOST_NICE + 1))
            code = _COMPUTE if kind == "compute" else _CHANGE_MEMORY
            _start(stack, code, nice=nice)
        yield ", ".join(kinds) or "none"


def _start(stack: contextlib.ExitStack, code: str, *, nice: int) -> None:
    """Start a process that ends with the stack, or with this process: its input then ends."""
    command = [sys.executable, "-I", "-c", _WITH_PARENT + code]
    # a group of its own: Ctrl-C reaches the study, which ends it
    process = stack.enter_context(subprocess.Popen(command, stdin=subprocess.PIPE, process_group=0))
    stack.callback(process.kill)
    os.setpriority(os.PRIO_PROCESS, process.pid, nice)
