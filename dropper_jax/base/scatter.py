"""Sums at indices known when a program is traced, as gathers: a scatter prevents a run from becoming one kernel."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.renamed import old_names


def scatter_add(where: np.ndarray, values: jax.Array | np.ndarray, size: int) -> jax.Array:
    """`zeros(size, ...)` with `values` (k, ...) added at the rows `where` (k,)."""
    where = np.asarray(where)
    counts = np.bincount(where, minlength=size)
    if isinstance(values, np.ndarray):
        found = np.zeros((size, *values.shape[1:]), values.dtype)
        np.add.at(found, where, values)
        return jnp.asarray(found, values.dtype)
    if not len(where):
        return jnp.zeros((size, *values.shape[1:]), values.dtype)
    if len(where) == size and counts.max() == 1:
        return values if (where == np.arange(size)).all() else values[np.argsort(where)]
    order = np.argsort(where, kind="stable")
    first = np.cumsum(counts) - counts
    padded = jnp.concatenate([values, jnp.zeros_like(values[:1])])
    nothing = len(where)
    terms = []
    for k in range(counts.max()):
        there = counts > k
        terms.append(padded[np.where(there, order[np.where(there, first + k, 0)], nothing)])
    return sum(terms[1:], terms[0])


def scatter_add_many(where: np.ndarray, values: jax.Array, size: int) -> jax.Array:
    """`scatter_add`, using a scatter if many values meet at one row, as in contact between all pairs of links."""
    where = np.asarray(where)
    # maximum number of values per row for which gathers are used: each is a separate operation
    if not len(where) or np.bincount(where, minlength=size).max() <= 8:
        return scatter_add(where, values, size)
    return jnp.zeros((size, *values.shape[1:]), values.dtype).at[where].add(values)


__getattr__ = old_names(__name__)
