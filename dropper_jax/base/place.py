"""Sums at places that are known when a program is traced, as gathers: a scatter keeps a run from being one kernel."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np


def place(where: np.ndarray, values: jax.Array, size: int) -> jax.Array:
    """`zeros(size, ...)` with `values` (k, ...) added at the rows `where` (k,)."""
    where = np.asarray(where)
    counts = np.bincount(where, minlength=size)
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
