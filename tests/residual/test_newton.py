"""Newton on rows that are stiffer in the middle of their way: full corrections go round in circles there."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax.residual import Unknowns, newton_until

#: Places of the steep parts, and how much steeper they are than what lies before and after.
STEEP, RATIO = np.array([0.3, -0.2]), 20.0


def rows(u: Unknowns) -> Unknowns:
    """Two rows, each with a steep part 0.02 wide about its root, coupled a little."""
    x = u.x - STEEP
    return Unknowns(x + RATIO * jnp.clip(x, -0.01, 0.01) + 0.05 * x[::-1], jnp.zeros(1))


PROBLEM = SimpleNamespace(
    residual=rows, evaluate=lambda u: (rows(u), u.x), row_scale=lambda: Unknowns(jnp.ones(2), jnp.ones(1))
)


class Exact:
    """The exact Jacobian."""

    def factor(self, problem: SimpleNamespace, u: Unknowns) -> jax.Array:
        return jax.jacfwd(lambda x: problem.residual(Unknowns(x, u.y)).x)(u.x)

    def apply(self, factor: jax.Array, residual: Unknowns) -> Unknowns:
        return Unknowns(jnp.linalg.solve(factor, residual.x), residual.y)


def start(x: list[float]) -> Unknowns:
    return Unknowns(jnp.array(x), jnp.zeros(1))


def test_full_corrections_circle() -> None:
    """What the search is for: without it the rows stay where they are, however often they are corrected."""
    u, sizes, solver = start([0.7, 0.4]), [], Exact()
    for _ in range(12):
        du = solver.apply(solver.factor(PROBLEM, u), rows(u))
        u = Unknowns(u.x - du.x, u.y)
        sizes.append(float(jnp.abs(rows(u).x).max()))
    assert min(sizes[4:]) > 0.1


@pytest.mark.parametrize("x", [[0.7, 0.4], [-3.0, 2.0], [0.31, 5.0]])
def test_circles_are_left(x: list[float]) -> None:
    u, size, seen = newton_until(PROBLEM, Exact(), start(x), 16, 1e-12)
    assert float(size) < 1e-12
    np.testing.assert_allclose(u.x, STEEP, atol=1e-12)
    np.testing.assert_array_equal(seen, u.x)  # what is handed on was seen where the iteration ended


def test_a_batch_in_which_one_circles() -> None:
    """The others end where they would alone, bit for bit."""
    starts = jnp.array([[0.7, 0.4], [0.301, -0.201]])
    alike = jax.vmap(lambda x: newton_until(PROBLEM, Exact(), Unknowns(x, jnp.zeros(1)), 16, 1e-12))
    together, sizes, _ = alike(starts)
    alone = [newton_until(PROBLEM, Exact(), start(x.tolist()), 16, 1e-12)[0].x for x in starts]
    assert float(jnp.max(sizes)) < 1e-12
    np.testing.assert_allclose(together.x, jnp.stack(alone), atol=1e-15)
