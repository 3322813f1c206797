"""Compile the numerical kernels once, before a swarm needs them.

The cache is one folder per state of the sources (`foundation.kernels.cache_folder`). The first run that finds
its folder empty compiles all kernels before it starts vehicles; otherwise every vehicle would compile the
same kernels in flight. Each package compiles in a process of its own (`foundation.kernels.compiling`). The
antenna's kernels are only needed after the flight, so `prepare_flight` leaves them to a process of low
priority beside it.
"""

import contextlib
import os
import re
import selectors
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Self

from msgspec import Struct

from foundation.kernels.cache_folder import PACKAGES, VARIABLE, digest, environment, folder, own_base
from foundation.kernels.cache_trust import UntrustedCache
from foundation.records.private_files import make_private
from harness.launch.interrupts import interrupts_deferred
from harness.launch.prefork_client import process_of
from harness.launch.process_commands import bound_module
from harness.launch.process_watch import LOOK_PERIOD_S, ProcessWatch
from harness.launch.spawner import spawn
from harness.simulator.process_activity import DEAD, ProcessState, state_of

__all__ = [
    "PACKAGES", "VARIABLE", "CompileError", "CompileProgress", "Compilers", "digest", "environment", "folder",
    "prepare", "prepare_flight",
]  # fmt: skip

COMPILE_LIMIT_S = 600.0
"""Longest wall time without a compiled kernel."""
KEPT_STATES = 8
"""Enough for work that alternates between branches."""
KEPT_S = 86_400.0
"""A state that was used within a day is kept as well: a process may be running on it."""
_FOLDER = re.compile(r"[0-9a-f]{16}")
_COUNTS = re.compile(r"^(\d+) (\d+)$", re.MULTILINE)
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


class CompileProgress(Struct, frozen=True):
    """Kernels of a package that is being compiled."""

    done: int
    total: int
    """Number of loaded kernels; 0 before the package is loaded."""


OnProgress = Callable[[Mapping[str, CompileProgress]], object]
"""Called with the state of each package that is being compiled, whenever it changes."""


def prepare(note: Callable[[str], None], on_progress: OnProgress | None = None) -> None:
    """Compile every kernel that is not compiled.

    ``note`` is called with a line before it takes long. Raises CompileError.
    """
    _prepare(_WARM_UPS, note, on_progress)


def prepare_flight(note: Callable[[str], None], on_progress: OnProgress | None = None) -> "Compilers":
    """Compile the kernels of a flight as `prepare`, and start to compile the others beside it.

    Close the returned processes at the end of the flight; `prepare` compiles what they have not. Raises
    CompileError.
    """
    _prepare([name for name in _WARM_UPS if name not in _AFTER_FLIGHT], note, on_progress)
    return Compilers(_missing(_AFTER_FLIGHT), in_background=True)


def _prepare(names: Iterable[str], note: Callable[[str], None], on_progress: OnProgress | None) -> None:
    missing = _missing(names)
    if missing:
        listed = " and ".join(filter(None, (", ".join(missing[:-1]), missing[-1])))
        note(f"compiling the numerical kernels of {listed}; this is done once")
        with Compilers(missing) as compilers:
            compilers.wait(on_progress)


