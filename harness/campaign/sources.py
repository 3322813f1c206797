"""Hash of coflight's sources and of the libraries that affect a flight.

A stored flight is valid while this hash is the same.
"""

import ast
import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path

from harness.records.versions import FLOWN_WITH, versions

_FLOWN_PACKAGES = ("foundation", "antenna", "netsim", "autopilot", "harness")
_NOT_FLOWN = (
    "antenna/lab/", "netsim/lab/", "harness/campaign/", "harness/cli/", "harness/export/",
    "harness/report/page/", "harness/view/",
)  # fmt: skip
"""Folders that do not affect a flight, except modules that compute its results."""
_SHOWN = {"antenna/analysis/gain_figures.py", "harness/report/figures.py", "harness/launch/pytest_plugin.py"}
"""Modules for drawing and tests, which do not affect a flight."""


def read_sources(root: Path, *, measured_by: Collection[str]) -> dict[str, bytes]:
    """Read the modules and tables that affect a flight or its results, by their sorted paths below ``root``.

    ``measured_by``: further modules of other folders, as paths below ``root``. Raises OSError.
    """
    sources = {}
    for package in _FLOWN_PACKAGES:
        for path in sorted((*(root / package).rglob("*.py"), *(root / package).rglob("*.csv"))):
            name = path.relative_to(root).as_posix()
            if name not in _SHOWN and not name.startswith(_NOT_FLOWN):
                sources[name] = path.read_bytes()
    for name in sorted(measured_by):
        sources[name] = (root / name).read_bytes()
    return sources


def hash_code(sources: Mapping[str, bytes]) -> str:
    """Return the hash of tables and of code without comments, docstrings and layout; raises SyntaxError."""
    content = _libraries()
    for name, source in sources.items():
        if not name.endswith(".py"):
            content.update(name.encode() + b"\0" + source)
            continue
        tree = ast.parse(source)
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
        content.update(name.encode() + b"\0" + ast.dump(tree).encode())
    return content.hexdigest()


def hash_bytes(sources: Mapping[str, bytes]) -> str:
    """Return the hash of the bytes, in a fiftieth of the time: if it is equal, so is `hash_code`."""
    content = _libraries()
    for name, source in sources.items():
        content.update(f"{name}\0{len(source)}\0".encode() + source)
    return content.hexdigest()


def _libraries() -> "hashlib._Hash":
    return hashlib.sha256(repr(versions(FLOWN_WITH)).encode())


def _is_text(node: ast.AST) -> bool:
    value = getattr(node, "value", None) if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)
