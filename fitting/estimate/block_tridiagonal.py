"""Cholesky factorisation of block-tridiagonal matrices, as they result from windows joined in a row."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve


class Factor:
    """Cholesky of a block-tridiagonal matrix: diagonal blocks (K, m, m), blocks (K - 1, m, m) left of the next."""

    def __init__(self, diagonal: np.ndarray, below: np.ndarray) -> None:
        self.below, self.factors = below, []
        self.log_determinant = 0.0
        block = diagonal[0]
        for k in range(len(diagonal)):
            if k:
                block = diagonal[k] - below[k - 1] @ cho_solve(self.factors[-1], below[k - 1].T)
            self.factors.append(cho_factor(block, lower=True))
            self.log_determinant += 2 * float(np.sum(np.log(np.diag(self.factors[-1][0]))))

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
