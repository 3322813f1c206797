"""Solution of small systems of linear equations in kernels.

Numba's ``linalg.solve`` takes a fifth of the antenna's compile time, and raises if a matrix is singular.
"""

import numpy as np

from antenna.model.geometry import Complex
from foundation.kernels.inner import inner


@inner
def eliminate(matrix: Complex, right: Complex) -> None:
    """Replace ``right`` (n, m) by the solution of ``matrix`` (n, n) x = ``right``; overwrites the matrix.

    Gaussian elimination with partial pivoting (Golub, Van Loan: Matrix Computations, 4th edition, 3.4). The
    solution of a singular system is not finite.
    """
    n, m = right.shape
    for k in range(n):
        pivot, largest = k, -1.0
        for i in range(k, n):
            size = abs(matrix[i, k].real) + abs(matrix[i, k].imag)
            if size > largest:
                pivot, largest = i, size
        if pivot != k:
            for j in range(k, n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for j in range(m):
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        inverse = 1.0 / matrix[k, k] if largest > 0.0 else complex(np.nan, np.nan)
        for i in range(k + 1, n):
            factor = matrix[i, k] * inverse
            for j in range(k + 1, n):
                matrix[i, j] -= factor * matrix[k, j]
            for j in range(m):
                right[i, j] -= factor * right[k, j]
        matrix[k, k] = inverse
    for k in range(n - 1, -1, -1):
        for j in range(m):
            right[k, j] *= matrix[k, k]
        for i in range(k):
            for j in range(m):
                right[i, j] -= matrix[i, k] * right[k, j]
