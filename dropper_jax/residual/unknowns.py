"""The unknowns of a step and the rows that determine them."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp


class Unknowns(NamedTuple):
    """Unknowns of a step, or its rows, or sizes of either.

    Attributes:
        x: per free node, (nodes, 3).
        y: per link, (n,): tensions; as rows: the axial laws.
        z: per law of an effect, (joints, c) each.
    """

    x: jax.Array
    y: jax.Array
    z: tuple[jax.Array, ...] = ()


def add(a: Unknowns, b: Unknowns, factor: float = 1.0) -> Unknowns:
    """a + factor b."""
    return jax.tree.map(lambda p, q: p + factor * q, a, b)


def norm(rows: Unknowns, scale: Unknowns) -> jax.Array:
    """Maximum scaled entry, a scalar; NaN if any entry is."""
    sizes = [jnp.max(jnp.abs(r) / s) for r, s in zip(jax.tree.leaves(rows), jax.tree.leaves(scale), strict=True)]
    return jnp.max(jnp.stack(sizes))
