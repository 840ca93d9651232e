"""Newton on rows that are stiffer in the middle of their way: full corrections go round in circles there."""

from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax.residual import Newton, Unknowns, newton

#: Places of the steep parts, and how much steeper they are than what lies before and after.
STEEP, RATIO = np.array([0.3, -0.2]), 20.0


def rows(u: Unknowns) -> Unknowns:
    """Two rows, each with a steep part 0.02 wide about its root, coupled a little."""
    x = u.x - STEEP
    return Unknowns(x + RATIO * jnp.clip(x, -0.01, 0.01) + 0.05 * x[::-1], jnp.zeros(1))


def problem(x: jax.Array) -> SimpleNamespace:
    """Two rows, from a guess (2,)."""
    return SimpleNamespace(
        guess=lambda: Unknowns(x, jnp.zeros(1)), residual=rows, row_scale=lambda: Unknowns(jnp.ones(2), jnp.ones(1))
    )


class Inverse(NamedTuple):
    """A matrix (2, 2) of x, one of y."""

    matrix: jax.Array

    def apply(self, residual: Unknowns) -> Unknowns:
        return Unknowns(jnp.linalg.solve(self.matrix, residual.x), residual.y)


class Exact:
    """The exact Jacobian."""

    def linearise(self, problem: SimpleNamespace, u: Unknowns) -> Inverse:
        return Inverse(jax.jacfwd(lambda x: problem.residual(Unknowns(x, u.y)).x)(u.x))


SHORTENED = Newton(Exact(), iterations=24, enough=1.0, shortened=3)


def test_full_corrections_circle() -> None:
    """What halved corrections are for: without them the rows stay where they are, however often they are corrected."""
    for count in range(4, 12):
        _, size = newton(Newton(Exact(), iterations=count), problem(jnp.array([0.7, 0.4])), 1e-12)
        assert float(size) > 0.1


@pytest.mark.parametrize("x", [[0.7, 0.4], [-3.0, 2.0], [0.31, 5.0]])
def test_circles_are_left(x: list[float]) -> None:
    u, size = newton(SHORTENED, problem(jnp.array(x)), 1e-12)
    assert float(size) < 1e-12
    np.testing.assert_allclose(u.x, STEEP, atol=1e-12)


def test_a_batch_in_which_one_circles() -> None:
    """The others end where they would alone, bit for bit."""
    starts = jnp.array([[0.7, 0.4], [0.301, -0.201]])
    together, sizes = jax.vmap(lambda x: newton(SHORTENED, problem(x), 1e-12))(starts)
    alone = [newton(SHORTENED, problem(x), 1e-12)[0].x for x in starts]
    assert float(jnp.max(sizes)) < 1e-12
    np.testing.assert_allclose(together.x, jnp.stack(alone), atol=1e-15)


def test_a_matrix_is_kept_while_the_rows_fall_fast() -> None:
    """Smooth rows: Newton by one matrix needs more corrections, and ends at the same root."""
    smooth = problem(jnp.array([0.7, 0.4]))
    smooth.residual = lambda u: Unknowns(u.x + 0.05 * jnp.sin(u.x[::-1]) - 0.3, u.y)
    ends = [newton(Newton(Exact(), 40, 1e-5, renew=renew), smooth, 1e-11) for renew in (0.0, 0.3, 1.0)]
    for u, size in ends:
        assert float(size) < 1e-15
        np.testing.assert_allclose(u.x, ends[0][0].x, atol=1e-15)


def test_a_guess_within_the_tolerance_is_left_alone_where_no_correction_is_wanted() -> None:
    root = newton(SHORTENED, problem(jnp.array([0.7, 0.4])), 1e-12)[0].x
    near = root + 1e-14
    left, _ = newton(replace(SHORTENED, least=0), problem(near), 1e-12)
    np.testing.assert_array_equal(left.x, near)


def test_rows_that_are_not_numbers_end_the_corrections() -> None:
    _, size = newton(replace(SHORTENED, iterations=10_000), problem(jnp.array([jnp.nan, 0.4])), 1e-12)
    assert np.isnan(float(size))
