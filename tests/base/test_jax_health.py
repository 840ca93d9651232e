"""The installed JAX computes what it should: the cases for which versions are excluded in pyproject.toml."""

import pytest

#: |I row|^2 of the rows (i, 0, 0) is i^2: whether all are, and the last.
REPRODUCER = """
import json, sys
import jax
import jax.numpy as jnp
dtype, n = sys.argv[1], int(sys.argv[2])
jax.config.update("jax_enable_x64", True)
i = jnp.arange(n, dtype=dtype)
rows = jnp.stack([i, 0 * i, 0 * i], axis=1)
matrix = jnp.eye(3, dtype=dtype)
squares = jax.jit(jax.vmap(lambda row: jnp.sum((matrix @ row) ** 2)))(rows)
print(json.dumps([str(squares.dtype), float(squares[-1]), bool(jnp.all(squares == i * i))]))
"""


@pytest.mark.parametrize(("dtype", "n", "expected"), [("float64", 16_385, 2.0**28), ("float32", 32_769, 2.0**30)])
def test_vmapped_matrix_vector_product_with_reduction_is_right(as_a_user, dtype, n, expected):
    """jax-ml/jax issue 39103: 0.10.2 gave 267911424 or 266342400 for 2^28 = 268435456 on the CPU.

    The last row gives (n - 1)^2, exact in both precisions. Compiled as users get it, since the fault is the compiler's.
    """
    assert (n - 1) ** 2 == expected
    assert as_a_user(REPRODUCER, dtype, str(n)) == [dtype, expected, True]
