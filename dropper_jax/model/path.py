"""One line between two points as a path of nodes: differences over its links, sums at its nodes."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def stack_nodes(free: jax.Array, start: jax.Array, end: jax.Array | None) -> jax.Array:
    """All nodes of a line (n + 1, 3) from its free nodes and held ends."""
    rows = [start[None], free] if end is None else [start[None], free, end[None]]
    return jnp.concatenate(rows)


def link_differences(free: jax.Array, start: jax.Array | None, end: jax.Array | None, held: bool) -> jax.Array:
    """Differences over the links (n, ...) of a nodal field; a held end without a value counts as zero."""
    zero = jnp.zeros_like(free[:1])
    head = zero if start is None else start[None]
    if not held:
        return free - jnp.concatenate([head, free[:-1]])
    tail = zero if end is None else end[None]
    return jnp.concatenate([free, tail]) - jnp.concatenate([head, free])


def gather_links(pull: jax.Array, held: bool) -> jax.Array:
    """Sum on the free nodes (nodes, ...) of what links pull (n, ...): + on their first node, - on their last."""
    if held:
        return pull[1:] - pull[:-1]
    return jnp.concatenate([pull[1:], jnp.zeros_like(pull[:1])]) - pull
