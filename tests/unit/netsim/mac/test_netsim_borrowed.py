"""Arrays without reference counting in compiled functions. 2 s."""

import sys

import numpy as np
from numba import njit

from netsim.mac.borrowed import borrowed


@njit
def fill(array, row):
    """Write to a row through views of views, as the kernels; return the value read through another view."""
    array = borrowed(array)
    view = array[row * 4 : row * 4 + 4]
    view[:2] = row
    view[2:].view(np.float64)[:] = 0.5
    return array[4:].view(np.float64)[2]


def test_writes_to_views_modify_the_callers_array():
    array = np.zeros(12, np.int64)
    assert fill(array, 1) == 0.5
    assert array.tolist()[:6] == [0, 0, 0, 0, 1, 1]
    assert array[6:8].view(np.float64).tolist() == [0.5, 0.5]


def test_callers_array_is_freed_with_its_last_owner():
    array = np.zeros(12, np.int64)
    before = sys.getrefcount(array)
    for _ in range(100):
        fill(array, 2)
    assert sys.getrefcount(array) == before


@njit
def middle(array):
    return borrowed(array)[1:3]


def test_views_have_no_owner():
    """So no view may outlive the call: it does not keep the memory alive."""
    array = np.arange(4)
    view = middle(array)
    assert np.shares_memory(view, array)
    assert view.base is None
    assert not view.flags.owndata


def test_uncompiled_code_returns_the_array_itself():
    array = np.zeros(3)
    assert borrowed(array) is array
