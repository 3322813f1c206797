"""Functions that only kernels call, and constants that kernels pass to them."""

import os
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar, cast

import numpy as np
from numba.core.registry import CPUDispatcher

F = TypeVar("F", bound=Callable[..., object])
_OPTIONS = {"nopython": True, "boundscheck": None, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class _Inner(CPUDispatcher):
    """A compiled function without an entry point for Python: calling that would crash the interpreter."""

    def __call__(self, *_: object, **__: object) -> NoReturn:
        raise TypeError(f"{self.py_func.__qualname__} is only called by kernels")


def inner(function: F) -> F:
    """Compile a function that only kernels call, like ``njit(cache=True)``.

    It has no entry points for Python and C, which take a fifth of the compile time of a small function.
    Called from Python it raises TypeError, unless kernels are not compiled (``NUMBA_DISABLE_JIT``).
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return function
    dispatcher: Any = _Inner(function, targetoptions=dict(_OPTIONS))
    dispatcher.enable_caching()
    return dispatcher  # type: ignore[no-any-return]


def constant(value: int) -> int:
    """Return a number as a NumPy integer; as a literal, a kernel is compiled again for each value of it."""
    return cast("int", np.int64(value))
