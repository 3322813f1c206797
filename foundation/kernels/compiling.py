"""Compile the kernels of one package into the cache on disk, in a process of its own.

    python -m foundation.kernels.compiling WARM_UP_MODULE COMPLETE_FILE

calls ``warm_up()`` of the module, which runs every kernel of its package once, and creates the file when all
are in the cache. While it runs it prints ``done total``: the numbers of the package's kernels that are
compiled and that are loaded. Of several processes with the same file one compiles and the others wait for it.
Exit status 1 with one line on stderr: a kernel does not compile, or the results of the warm-up are wrong.
"""

import fcntl
import sys
from importlib import import_module
from pathlib import Path

from numba.core.dispatcher import Dispatcher
from numba.core.event import Event, Listener, install_listener


class Progress(Listener):
    """Prints the progress after each compiled kernel of a package."""

    def __init__(self, package: str) -> None:
        self._package = package
        self._done: set[str] = set()

    def on_start(self, event: Event) -> None:
        """Do nothing."""

    def on_end(self, event: Event) -> None:
        """Count a kernel; other specialisations of the same kernel are not counted."""
        function = event.data["dispatcher"].py_func
        if self._is_own(function.__module__):
            self._done.add(f"{function.__module__}.{function.__qualname__}")
            sys.stdout.write(f"{len(self._done)} {max(len(self._done), self._loaded())}\n")
            sys.stdout.flush()

    def _is_own(self, module: str) -> bool:
        return module.partition(".")[0] == self._package

    def _loaded(self) -> int:
        return sum(
            isinstance(kernel, Dispatcher) and kernel.py_func.__module__ == name
            for name, module in list(sys.modules.items())
            if self._is_own(name)
            for kernel in list(vars(module).values())
        )


def main(warm_up_module: str, complete: Path) -> None:
    """Compile the package of the warm-up, unless the file says that it is complete."""
    with complete.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # released when the file closes, however this process ends
        if complete.exists():
            return
        warm_up = import_module(warm_up_module).warm_up
        with install_listener("numba:compile", Progress(warm_up_module.partition(".")[0])):
            warm_up()
        complete.touch()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
