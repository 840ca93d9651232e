"""Factors of symmetric positive definite matrices: block-tridiagonal ones, and nearly singular information matrices."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky


class Factor:
    """Cholesky of a block-tridiagonal matrix: diagonal blocks (K, m, m), blocks (K - 1, m, m) left of the next."""

    def __init__(self, diagonal: np.ndarray, below: np.ndarray) -> None:
        self.below = below
        self.factors = [cho_factor(diagonal[0], lower=True)]
        for block, coupling in zip(diagonal[1:], below, strict=True):
            block = block - coupling @ cho_solve(self.factors[-1], coupling.T)
            self.factors.append(cho_factor(block, lower=True))
        self.log_determinant = sum(2 * np.sum(np.log(np.diag(factor))) for factor, _ in self.factors)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """The solution for right-hand sides (K, m, c)."""
        x = np.array(rhs)
        for k in range(1, len(x)):
            x[k] -= self.below[k - 1] @ cho_solve(self.factors[k - 1], x[k - 1])
        x[-1] = cho_solve(self.factors[-1], x[-1])
        for k in range(len(x) - 2, -1, -1):
            x[k] = cho_solve(self.factors[k], x[k] - self.below[k].T @ x[k + 1])
        return x

    def inverse_diagonal(self) -> np.ndarray:
        """Diagonal blocks (K, m, m) of the inverse: `G_k = P_k^-1 + P_k^-1 B_k' G_{k+1} B_k P_k^-1`, P the pivots."""
        one = np.eye(len(self.factors[0][0]))
        found = [cho_solve(self.factors[-1], one)]
        for k in range(len(self.factors) - 2, -1, -1):
            back = cho_solve(self.factors[k], self.below[k].T)
            found.append(cho_solve(self.factors[k], one) + back @ found[-1] @ back.T)
        return np.array(found[::-1])


#: Values added to the diagonal of a scaled information matrix; the first that makes it positive definite is used.
#: Eliminating starts that a stuck joint leaves undetermined loses digits.
FLOORS = (1e-12, 1e-9, 1e-6, 1e-3, 1.0)


def cholesky_root(scaled: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor of a matrix with diagonal 1; unidentifiable parameters make it rank deficient."""
    for floor in FLOORS:
        try:
            return cholesky(scaled + floor * np.eye(len(scaled)), lower=True)
        except LinAlgError:
            continue
    return np.eye(len(scaled))


def scale_diagonal(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A symmetric matrix (k, k) with its diagonal scaled to 1, and the factors (k,) of its rows and columns."""
    size = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return matrix * np.outer(size, size), size


def solve_spd(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solve with a symmetric positive definite matrix, its diagonal scaled to 1."""
    scaled, size = scale_diagonal(matrix)
    factor = cho_factor(scaled + 1e-13 * np.eye(len(size)))
    found = cho_solve(factor, (rhs.T * size).T)
    return (found.T * size).T


def invert_spd(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix, also of an empty one."""
    if len(matrix):
        return solve_spd(matrix, np.eye(len(matrix)))
    return matrix


def eliminate_rows(information: np.ndarray, eliminated: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Information (r, r) of the numbers `rows` with the numbers `eliminated` eliminated (Schur complement)."""
    if not len(eliminated):
        return information[np.ix_(rows, rows)]
    cross = information[np.ix_(eliminated, rows)]
    return information[np.ix_(rows, rows)] - cross.T @ solve_spd(information[np.ix_(eliminated, eliminated)], cross)
