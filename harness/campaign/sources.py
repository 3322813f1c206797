"""What flies, as a hash: a stored flight is of use while the sources that would fly it now are the same."""

import ast
import hashlib
from collections.abc import Collection
from pathlib import Path

ROOT = Path(__file__).parents[2]
_FLOWN_PACKAGES = ("antenna", "netsim", "autopilot", "harness")
_AFTERWARDS = ("validation", "codesign", "campaign", "article")
"""Parts of the harness that fly nothing themselves, but for modules that make a flight's numbers"""
_LABORATORIES = ("antenna/lab/", "netsim/lab/")


def hash_sources(root: Path, *, measured_by: Collection[str]) -> str:
    """Hash of what the modules that fly say: neither comments nor docstrings nor layout are in it.

    ``measured_by``: modules of the parts that fly nothing which belong to it all the same, as paths below
    ``root/harness``. Raises OSError, SyntaxError.
    """
    paths = [path for package in _FLOWN_PACKAGES for path in sorted((root / package).rglob("*.py"))]
    content = hashlib.sha256()
    for path in paths:
        name = path.relative_to(root).as_posix()
        if name.startswith(_LABORATORIES):
            continue
        part = name.removeprefix("harness/")
        if part.partition("/")[0] in _AFTERWARDS and part not in measured_by:
            continue
        tree = ast.parse(path.read_bytes())
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
        content.update(name.encode() + b"\0" + ast.dump(tree).encode())
    return content.hexdigest()


def _is_text(node: ast.AST) -> bool:
    value = getattr(node, "value", None) if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)
