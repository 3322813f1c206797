"""Versions of the libraries that affect a run's results."""

import importlib.metadata
from collections.abc import Iterable

FLOWN_WITH = ("numpy", "scipy", "numba", "pybullet", "pymavlink", "msgspec", "pyarrow", "PyNEC")
"""Another version of one of these may change a flight or its hash."""
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
