"""The linear system of the points where lines join, once the lines between them are eliminated."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from dropper_jax.solvers.blocks import solve_tridiagonal
from dropper_jax.solvers.layout import PointMatrix


def solve_points(table: PointMatrix, values: list[jax.Array], load: jax.Array) -> jax.Array:
    """Moves (points, 3) of the points under `load` (points, 3), from contributions (..., 3, 3) in order."""
    blocks, width, dtype = table.blocks, table.width, load.dtype
    entries = jnp.zeros((blocks * 3 * width * width, 3, 3), dtype)
    entries = entries.at[table.entry].add(jnp.concatenate(values)[table.kept])
    if len(table.unused):
        block, slot = table.unused // width, table.unused % width
        empty = ((block * 3 + 1) * width + slot) * width + slot
        entries = entries.at[empty].set(jnp.eye(3, dtype=dtype))
    matrix = entries.reshape(blocks, 3, width, width, 3, 3).transpose(1, 0, 2, 4, 3, 5)
    matrix = matrix.reshape(3, 1, blocks, 3 * width, 3 * width)
    placed = jnp.zeros((blocks * width, 3), dtype).at[table.order].set(load)
    answer = solve_tridiagonal(*matrix, placed.reshape(1, blocks, 3 * width, 1))
    return answer.reshape(-1, 3)[table.order]
