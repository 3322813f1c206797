"""Versions of the libraries that a run's numbers come from."""

import importlib.metadata
from collections.abc import Iterable

FLOWN_WITH = ("numpy", "scipy", "numba", "pybullet", "pymavlink", "msgspec", "pyarrow", "PyNEC")
"""Another version of one of these may fly another flight, or give the same another hash."""
DISTRIBUTIONS = ("coflight", *FLOWN_WITH, "eclipse-zenoh", "matplotlib")


def versions(distributions: Iterable[str]) -> dict[str, str]:
    """Give the installed version of each by its name."""
    found = {}
    for name in distributions:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found
