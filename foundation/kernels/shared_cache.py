"""Loads kernels from a cache that this user cannot write, such as that of an installation for all users.

Numba takes a cache for unusable if it cannot create a file in it, and compiles every kernel again in each
process. `foundation.kernels.cache_folder` names `SharedCacheLocator` to Numba for such a folder (`LOCATORS`).
What the cache lacks is compiled in each process and not kept.
"""

import contextlib
import os
from typing import Any

from numba.core import caching


class SharedCacheLocator(caching.UserProvidedCacheLocator):
    """Finds the kernels of the modules that the cache has; the others are cached as Numba does by itself."""

    def ensure_cache_path(self) -> None:
        """Raise OSError if the cache has no kernel of this module."""
        if not os.path.isdir(self.get_cache_path()):  # type: ignore[no-untyped-call]  # noqa: PTH112
            raise FileNotFoundError


class _ReadOnlyFile(caching.IndexDataCacheFile):
    """Numba's file of the kernels of one function; a kernel that cannot be written is not kept."""

    def save(self, key: Any, data: Any) -> None:  # noqa: ANN401  numba's types
        with contextlib.suppress(OSError):
            super().save(key, data)  # type: ignore[no-untyped-call]


caching.IndexDataCacheFile = _ReadOnlyFile  # type: ignore[misc]
