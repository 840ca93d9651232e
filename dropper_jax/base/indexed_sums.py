"""Sums at indices known when a program is traced, as gathers: a scatter prevents a run from becoming one kernel."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array


def index_table(lists: Sequence[Sequence[int] | np.ndarray], none: int) -> np.ndarray:
    """Lists of unequal length as columns (most, lists), filled with `none`."""
    table = np.full((max(map(len, lists), default=0), len(lists)), none)
    for column, numbers in zip(table.T, lists, strict=True):
        column[: len(numbers)] = numbers
    return table


def with_zero_row(a: Array) -> Array:
    """Rows (n + 1, ...), the last one zero."""
    return jnp.concatenate([a, jnp.zeros_like(a, shape=(1, *a.shape[1:]))])


def gather_sums(a: Array, table: np.ndarray) -> Array:
    """Sums (m, ...) of the rows of a (n, ...) that a static table (most, m) lists; the index n is a zero row."""
    if not len(table):
        return jnp.zeros((table.shape[1], *a.shape[1:]), a.dtype)
    a = with_zero_row(a)
    return sum((a[row] for row in table[1:]), a[table[0]])


def scatter_add(where: np.ndarray, values: Array | np.ndarray, size: int) -> Array:
    """`zeros(size, ...)` with `values` (k, ...) added at the rows `where` (k,)."""
    where = np.asarray(where)
    counts = np.bincount(where, minlength=size)
    if isinstance(values, np.ndarray):
        found = np.zeros((size, *values.shape[1:]), values.dtype)
        np.add.at(found, where, values)
        return jnp.asarray(found, values.dtype)
    if np.all(counts == 1):
        if np.array_equal(where, np.arange(size)):
            return values
        return values[np.argsort(where)]
    order = np.argsort(where, kind="stable")
    return gather_sums(values, index_table(np.split(order, np.cumsum(counts)[:-1]), len(where)))


#: Maximum number of values per row for which gathers are used: each is a separate operation.
MAX_GATHERS = 8


def scatter_add_many(where: np.ndarray, values: Array, size: int) -> Array:
    """`scatter_add`, using a scatter if many values meet at one row, as in contact between all pairs of links."""
    if np.bincount(where, minlength=size).max(initial=0) <= MAX_GATHERS:
        return scatter_add(where, values, size)
    return jnp.zeros((size, *values.shape[1:]), values.dtype).at[where].add(values)
