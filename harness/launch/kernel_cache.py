"""Compile the numerical kernels once, before a swarm needs them.

The cache is one folder per state of the sources (`foundation.kernels.cache_folder`). The first run that finds
its folder empty compiles all kernels before it starts vehicles; otherwise every vehicle would compile the
same kernels in flight.
"""

import contextlib
import fcntl
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from foundation.kernels.cache_folder import PACKAGES, VARIABLE, digest, environment, folder, own_base

__all__ = ["PACKAGES", "VARIABLE", "CompileError", "digest", "environment", "folder", "prepare"]

COMPILE_LIMIT_S = 600.0
KEPT_STATES = 8
"""Enough for work that alternates between branches."""
KEPT_S = 86_400.0
"""A state that was used within a day is kept as well: a process may be running on it."""
_COMPLETE = "complete"
_FOLDER = re.compile(r"[0-9a-f]{16}")
_COMPILERS = {
    "the vehicles'": "from autopilot.process.warm_up import warm_up; warm_up()",
    "the radio's": "from netsim.emulator.warm_up import warm_up; warm_up()",
    "the physics'": "from harness.world.physics.warm_up import warm_up; warm_up()",
    "the antenna's": "from antenna.solvers.warm_up import warm_up; warm_up()",
}


class CompileError(RuntimeError):
    """The kernels cannot be compiled or kept; the text is one line."""


def prepare(note: Callable[[str], None]) -> None:
    """Compile every kernel that is not compiled.

    ``note`` is called with a line before it takes long. Raises CompileError.

    Of several processes that find the cache empty one compiles and the others wait.
    """
    complete = folder() / _COMPLETE
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return
    if complete.exists():
        environment()  # what is used is kept
        return
    try:
        folder().mkdir(parents=True, exist_ok=True)
        lock_file = (folder() / "lock").open("w")
    except OSError as error:
        raise CompileError(
            f"compiled kernels cannot be kept in {folder()}: {error.strerror} (XDG_CACHE_HOME says where)"
        ) from None
    with lock_file as lock:
        note("compiling the numerical kernels, which takes about a minute and is done once")
        fcntl.flock(lock, fcntl.LOCK_EX)  # given back when the file closes, however this process ends
        if not complete.exists():
            _compile()
            complete.touch()
            forget_old(complete.stat().st_mtime)


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


def _compile() -> None:
    """Compile the vehicles', the radio's, the physics' and the antenna's kernels, each in a process."""
    compilers = {
        whose: subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            env=os.environ | environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        for whose, code in _COMPILERS.items()
    }
    try:
        for whose, compiler in compilers.items():
            _, errors = compiler.communicate(timeout=COMPILE_LIMIT_S)
            if compiler.returncode:
                last_line = errors.decode(errors="replace").rstrip().rpartition("\n")[2]
                raise CompileError(f"{whose} kernels do not compile: {last_line}")
    except subprocess.TimeoutExpired:
        raise CompileError(f"the kernels did not compile within {COMPILE_LIMIT_S:g} s") from None
    finally:
        for compiler in compilers.values():
            compiler.kill()
            compiler.wait()
