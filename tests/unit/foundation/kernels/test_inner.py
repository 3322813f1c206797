"""Functions that only kernels call."""

import pytest
from numba import njit

from foundation.kernels.inner import inner


@inner
def half(x: float) -> float:
    return 0.5 * x


@njit
def quarter(x):
    return half(half(x))


def test_kernels_call_it():
    assert quarter(2.0) == 0.5


def test_a_call_from_python_is_an_error_that_names_it():
    with pytest.raises(TypeError, match="half is only called by kernels"):
        half(2.0)
