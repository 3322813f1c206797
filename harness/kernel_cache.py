"""Where compiled numerical kernels live, and having them compiled once before a swarm needs them.

Numba's cache follows each source file alone: a kernel that calls another module's would stay what it was
when that one changes. So every state of the kernels' sources gets a folder of its own, named by their hash;
every checkout too, for Numba finds a kernel by its file's path. All processes of a run share the folder
(`NUMBA_CACHE_DIR`), and the first run that finds it empty compiles before it starts vehicles, which would
otherwise all compile the same at once, in mid-air.
"""

import ast
import fcntl
import hashlib
import importlib.metadata
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

PACKAGES = ("antenna", "netsim", "autopilot", "harness")
VARIABLE = "NUMBA_CACHE_DIR"
COMPILE_LIMIT_S = 600.0
KEPT_STATES = 8
"""Enough for someone who goes back and forth between branches."""
_COMPLETE = "complete"
_COMPILERS = {
    "the vehicles'": "from autopilot.rehearsal import rehearse; rehearse()",
    "the physics'": "from harness.physics.rehearsal import rehearse; rehearse()",
}


class CompileError(RuntimeError):
    """A kernel does not compile; the text is one line."""


@cache
def folder() -> Path:
    """Give the present sources' cache.

    ``$XDG_CACHE_HOME/coflight/kernels/<hash>``, or ``<hash>`` in the folder that the variable names. A
    parent of ours has set it to the whole already.
    """
    name = digest(Path(__file__).parents[1])
    if VARIABLE in os.environ:
        named = Path(os.environ[VARIABLE])
        return named if named.name == name else named / name
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "coflight" / "kernels" / name


def environment() -> dict[str, str]:
    """Variables with which a process finds the kernels."""
    return {VARIABLE: str(folder())}


def prepare(note: Callable[[str], None]) -> None:
    """Compile every kernel unless that has been done.

    ``note`` is told before it takes long. Raises CompileError.

    Of several processes that find the cache empty one compiles and the others wait.
    """
    complete = folder() / _COMPLETE
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return
    if complete.exists():
        complete.touch()  # what is used is kept
        return
    note("compiling the numerical kernels, which takes about half a minute and is done once")
    folder().mkdir(parents=True, exist_ok=True)
    with (folder() / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # given back when the file closes, however this process ends
        if not complete.exists():
            _compile()
            complete.touch()
            _forget_old()


def _forget_old() -> None:
    """Remove the caches of all but the latest states of the sources."""
    if VARIABLE in os.environ:
        return  # somebody else's folder
    by_age = sorted(folder().parent.glob(f"*/{_COMPLETE}"), key=lambda mark: mark.stat().st_mtime)
    for mark in by_age[:-KEPT_STATES]:
        shutil.rmtree(mark.parent, ignore_errors=True)


def _compile() -> None:
    """Compile the vehicles' and the physics' kernels side by side, in processes of their own."""
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


def digest(root: Path) -> str:
    """Hash of everything that compiled code depends on, of the packages below ``root``.

    That is the modules with kernels, what they import of ours, where they are, and the compiler.
    """
    root = root.resolve()
    pending = {
        path
        for package in PACKAGES
        for path in (root / package).rglob("*.py")
        if b"@njit" in path.read_bytes()
    }
    seen: set[Path] = set()
    while pending:
        path = pending.pop()
        seen.add(path)
        pending |= _imports(path, root) - seen
    versions = [importlib.metadata.version(name) for name in ("numba", "llvmlite", "numpy")]
    content = hashlib.sha256(" ".join([str(root), sys.version, *versions]).encode())
    for path in sorted(seen):
        content.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return content.hexdigest()[:16]


def _imports(path: Path, root: Path) -> set[Path]:
    """Files of our packages that a file imports by ``from package.module import name``."""
    modules = [
        node.module
        for node in ast.walk(ast.parse(path.read_bytes()))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in PACKAGES
    ]
    places = [root.joinpath(*module.split(".")) for module in modules]
    found = [place.with_suffix(".py") for place in places] + [place / "__init__.py" for place in places]
    return {file for file in found if file.exists()}
