"""What flies, as a hash: a stored flight is of use while what would fly it now is the same.

That is our sources and the libraries with which they compute.
"""

import ast
import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path

from harness.records.versions import FLOWN_WITH, versions

ROOT = Path(__file__).parents[2]
_FLOWN_PACKAGES = ("foundation", "antenna", "netsim", "autopilot", "harness")
_NOT_FLOWN = ("antenna/lab/", "netsim/lab/", "harness/campaign/", "harness/cli/")
"""Folders that fly nothing, except for modules that compute a flight's numbers."""
_SHOWN = {"antenna/analysis/plots.py", "harness/report/figures.py", "harness/launch/pytest_plugin.py"}
"""Modules that draw or report what was flown."""


def hash_sources(root: Path, *, measured_by: Collection[str]) -> str:
    """Hash of what the modules of `read_sources` say, and of the libraries; raises OSError, SyntaxError."""
    return hash_said(read_sources(root, measured_by=measured_by))


def read_sources(root: Path, *, measured_by: Collection[str]) -> dict[str, bytes]:
    """Read the modules that fly and measure, by their paths below ``root``, in order.

    ``measured_by``: further modules, of folders that fly nothing, as paths below ``root``. Raises OSError.
    """
    sources = {}
    for package in _FLOWN_PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            name = path.relative_to(root).as_posix()
            if name not in _SHOWN and not name.startswith(_NOT_FLOWN):
                sources[name] = path.read_bytes()
    for name in sorted(measured_by):
        sources[name] = (root / name).read_bytes()
    return sources


def hash_said(sources: Mapping[str, bytes]) -> str:
    """Hash of what they say, without comments, docstrings and layout; raises SyntaxError."""
    content = _libraries()
    for name, source in sources.items():
        tree = ast.parse(source)
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
        content.update(name.encode() + b"\0" + ast.dump(tree).encode())
    return content.hexdigest()


def hash_bytes(sources: Mapping[str, bytes]) -> str:
    """Hash of their bytes, in a fiftieth of the time: where it is equal, `hash_said` is."""
    content = _libraries()
    for name, source in sources.items():
        content.update(f"{name}\0{len(source)}\0".encode() + source)
    return content.hexdigest()


def _libraries() -> "hashlib._Hash":
    return hashlib.sha256(repr(versions(FLOWN_WITH)).encode())


def _is_text(node: ast.AST) -> bool:
    value = getattr(node, "value", None) if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)
