"""Arrays that a compiled function borrows: the caller's memory, and nobody counts. 2 s."""

import sys

import numpy as np
from numba import njit

from netsim.mac.borrowed import borrowed


@njit
def fill(array, row):
    """Write to a row as the air's functions do, by views of views; returns what another view reads of it."""
    array = borrowed(array)
    view = array[row * 4 : row * 4 + 4]
    view[:2] = row
    view[2:].view(np.float64)[:] = 0.5
    return array[4:].view(np.float64)[2]


def test_what_is_written_to_views_of_it_is_in_the_callers_array():
    array = np.zeros(12, np.int64)
    assert fill(array, 1) == 0.5
    assert array.tolist()[:6] == [0, 0, 0, 0, 1, 1]
    assert array[6:8].view(np.float64).tolist() == [0.5, 0.5]


def test_the_callers_array_lives_on_and_ends_with_its_last_owner():
    array = np.zeros(12, np.int64)
    before = sys.getrefcount(array)
    for _ in range(100):
        fill(array, 2)
    assert sys.getrefcount(array) == before


@njit
def middle(array):
    return borrowed(array)[1:3]


def test_views_of_it_own_nothing():
    """Which is why none may outlive the call: Python would not know whose memory it is."""
    array = np.arange(4)
    view = middle(array)
    assert np.shares_memory(view, array)
    assert view.base is None
    assert not view.flags.owndata


def test_without_the_compiler_it_is_the_array():
    array = np.zeros(3)
    assert borrowed(array) is array
