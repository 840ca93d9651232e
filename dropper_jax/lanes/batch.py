"""Many members of one function side by side: `jax.vmap` with the member axis last in memory, for batches on the CPU.

`vmap` puts members first, and the loops over 3 components and a few nodes innermost, which is too short for vector
registers. Here members come last, so that every kernel runs over them. A function is traced once for one member; its
operations are then evaluated on arrays (..., members). Operations without a rule (`rules`) use JAX's own batching rule
between two moves of the axis. That is slower, still correct, and recorded in `Fallbacks`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

import jax
import jax.numpy as jnp

from dropper_jax.backend import is_plain
from dropper_jax.lanes.interpreter import Fallbacks, Interpreter, Unreadable
from dropper_jax.lanes.rules import Value, spread

#: A pytree of arrays.
Tree = TypeVar("Tree")
#: Mapped, or shared by all members.
Axis = Literal[0] | None


def lanes(
    f: Callable[..., Tree], in_axes: Axis | tuple[Axis, ...] = 0, fallbacks: Fallbacks | None = None
) -> Callable[..., Tree]:
    """Map `f` over the first axis of its arguments, as `jax.vmap(f, in_axes)` does, to rounding.

    Args:
        f: a pure function of pytrees of arrays.
        in_axes: 0 (mapped) or None (shared) for all arguments, or one of them for each.
        fallbacks: records the operations without a rule whenever the function is traced.

    Returns:
        A function whose results have the members first, all of them mapped.
    """

    recorded = Fallbacks() if fallbacks is None else fallbacks

    if is_plain():
        return jax.vmap(f, in_axes)

    def run_batch(*args: Any) -> Tree:
        axes = in_axes if isinstance(in_axes, tuple) else (in_axes,) * len(args)
        values, tree = jax.tree.flatten(args)
        many = [axis == 0 for arg, axis in zip(args, axes, strict=True) for _ in jax.tree.leaves(arg)]
        members = next(jnp.shape(x)[0] for x, m in zip(values, many, strict=True) if m)
        shapes = [jnp.shape(x)[1:] if m else jnp.shape(x) for x, m in zip(values, many, strict=True)]
        one = [jax.ShapeDtypeStruct(s, jnp.result_type(x)) for s, x in zip(shapes, values, strict=True)]
        program, shape = jax.make_jaxpr(lambda *leaves: f(*jax.tree.unflatten(tree, leaves)), return_shape=True)(*one)
        inputs = [Value(jnp.moveaxis(x, 0, -1) if m else x, m) for x, m in zip(values, many, strict=True)]
        try:
            done = Interpreter(members, recorded).run(program, inputs)
        except Unreadable as error:
            recorded.operation = str(error)
            return jax.vmap(f, in_axes)(*args)
        found = [jnp.moveaxis(spread(v, members), -1, 0) for v in done]
        return jax.tree.unflatten(jax.tree.structure(shape), found)

    return run_batch
