"""The installed JAX computes what it should: the cases for which versions are excluded in pyproject.toml."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import pytest


@pytest.mark.parametrize(("dtype", "n", "expected"), [("float64", 16_385, 2.0**28), ("float32", 32_769, 2.0**30)])
def test_vmapped_matrix_vector_product_with_reduction_is_right(dtype, n, expected):
    """jax-ml/jax issue 39103: 0.10.2 gave 267911424 or 266342400 for 2^28 = 268435456 on the CPU.

    Row i is (i, 0, 0), so that |I row|^2 = i^2: the last one is (n - 1)^2, exact in both precisions.
    """
    with jax.enable_x64(True):
        i = jnp.arange(n, dtype=dtype)
        rows = jnp.stack([i, 0 * i, 0 * i], axis=1)
        matrix = jnp.eye(3, dtype=dtype)
        squares = jax.jit(jax.vmap(lambda row: jnp.sum((matrix @ row) ** 2)))(rows)
        assert squares.dtype == dtype
        assert float(squares[-1]) == expected == (n - 1) ** 2
        assert bool(jnp.all(squares == i * i))
