"""Compile the kernels of one package into the cache on disk, in a process of its own.

    python -m foundation.kernels.compiling WARM_UP_MODULE COMPLETE_FILE

calls ``warm_up()`` of the module, which runs every kernel of its package once, and creates the file when all
are in the cache. While it runs it prints ``done total``: the numbers of the package's kernels that this
process has compiled, and that are loaded. Of several processes with the same file one compiles and the others
wait for it. Exit status 1 with an error on stderr: a kernel does not compile, or the results of the warm-up
are wrong.
"""

import fcntl
import os
import sys
from importlib import import_module
from pathlib import Path


def main(warm_up_module: str, complete: Path) -> None:
    """Compile the package of the warm-up for this user alone, unless the file says that it is complete."""
    os.umask(0o077)
    with complete.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # released when the file closes, however this process ends
        if not complete.exists():
            _compile(warm_up_module)
            complete.touch()


def _compile(warm_up_module: str) -> None:
    # not before the lock: Numba takes 90 MB, and many processes may wait for it
    from numba.core.dispatcher import Dispatcher  # noqa: PLC0415
    from numba.core.event import Event, Listener, install_listener  # noqa: PLC0415

    package = warm_up_module.partition(".")[0]

    def is_own(module: str) -> bool:
        return module.partition(".")[0] == package

    def loaded() -> int:
        return sum(
            isinstance(kernel, Dispatcher) and kernel.py_func.__module__ == name
            for name, module in list(sys.modules.items())
            if is_own(name)
            for kernel in list(vars(module).values())
        )

    class Progress(Listener):
        """Prints the progress after each kernel; its further specialisations are not counted."""

        def __init__(self) -> None:
            self.done: set[str] = set()

        def on_start(self, event: Event) -> None:
            pass

        def on_end(self, event: Event) -> None:
            function = event.data["dispatcher"].py_func
            if is_own(function.__module__):
                self.done.add(f"{function.__module__}.{function.__qualname__}")
                sys.stdout.write(f"{len(self.done)} {max(len(self.done), loaded())}\n")
                sys.stdout.flush()

    warm_up = import_module(warm_up_module).warm_up
    with install_listener("numba:compile", Progress()):
        warm_up()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
