"""Compile the numerical kernels once, before a swarm needs them.

The cache is one folder per state of the sources (`foundation.kernels.cache_folder`). The first run that finds
its folder empty compiles all kernels before it starts vehicles; otherwise every vehicle would compile the
same kernels in flight. Each package compiles in a process of its own (`foundation.kernels.compiling`). The
antenna's kernels are only needed after the flight, so `prepare_flight` leaves them to a process of low
priority beside it.
"""

import atexit
import contextlib
import os
import re
import selectors
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Self

from msgspec import Struct

from foundation.kernels.cache_folder import PACKAGES, VARIABLE, digest, environment, folder, own_base

__all__ = [
    "PACKAGES",
    "VARIABLE",
    "CompileError",
    "Compiled",
    "Compilers",
    "digest",
    "environment",
    "folder",
    "prepare",
    "prepare_flight",
]  # fmt: skip

COMPILE_LIMIT_S = 600.0
KEPT_STATES = 8
"""Enough for work that alternates between branches."""
KEPT_S = 86_400.0
"""A state that was used within a day is kept as well: a process may be running on it."""
_FOLDER = re.compile(r"[0-9a-f]{16}")
_WARM_UPS = {
    "vehicles": "autopilot.process.warm_up",
    "radio": "netsim.emulator.warm_up",
    "physics": "harness.world.physics.warm_up",
    "antenna": "antenna.solvers.warm_up",
}
_AFTER_FLIGHT = frozenset({"antenna"})
_LOWEST_PRIORITY = 19


class CompileError(RuntimeError):
    """The kernels cannot be compiled or kept; the text is one line."""


class Compiled(Struct, frozen=True):
    """Kernels of a package that are compiled."""

    done: int
    total: int
    """Number of loaded kernels; 0 before the package is loaded."""


OnProgress = Callable[[Mapping[str, Compiled]], object]
"""Called with the state of each package that is being compiled, whenever it changes."""


def prepare(note: Callable[[str], None], on_progress: OnProgress | None = None) -> None:
    """Compile every kernel that is not compiled.

    ``note`` is called with a line before it takes long. Raises CompileError.
    """
    with _start(note, _WARM_UPS) as compilers:
        compilers.wait(on_progress)


def prepare_flight(note: Callable[[str], None], on_progress: OnProgress | None = None) -> "Compilers":
    """Compile the kernels of a flight as `prepare`, and start to compile the others.

    Wait for the returned processes before the others are used, or close them. Raises CompileError.
    """
    with _start(note, [name for name in _WARM_UPS if name not in _AFTER_FLIGHT]) as compilers:
        compilers.wait(on_progress)
    beside = _start(lambda _: None, _AFTER_FLIGHT, beside=True)
    atexit.register(beside.close)
    return beside


def _start(note: Callable[[str], None], names: Iterable[str], *, beside: bool = False) -> "Compilers":
    """Start a process for each of the packages that is not complete; ``beside``: beside a flight.

    Raises CompileError.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return Compilers({})
    environment()  # marks the folder as used
    missing = [name for name in names if not _complete(name).exists()]
    if missing:
        try:
            folder().mkdir(parents=True, exist_ok=True)
            _complete(missing[0]).with_suffix(".lock").touch()
        except OSError as error:
            raise CompileError(
                f"compiled kernels cannot be kept in {folder()}: {error.strerror} (XDG_CACHE_HOME says where)"
            ) from None
        note(f"compiling the numerical kernels of {_listed(missing)}; this is done once")
        forget_old(_complete(missing[0]).with_suffix(".lock").stat().st_mtime)
    return Compilers({name: _compiler(name, beside=beside) for name in missing})


def _complete(name: str) -> Path:
    """Return the file that exists when all kernels of the package are compiled."""
    return folder() / f"{name}.complete"


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _compiler(name: str, *, beside: bool) -> "subprocess.Popen[str]":
    arguments = [_WARM_UPS[name], str(_complete(name))]
    command = [sys.executable, "-P", "-m", "foundation.kernels.compiling", *arguments]
    if beside and shutil.which("nice"):
        command = ["nice", "-n", str(_LOWEST_PRIORITY), *command]
    return subprocess.Popen(
        command,
        process_group=0 if beside else None,  # Ctrl-C ends the flight, whose report needs the kernels
        env=os.environ | environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


class Compilers:
    """Processes that compile one package each; a context manager that ends them."""

    def __init__(self, processes: Mapping[str, "subprocess.Popen[str]"]) -> None:
        self._processes = processes

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait(self, on_progress: OnProgress | None = None) -> None:
        """Wait until all have compiled their package. Raises CompileError, after the end of all."""
        state = {name: Compiled(0, 0) for name in self._processes}
        limit_s = time.monotonic() + COMPILE_LIMIT_S
        try:
            with selectors.DefaultSelector() as selector:
                for name, process in self._processes.items():
                    selector.register(process.stdout, selectors.EVENT_READ, name)  # type: ignore[arg-type]
                while selector.get_map():
                    if time.monotonic() > limit_s:
                        raise CompileError(f"the kernels did not compile within {COMPILE_LIMIT_S:g} s")
                    for key, _ in selector.select(1.0):
                        line = key.fileobj.readline()  # type: ignore[union-attr]
                        if not line:
                            selector.unregister(key.fileobj)
                            self._end(key.data)
                        elif on_progress is not None:
                            done, total = line.split()
                            state[key.data] = Compiled(int(done), int(total))
                            on_progress(state)
        finally:
            self.close()

    def _end(self, name: str) -> None:
        _, errors = self._processes[name].communicate()
        if self._processes[name].returncode:
            last_line = errors.rstrip().rpartition("\n")[2]
            raise CompileError(f"the {name} kernels do not compile: {last_line}")

    def close(self) -> None:
        """End processes that still run; harmless when repeated."""
        for process in self._processes.values():
            process.kill()
            process.communicate()
        self._processes = {}


def forget_old(now_s: float) -> None:
    """Remove the caches of states of the sources that were not used for long before ``now_s``, a file's time.

    Not those in a folder that the user has named, which may be others' as well.
    """
    base = own_base()
    if folder().parent != base:
        return
    used_s: dict[Path, float] = {}
    for path in base.iterdir():
        if _FOLDER.fullmatch(path.name):
            with contextlib.suppress(FileNotFoundError):  # another process tidies as well
                used_s[path] = path.stat().st_mtime
    for path in sorted(used_s, key=used_s.__getitem__)[:-KEPT_STATES]:
        if used_s[path] < now_s - KEPT_S:
            shutil.rmtree(path, ignore_errors=True)
