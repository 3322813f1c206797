"""Folder of the cache of compiled kernels, one for each state of their sources and each processor model.

Numba's cache only checks the source file of a kernel: a kernel that calls another module's kernel would not
be recompiled when that one changes. So each state of the sources has a separate folder, named by a hash, as
has each checkout, since Numba finds a kernel by its file's path. All processes of a run share the folder
(`NUMBA_CACHE_DIR`).

This module uses only the standard library, so that a process of any package can set the folder before it
imports Numba, which reads the variable once at its import. `harness.launch.kernel_cache` fills the folder
before a flight and removes old ones.
"""

import contextlib
import hashlib
import importlib.metadata
import os
import platform
import re
import sys
from functools import cache
from pathlib import Path

from foundation.kernels.cache_trust import check_trusted
from foundation.records.private_files import make_private

PACKAGES = ("foundation", "antenna", "netsim", "autopilot", "harness", "coflight", "studies")
VARIABLE = "NUMBA_CACHE_DIR"
LOCATORS = "NUMBA_CACHE_LOCATOR_CLASSES"
SHARED = (
    "foundation.kernels.shared_cache.SharedCacheLocator,"
    "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"
)
"""Numba's own ones after ours, for modules of other packages."""
PROCESSOR = Path("/proc/cpuinfo")
_DECORATED = re.compile(rb"^@(njit|inner)\b", re.MULTILINE)
_MODEL = re.compile(r"^(?:model name|flags|CPU part|Features)\s*:.*$", re.MULTILINE)
_IMPORT = re.compile(rf"^\s*from ((?:{'|'.join(PACKAGES)})(?:\.\w+)*) import\b", re.MULTILINE)


def _user_base() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def own_base() -> Path:
    """Return the default parent of the folders: ``$XDG_CACHE_HOME/coflight/kernels``."""
    return _user_base() / "coflight" / "kernels"


@cache
def folder() -> Path:
    """Return the cache folder of the present sources.

    It is ``<hash>`` in the folder named by `VARIABLE`, else in `own_base`. A parent process of coflight has
    set the variable to the complete path.
    """
    name = digest(Path(__file__).parents[2])
    if VARIABLE in os.environ:
        named = Path(os.environ[VARIABLE])
        return named if named.name == name else named / name
    return own_base() / name


def environment() -> dict[str, str]:
    """Return the environment variables for Numba, in this process before its import and in child processes.

    Creates the folder, for its owner alone, or updates its time stamp. A folder that cannot be written, such
    as a shared installation's, is used as far as it is filled. Raises
    `foundation.kernels.cache_trust.UntrustedCache` if another user can write it.
    """
    path = folder()
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return {VARIABLE: str(path)}
    _check(path)
    is_new = not path.exists()
    with contextlib.suppress(OSError):
        make_private(path, exist_ok=True)
        os.utime(path)
    if is_new:  # another user may have made a parent meanwhile
        _check.cache_clear()
        _check(path)
    if path.is_dir() and not os.access(path, os.W_OK):
        return {VARIABLE: str(path), LOCATORS: SHARED}
    return {VARIABLE: str(path)}


@cache
def _check(path: Path) -> None:
    """Check that only this user or root can write the folder; once for each process."""
    if VARIABLE in os.environ:
        named = Path(os.environ[VARIABLE])
        check_trusted(path, named.parent if named == path else named, variable=VARIABLE)
    else:
        check_trusted(path, _user_base(), variable="XDG_CACHE_HOME")


def digest(root: Path) -> str:
    """Return the hash of everything that compiled code of the packages below ``root`` depends on.

    These are the modules with kernels, the warm-ups, the coflight modules that they import, their location,
    the compiler and the processor.
    """
    root = root.resolve()
    pending = {
        path
        for package in PACKAGES
        for path in (root / package).rglob("*.py")
        if path.name == "warm_up.py" or _DECORATED.search(path.read_bytes())
    }
    seen: set[Path] = set()
    while pending:
        path = pending.pop()
        seen.add(path)
        pending |= _imports(path, root) - seen
    versions = [importlib.metadata.version(name) for name in ("numba", "llvmlite", "numpy")]
    content = hashlib.sha256(" ".join([str(root), sys.version, *versions, _processor()]).encode())
    for path in sorted(seen):
        content.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return content.hexdigest()[:16]


def _processor() -> str:
    """Return model and instruction sets of the processor that the compiler generates code for.

    A cache that another machine has filled, in CI or in a container's image, would else count as complete.
    """
    named = [os.environ.get(name, "") for name in ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")]
    try:
        with PROCESSOR.open(encoding="utf-8", errors="replace") as file:
            text = file.read(16_384)  # the first processor, not all of a large machine
    except OSError:
        text = ""
    models = dict(line.split(":", 1) for line in reversed(_MODEL.findall(text)))
    return " ".join([platform.machine(), *named, *(models[name] for name in sorted(models))])


def _imports(path: Path, root: Path) -> set[Path]:
    """Return the coflight files that a file imports by ``from package.module import name``, also indented.

    It uses a regular expression, since parsing all files would take 0.2 s in every process of a run.
    """
    modules = _IMPORT.findall(path.read_text(encoding="utf-8"))
    places = [root.joinpath(*module.split(".")) for module in modules]
    found = [place.with_suffix(".py") for place in places] + [place / "__init__.py" for place in places]
    return {file for file in found if file.exists()}
