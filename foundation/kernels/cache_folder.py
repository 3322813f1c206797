"""Where compiled numerical kernels live: one folder for each state of their sources.

Numba's cache follows each source file alone: a kernel that calls another module's would stay what it was
when that one changes. So every state of the kernels' sources gets a folder of its own, named by their hash;
every checkout too, for Numba finds a kernel by its file's path. All processes of a run share the folder
(`NUMBA_CACHE_DIR`).

It stands in the lowest package, and needs nothing but the standard library, so that a process of any package
can set the folder before it imports Numba, which reads it then and once. That the folder is filled before a
swarm flies, and the old ones go, is `harness.launch.kernel_cache`'s.
"""

import contextlib
import hashlib
import importlib.metadata
import os
import re
import sys
from functools import cache
from pathlib import Path

PACKAGES = ("foundation", "antenna", "netsim", "autopilot", "harness", "coflight", "studies")
VARIABLE = "NUMBA_CACHE_DIR"
_IMPORT = re.compile(rf"^\s*from ((?:{'|'.join(PACKAGES)})(?:\.\w+)*) import\b", re.MULTILINE)


def own_base() -> Path:
    """Where the folders are that nobody has named: ``$XDG_CACHE_HOME/coflight/kernels``."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "coflight" / "kernels"


@cache
def folder() -> Path:
    """Give the present sources' cache.

    ``<hash>`` in `own_base`, or in the folder that the variable names. A parent of ours has set it to the
    whole already.
    """
    name = digest(Path(__file__).parents[2])
    if VARIABLE in os.environ:
        named = Path(os.environ[VARIABLE])
        return named if named.name == name else named / name
    return own_base() / name


def environment() -> dict[str, str]:
    """Variables with which a process finds the kernels; the folder, if it is there, is marked as used now."""
    with contextlib.suppress(OSError):
        os.utime(folder())
    return {VARIABLE: str(folder())}


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
    """Files of our packages that a file imports by ``from package.module import name``, at whatever place.

    Every process of a run asks: parsing what is looked through here would take a fifth of a second in each.
    """
    modules = _IMPORT.findall(path.read_text(encoding="utf-8"))
    places = [root.joinpath(*module.split(".")) for module in modules]
    found = [place.with_suffix(".py") for place in places] + [place / "__init__.py" for place in places]
    return {file for file in found if file.exists()}