def _missing(names: Iterable[str]) -> list[str]:
    """Return the packages that are not complete, with a folder to compile them to. Raises CompileError."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return []
    try:
        environment()  # marks the folder as used
    except UntrustedCache as error:
        raise CompileError(str(error)) from None
    missing = [name for name in names if not _complete(name).exists()]
    if missing:
        lock = _complete(missing[0]).with_suffix(".lock")
        try:
            make_private(folder(), exist_ok=True)
            lock.touch()
            remove_old(lock.stat().st_mtime)
        except OSError as error:
            raise CompileError(
                f"compiled kernels cannot be kept in {folder()}: {error.strerror} (set by XDG_CACHE_HOME)"
            ) from None
    return missing


def _complete(name: str) -> Path:
    """Return the file that exists when all kernels of the package are compiled."""
    return folder() / f"{name}.complete"


class _Compiler:
    """Process that compiles one package; its errors are kept in a temporary file."""

    def __init__(self, name: str, *, in_background: bool) -> None:
        self.name = name
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  closed by `end`
        command = bound_module("foundation.kernels.compiling", _WARM_UPS[name], str(_complete(name)))
        if in_background and shutil.which("nice"):
            command = ["nice", "-n", str(_LOWEST_PRIORITY), *command]
        self._process = spawn(
            command,
            env=os.environ | environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            process_group=0 if in_background else None,  # Ctrl-C ends the flight, not yet this process
        )
        self.pipe = self._process.stdout
        self._text = ""

    def read(self) -> CompileProgress | None:
        """Return the newest progress of the output that has arrived; None at its end.

        Raises CompileError at the end of a process that failed.
        """
        data = os.read(self.pipe.fileno(), 65_536) if self.pipe is not None else b""
        if not data:
            self._check()
            return None
        self._text = (self._text + data.decode(errors="replace"))[-1_000:]
        counts = _COUNTS.findall(self._text)
        done, total = counts[-1] if counts else (0, 0)
        return CompileProgress(int(done), int(total))

    def state(self) -> ProcessState:
        """Return the present state of the process."""
        process = process_of(self._process.pid)
        return DEAD if process is None else state_of(process)

    def _check(self) -> None:
        code = self._process.wait()
        if code:
            self._errors.seek(0)
            last_line = self._errors.read().decode(errors="replace").rstrip().rpartition("\n")[2]
            reason = f"ended by {signal.Signals(-code).name}" if code < 0 else last_line
            raise CompileError(f"the {self.name} kernels do not compile: {reason}")

    def end(self) -> None:
        """End the process if it still runs."""
        self._process.kill()
        self._process.communicate()
        self._errors.close()


class Compilers:
    """Processes that compile one package each; a context manager that ends them.

    ``in_background``: at the lowest priority, and not ended by Ctrl-C.
    """

    def __init__(self, names: Iterable[str] = (), *, in_background: bool = False) -> None:
        self._compilers: list[_Compiler] = []
        with contextlib.ExitStack() as stack:
            with interrupts_deferred():  # Ctrl-C ends each process that was started
                for name in names:
                    self._compilers.append(_Compiler(name, in_background=in_background))
                    stack.callback(self._compilers[-1].end)
            self._close = stack.pop_all().close

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait(self, on_progress: OnProgress | None = None) -> None:
        """Wait until all have compiled their package. Raises CompileError."""
        state = {compiler.name: CompileProgress(0, 0) for compiler in self._compilers}
        wall_limit_s = time.monotonic() + COMPILE_LIMIT_S
        watch = ProcessWatch()
        with selectors.DefaultSelector() as selector:
            for compiler in self._compilers:
                if compiler.pipe is not None:
                    selector.register(compiler.pipe, selectors.EVENT_READ, compiler)
            while selector.get_map():
                ready = selector.select(LOOK_PERIOD_S)
                states = {key.data.name: key.data.state() for key in selector.get_map().values()}
                found = watch.look(time.monotonic(), states)
                if found is not None:
                    raise CompileError(f"the process that compiles the {found.name} kernels {found.what}")
                if ready:
                    wall_limit_s = time.monotonic() + COMPILE_LIMIT_S
                elif time.monotonic() > wall_limit_s:
                    raise CompileError(f"no kernel was compiled within {COMPILE_LIMIT_S:g} s")
                for key, _ in ready:
                    progress = key.data.read()
                    if progress is None:
                        selector.unregister(key.fileobj)
                        continue
                    state[key.data.name] = progress
                    if on_progress is not None:
                        on_progress(state)

    def close(self) -> None:
        """End processes that still run; harmless when repeated."""
        self._close()


def remove_old(now_s: float) -> None:
    """Remove the caches of states of the sources that were not used for long before ``now_s``, a file's time.

    Not those in a folder that the user has named, which may be others' as well.
    """
    base = own_base()
    if folder().parent != base:
        return
    used_s: dict[Path, float] = {}
    for path in base.iterdir():
        if _FOLDER.fullmatch(path.name):
            with contextlib.suppress(FileNotFoundError):  # another process may remove it as well
                used_s[path] = path.stat().st_mtime
    for path in sorted(used_s, key=used_s.__getitem__)[:-KEPT_STATES]:
        if used_s[path] < now_s - KEPT_S:
            shutil.rmtree(path, ignore_errors=True)
