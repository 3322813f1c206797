"""Makes a process load kernels from coflight's cache, also if it has imported Numba before."""

import os
import sys
from typing import Any

from foundation.kernels.cache_folder import LOCATORS, PACKAGES, VARIABLE, environment


def use_kernel_cache() -> None:
    """Make this process and its children load kernels from the cache that all processes of a run use.

    Numba reads the environment when it is imported, and fixes a kernel's cache when its module is; a program
    may have imported both before. Raises `foundation.kernels.cache_trust.UntrustedCache`.
    """
    named = environment()
    os.environ.update(named)
    numba: Any = sys.modules.get("numba")
    if numba is None:
        return
    config = vars(numba.config)
    if config["CACHE_DIR"] == named[VARIABLE]:
        return
    config["CACHE_DIR"] = named[VARIABLE]
    if LOCATORS in named:
        config[LOCATORS.removeprefix("NUMBA_")] = named[LOCATORS]
    from numba.core.dispatcher import Dispatcher  # noqa: PLC0415  loaded already

    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in PACKAGES:
            for value in vars(module).values():
                if isinstance(value, Dispatcher) and value.__module__ == name:
                    value.enable_caching()
