"""Solutions of the kernels' linear algebra, compared with NumPy's."""

import numpy as np
import pytest
from numba import njit

from antenna.solvers.batch import linear_algebra


@njit
def eliminate(matrix, right):
    linear_algebra.eliminate(matrix, right)


def draw(rng, *shape):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 3), (21, 4), (60, 12)])
def test_elimination_solves_as_numpy_does(n, m):
    rng = np.random.default_rng(n)
    matrix, right = draw(rng, n, n), draw(rng, n, m)
    expected = np.linalg.solve(matrix, right)
    solution = right.copy()
    eliminate(matrix.copy(), solution)
    np.testing.assert_allclose(solution, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


def test_pivots_are_exchanged():
    """Without exchanges the first pivot is zero, and the second of the graded matrix loses all digits."""
    swapped = np.array([[0.0, 1.0], [1.0, 0.0]], complex)
    solution = np.array([[2.0], [3.0]], complex)
    eliminate(swapped, solution)
    np.testing.assert_array_equal(solution, [[3.0], [2.0]])
    graded = np.array([[1e-20, 1.0], [1.0, 1.0]], complex)
    solution = np.array([[1.0], [2.0]], complex)
    eliminate(graded, solution)
    np.testing.assert_allclose(solution, [[1.0], [1.0]], rtol=1e-15)


def test_a_singular_system_has_no_finite_solution():
    solution = np.ones((3, 1), complex)
    eliminate(np.ones((3, 3), complex), solution)
    assert not np.isfinite(solution).any()
