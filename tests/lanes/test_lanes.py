"""Members side by side: the same results as `jax.vmap`, for every operation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from dropper_jax.lanes import lanes
from dropper_jax.lanes.rules import STRUCTURAL

X = np.linspace(0.3, 2.0, 5 * 3 * 4).reshape(5, 3, 4)
SHARED = np.linspace(-1.0, 1.0, 4)


def axes(x, c):
    return x.T @ x[:, 0], jnp.pad(x, ((1, 0), (0, 2)))[::2, ::-1], x.reshape(2, 6).transpose(), jnp.stack([x, x * c], 1)


def reductions(x, c):
    return x.sum(), (x + c).max(axis=0), x.min(axis=(0, 1)), (x > c).all(axis=1), (x > 1).any(), x.argmax(), jnp.prod(x)


def indexing(x, c):
    i = jnp.argmin(jnp.abs(x[0] - c))
    return x[:, 1], x.at[1, 2].set(c[0]), x[i % 3], lax.dynamic_slice(c, (i,), (2,)), jnp.where(x > c, x, c)[..., None]


def loops(x, c):
    """A counter that all members share, one that they do not, and a carry that becomes a member's own on the way."""
    powers, rows = lax.scan(lambda a, b: (a * 0.5 + b, a), c, x, reverse=True)
    shared = lax.fori_loop(0, 3, lambda i, a: a + x[0] * i, jnp.zeros(4))
    own = lax.while_loop(lambda a: a[0] < 10.0, lambda a: (a[0] * (1.1 + x[0, 0]), a[1] + 1), (x.sum(), 0))
    return powers, rows, shared, own


def loops_of_vmap(x, c):
    """A batch inside a member, whose loop goes on until the last of the batch stops."""

    def halved(row):
        return lax.while_loop(lambda a: a.sum() > 1.0, lambda a: a * 0.5, row)

    return jax.vmap(halved)(x * 3.0), jax.vmap(lambda row: lax.fori_loop(0, 2, lambda i, a: a + row * c, row))(x)


def branches(x, c):
    shared = lax.cond(c[0] < 0, lambda a: a * c, lambda a: a + 1.0, x)
    own = lax.switch((x[0, 0] * 2).astype(int), [lambda a: a, lambda a: -a, lambda a: a * a, lambda a: a * 3.0], x)
    return shared, own, c * 2.0


def derivatives(x, c):
    value, slope = jax.value_and_grad(lambda a: jnp.sum(jnp.sin(a) * c) ** 2)(x)
    return value, slope, jax.jvp(jax.jit(jnp.tanh), (x,), (x * c,))[1]


@pytest.mark.parametrize("f", [axes, reductions, indexing, loops, loops_of_vmap, branches, derivatives])
def test_as_vmap(f):
    found, expected = (jax.jit(each(f, in_axes=(0, None)))(X, SHARED) for each in (lanes, jax.vmap))
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert a.shape == b.shape
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-15)


def test_loops_and_branches_are_not_left_to_vmap(monkeypatch):
    """The way back to `vmap`, for a JAX that names things otherwise, is not taken with this one."""
    monkeypatch.setattr(jax, "vmap", lambda *_, **__: pytest.fail("left to vmap"))
    for f in (loops, branches):
        jax.make_jaxpr(lanes(f, in_axes=(0, None)))(X, SHARED)


def test_operations_without_a_rule_are_those_of_vmap():
    def f(x):
        return jnp.cumsum(jnp.sin(x)), jnp.sort(x * 2)

    for found, expected in zip(lanes(f)(X), jax.vmap(f)(X), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_an_operation_written_in_a_new_way_leaves_all_to_vmap_and_is_named(monkeypatch):
    def renamed(p, members, inputs):
        return p["no_such_parameter"]

    monkeypatch.setitem(STRUCTURAL, "transpose", renamed)
    with pytest.warns(RuntimeWarning, match="'transpose'"):
        found = lanes(axes, in_axes=(0, None))(X, SHARED)
    for a, b in zip(found, jax.vmap(axes, in_axes=(0, None))(X, SHARED), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_fault_in_a_rule_is_no_reason_to_leave_all_to_vmap(monkeypatch):
    def faulty(p, members, inputs):
        return {}["no_such_key"]

    monkeypatch.setitem(STRUCTURAL, "transpose", faulty)
    with pytest.raises(KeyError, match="no_such_key"):
        lanes(axes, in_axes=(0, None))(X, SHARED)


def test_a_batch_without_a_mapped_argument_is_refused():
    with pytest.raises(ValueError, match="at least one argument must be mapped"):
        lanes(axes, in_axes=None)(X[0], SHARED)
