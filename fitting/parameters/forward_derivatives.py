"""Trees of arrays as functions of parameters, with their derivatives along directions.

Functions are differentiated one after the other, so that JAX differentiates one step of a run and not the loop around
it: a third of the time of tracing, and the loop can be part of one kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike


class WithSlopes(NamedTuple):
    """A tree of arrays as a function of parameters: its values, and derivatives (k, ...) of its floats along k
    directions."""

    tree: Any
    slopes: Sequence[Array | np.ndarray]


def floats_of(tree: Any) -> list[Array]:
    """The leaves that have derivatives."""
    return [x for x in jax.tree.leaves(tree) if _is_float(x)]


def _is_float(leaf: ArrayLike) -> bool:
    """Whether a leaf has derivatives."""
    return jnp.issubdtype(jnp.result_type(leaf), jnp.inexact)


def _with_floats(tree: Any, values: list[Array]) -> Any:
    """The tree with these values instead of `floats_of(tree)`."""
    leaves, form = jax.tree.flatten(tree)
    new = iter(values)
    for i, leaf in enumerate(leaves):
        if _is_float(leaf):
            leaves[i] = next(new)
    return form.unflatten(leaves)


def differentiate(function: Callable[..., Any], values: Array, directions: Array, *given: WithSlopes) -> WithSlopes:
    """`function(values, *trees)` with its derivatives along directions (k, p) of the values (p,), of which the trees
    are functions too."""

    if not len(directions):
        found = function(values, *(one.tree for one in given))
        return WithSlopes(found, [jnp.zeros((0, *x.shape), x.dtype) for x in floats_of(found)])

    def at(p: Array, *floats: list[Array]) -> tuple[list[Array], Any]:
        trees = (_with_floats(one.tree, new) for one, new in zip(given, floats, strict=True))
        found = function(p, *trees)
        return floats_of(found), found

    def along(*direction: Any) -> WithSlopes:
        _, slopes, found = jax.jvp(at, (values, *(floats_of(one.tree) for one in given)), direction, has_aux=True)
        return WithSlopes(found, slopes)

    slopes = (list(one.slopes) for one in given)
    return jax.vmap(along, out_axes=WithSlopes(None, 0))(directions, *slopes)


def split(varied: WithSlopes) -> tuple[WithSlopes, WithSlopes]:
    """The two parts of a pair of trees."""
    first, second = varied.tree
    count = len(floats_of(first))
    return WithSlopes(first, varied.slopes[:count]), WithSlopes(second, varied.slopes[count:])


def swap_rows(rows: WithSlopes) -> WithSlopes:
    """Rows (m, ...) with derivatives (k, m, ...) from those of single rows (m, k, ...), and the reverse."""
    return WithSlopes(rows.tree, [jnp.swapaxes(x, 0, 1) for x in rows.slopes])
