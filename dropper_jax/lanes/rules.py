"""Operations on arrays whose member axis comes last: rules for all operations except loops and branches.

Elementwise operations need aligned arrays. Operations on axes treat the member axis as one more axis and leave it
unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from dropper_jax.lanes.parameters import Parameters


class Value(NamedTuple):
    """An array, and whether it has the member axis (the last one)."""

    array: Array
    has_members: bool


#: Parameters, number of members, inputs -> the result; None if the rule does not apply.
Rule = Callable[[Parameters, int, list[Value]], Array | None]


def with_members(v: Value, members: int) -> Array:
    """The array with the member axis, repeated if it had none."""
    x = jnp.asarray(v.array)
    if v.has_members:
        return x
    return jnp.broadcast_to(x[..., None], (*x.shape, members))


def aligned(v: Value, shape: tuple[int, ...], members: int) -> Array:
    """The array in the result's shape, members last; scalars and axes of length one may be used unexpanded."""
    x = jnp.asarray(v.array)
    if not v.has_members:
        x = x[..., None]
    x = x.reshape((1,) * (len(shape) + 1 - x.ndim) + x.shape)
    return jnp.broadcast_to(x, (*shape, members))


def _broadcast(p: Parameters, members: int, inputs: list[Value]) -> Array | None:
    if len(inputs) > 1:  # shapes that are known at run time only
        return None
    rank = len(p["shape"])
    return lax.broadcast_in_dim(inputs[0].array, (*p["shape"], members), (*p["broadcast_dimensions"], rank))


def _slice(p: Parameters, members: int, inputs: list[Value]) -> Array:
    strides = (*(p["strides"] or [1] * len(p["start_indices"])), 1)
    return lax.slice(inputs[0].array, (*p["start_indices"], 0), (*p["limit_indices"], members), strides)


def _pad(p: Parameters, members: int, inputs: list[Value]) -> Array | None:
    x, value = inputs
    if value.has_members:
        return None
    return lax.pad(with_members(x, members), value.array, (*p["padding_config"], (0, 0, 0)))


def _reshape(p: Parameters, members: int, inputs: list[Value]) -> Array | None:
    if p["dimensions"] is None:
        return lax.reshape(inputs[0].array, (*p["new_sizes"], members))
    return None


#: Maximum length of a reduction done as a tree of elementwise operations.
LONGEST_TREE = 128


def _reduced_by(two: Callable[[Array, Array], Array]) -> Rule:
    """Reduction over some axes as a tree of elementwise operations, which still run over the members."""

    def rule(p: Parameters, members: int, inputs: list[Value]) -> Array | None:
        axes = tuple(p["axes"])
        x = jnp.moveaxis(inputs[0].array, axes, range(len(axes)))
        x = x.reshape(-1, *x.shape[len(axes) :])
        if not 0 < len(x) <= LONGEST_TREE:
            return None
        while len(x) > 1:
            half = len(x) // 2
            x = jnp.concatenate([two(x[:half], x[half : 2 * half]), x[2 * half :]])
        return x[0]

    return rule


def _concatenate(p: Parameters, members: int, inputs: list[Value]) -> Array:
    return lax.concatenate([with_members(v, members) for v in inputs], p["dimension"])


def _stack(p: Parameters, members: int, inputs: list[Value]) -> Array:
    return jnp.stack([with_members(v, members) for v in inputs], p["axis"])


def _transpose(p: Parameters, members: int, inputs: list[Value]) -> Array:
    permutation = p["permutation"]
    return jnp.transpose(inputs[0].array, (*permutation, len(permutation)))


#: Rules by the names of the operations.
STRUCTURAL: dict[str, Rule] = {
    "broadcast_in_dim": _broadcast,
    "slice": _slice,
    "pad": _pad,
    "concatenate": _concatenate,
    "stack": _stack,
    "reshape": _reshape,
    "squeeze": lambda p, members, inputs: lax.squeeze(inputs[0].array, p["dimensions"]),
    "transpose": _transpose,
    "rev": lambda p, members, inputs: lax.rev(inputs[0].array, p["dimensions"]),
    "reduce_sum": _reduced_by(lax.add),
    "reduce_max": _reduced_by(lax.max),
    "reduce_min": _reduced_by(lax.min),
    "reduce_and": _reduced_by(jnp.logical_and),
    "reduce_or": _reduced_by(jnp.logical_or),
}
