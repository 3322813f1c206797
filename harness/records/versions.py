"""What a run is flown with: versions of the libraries, and the commit of coflight's sources."""

import importlib.metadata
import os
import subprocess
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from msgspec import Struct

from foundation.extensions import ExtensionError, is_path, registered

ROOT = Path(__file__).parents[2]
"""Folder of coflight's packages: a checkout, or where a wheel is installed"""

FLOWN_WITH = ("numpy", "scipy", "numba", "pybullet", "pymavlink", "msgspec", "pyarrow", "PyNEC")
"""Another version of one of these may change a flight or its hash."""
GIT_LIMIT_S = 5.0
"""Time after which a run starts without the commit"""
DISTRIBUTIONS = ("coflight", *FLOWN_WITH, "eclipse-zenoh", "matplotlib")


def versions(distributions: Iterable[str]) -> dict[str, str]:
    """Return the installed version of each distribution by name."""
    found = {}
    for name in distributions:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def origin_of(name: str, group: str) -> dict[str, str | None]:
    """Return what is known of code of the user: its path, the distribution that it is in, and its version.

    ``name`` is ``package.module:Name`` or the name of an entry point of ``group``. None: not known.
    """
    found: dict[str, str | None] = {"name": name, "path": None, "distribution": None, "version": None}
    try:
        found["path"] = name if is_path(name) else registered(group).get(name)
    except ExtensionError:  # two distributions have the name, since the flight
        return found
    if found["path"] is not None:
        package = found["path"].partition(":")[0].partition(".")[0]
        for distribution in importlib.metadata.packages_distributions().get(package, ())[:1]:
            found |= {"distribution": distribution, "version": importlib.metadata.version(distribution)}
    return found


class Checkout(Struct, frozen=True, kw_only=True):
    """State of the checkout that coflight runs from."""

    commit: str
    """Full hash"""
    dirty: bool
    """Files that git tracks are changed; files that it does not track do not count"""


@cache
def checkout(root: Path = ROOT) -> Checkout | None:
    """Return the state of the checkout at ``root``; None for an installed wheel, without git or a commit.

    It is read once: a process runs the sources that it has loaded.
    """
    if not (root / ".git").exists():
        return None  # a wheel may be installed below the checkout of another project
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        described = subprocess.run(
            command,
            env=environment | {"GIT_OPTIONAL_LOCKS": "0"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=True,
            timeout=GIT_LIMIT_S,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    commit, _, dirty = described.stdout.strip().partition("-")
    return Checkout(commit=commit, dirty=bool(dirty))
