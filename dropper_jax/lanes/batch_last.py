"""`jax.vmap` with the member axis last in memory.

`vmap` puts members first, and the loops over 3 components and a few nodes innermost, which is too short for vector
registers. Here members come last, so that every kernel runs over them. A function is traced once for one member; its
operations are then evaluated on arrays (..., members). Operations without a rule (`rules`) use JAX's own batching rule
between two moves of the axis, which is slower.

Members that disagree on a branch run all of it, and a loop continues until the last of them stops. The others keep
their values: a member that fails or needs more iterations does not change them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax

from dropper_jax.backend.one_kernel import separate_call
from dropper_jax.backend.primitives import CALLS, ELEMENTWISE
from dropper_jax.lanes.mapped import (
    Atom,
    Operation,
    Program,
    is_literal,
    mapped_by_cond,
    mapped_by_scan,
    mapped_by_while,
    scan_parts,
    split_constants,
)
from dropper_jax.lanes.parameters import Parameters, Unreadable
from dropper_jax.lanes.rules import STRUCTURAL, Value, aligned, with_members

#: A pytree of arrays.
Tree = TypeVar("Tree")
#: Mapped, or shared by all members.
Axis = Literal[0] | None


def lanes(f: Callable[..., Tree], in_axes: Axis | tuple[Axis, ...] = 0) -> Callable[..., Tree]:
    """Map `f` over the first axis of its arguments, as `jax.vmap(f, in_axes)` does, to rounding.

    Args:
        f: a pure function of pytrees of arrays.
        in_axes: 0 (mapped) or None (shared) for all arguments, or one of them for each.

    Returns:
        A function whose results have the members first, all of them mapped.

    Raises:
        ValueError: by the returned function, if no argument is mapped.
    """

    def run_batch(*args: Any) -> Tree:
        axes = in_axes
        if not isinstance(axes, tuple):
            axes = (axes,) * len(args)
        leaves, tree = jax.tree.flatten(args)
        has_members = [axis == 0 for arg, axis in zip(args, axes, strict=True) for _ in jax.tree.leaves(arg)]
        if not any(has_members):
            raise ValueError("in_axes: at least one argument must be mapped (0)")
        members = jnp.shape(leaves[has_members.index(True)])[0]
        inputs, shapes = _members_last(leaves, has_members)

        def f_of_leaves(*member: Array) -> Tree:
            return f(*jax.tree.unflatten(tree, member))

        program, form = jax.make_jaxpr(f_of_leaves, return_shape=True)(*shapes)
        try:
            found = Interpreter(members).run(program, inputs)
        except Unreadable as error:
            changed = f"this JAX has changed the parameters of '{error}'"
            warnings.warn(f"{changed}: members run by vmap, several times slower", RuntimeWarning, stacklevel=2)
            return jax.vmap(f, in_axes)(*args)
        results = [jnp.moveaxis(with_members(value, members), -1, 0) for value in found]
        return jax.tree.unflatten(jax.tree.structure(form), results)

    return run_batch


def _members_last(
    leaves: Sequence[Array], has_members: Sequence[bool]
) -> tuple[list[Value], list[jax.ShapeDtypeStruct]]:
    """Arguments with the member axis moved from the first position to the last, and their shapes for one member."""
    inputs = []
    shapes = []
    for x, mapped in zip(leaves, has_members, strict=True):
        shape = jnp.shape(x)
        if mapped:
            shape = shape[1:]
            x = jnp.moveaxis(x, 0, -1)
        inputs.append(Value(x, mapped))
        shapes.append(jax.ShapeDtypeStruct(shape, jnp.result_type(x)))
    return inputs, shapes


class Interpreter:
    """Operations of a function of one member, evaluated for `members` of them."""

    def __init__(self, members: int) -> None:
        self.members = members
        self.control = {"scan": self._scan, "while": self._while, "cond": self._cond}

    def with_member_axis(self, values: Sequence[Value], has_members: Sequence[bool]) -> list[Array]:
        """Arrays with the member axis where `has_members` requires it."""
        arrays = []
        for value, mapped in zip(values, has_members, strict=True):
            arrays.append(with_members(value, self.members) if mapped else value.array)
        return arrays

    def run(self, program: Program, inputs: Sequence[Value]) -> list[Value]:
        """The results of a traced function.

        Raises:
            Unreadable: an operation of a JAX that names its parameters differently.
        """
        jaxpr, consts = split_constants(program)
        known = dict(zip(jaxpr.constvars, (Value(c, False) for c in consts), strict=True))
        known |= dict(zip(jaxpr.invars, inputs, strict=True))

        def read(atom: Atom) -> Value:
            if is_literal(atom):
                return Value(atom.val, False)
            return known[atom]

        for eqn in jaxpr.eqns:
            found = self.operation(eqn, [read(a) for a in eqn.invars])
            known.update(zip(eqn.outvars, found, strict=True))
        return [read(a) for a in jaxpr.outvars]

    def operation(self, eqn: Operation, inputs: list[Value]) -> list[Value]:
        """The results of an operation: unchanged where no input has members, by a rule, or by JAX's own one."""
        name = eqn.primitive.name
        p = Parameters(eqn)
        if name in CALLS:
            return self.run(p[CALLS[name]], inputs)
        arrays = [v.array for v in inputs]
        if not any(v.has_members for v in inputs):
            return [Value(x, False) for x in bind_operation(eqn, arrays)]
        if name in self.control:
            return self.control[name](p, inputs)
        if name == "optimization_barrier":
            return as_values(separate_call(_copy)(*arrays), [v.has_members for v in inputs])
        if name in ELEMENTWISE:
            shape = eqn.outvars[0].aval.shape
            expanded = [aligned(v, shape, self.members) for v in inputs]
            return [Value(eqn.primitive.bind(*expanded, **p), True)]
        if name in STRUCTURAL:
            found = STRUCTURAL[name](p, self.members, inputs)
            if found is not None:
                return [Value(found, True)]
        return self._by_vmap(eqn, inputs)

    def _by_vmap(self, eqn: Operation, inputs: list[Value]) -> list[Value]:
        """The results of an operation by JAX's own batching rule, between two moves of the member axis."""
        arrays = []
        axes: list[Axis] = []
        for value in inputs:
            if value.has_members:
                arrays.append(jnp.moveaxis(value.array, -1, 0))
                axes.append(0)
            else:
                arrays.append(value.array)
                axes.append(None)
        batched = jax.vmap(lambda *xs: bind_operation(eqn, xs), in_axes=tuple(axes), axis_size=self.members)
        return [Value(jnp.moveaxis(x, 0, -1), True) for x in batched(*arrays)]

    def _scan(self, p: Parameters, inputs: list[Value]) -> list[Value]:
        consts, carried = scan_parts(p)
        out = mapped_by_scan(p, [v.has_members for v in inputs])
        start = self.with_member_axis(inputs[consts : consts + carried], out[:carried])
        rows = inputs[consts + carried :]

        def body(carry: list[Array], row: list[Array]) -> tuple[list[Array], list[Array]]:
            given = [*inputs[:consts], *as_values(carry, out[:carried]), *as_values(row, [v.has_members for v in rows])]
            found = self.with_member_axis(self.run(p["jaxpr"], given), out)
            return found[:carried], found[carried:]

        options = {key: p[key] for key in ("length", "reverse", "unroll")}
        end, saved = lax.scan(body, start, [v.array for v in rows], **options)
        return as_values([*end, *saved], out)

    def _while(self, p: Parameters, inputs: list[Value]) -> list[Value]:
        tests = p["cond_nconsts"]
        bodies = p["body_nconsts"]
        has_members, disagree = mapped_by_while(p, [v.has_members for v in inputs])

        def continues(carry: list[Array]) -> Array:
            return self.run(p["cond_jaxpr"], [*inputs[:tests], *as_values(carry, has_members)])[0].array

        def any_continues(carry: list[Array]) -> Array:
            return jnp.any(continues(carry))

        def body(carry: list[Array]) -> list[Array]:
            given = [*inputs[tests : tests + bodies], *as_values(carry, has_members)]
            found = self.with_member_axis(self.run(p["body_jaxpr"], given), has_members)
            if not disagree:
                return found
            on = continues(carry)
            return [jnp.where(choice(on, old), new, old) for new, old in zip(found, carry, strict=True)]

        test = any_continues if disagree else continues
        start = self.with_member_axis(inputs[tests + bodies :], has_members)
        return as_values(lax.while_loop(test, body, start), has_members)

    def _cond(self, p: Parameters, inputs: list[Value]) -> list[Value]:
        index = inputs[0]
        given = inputs[1:]
        if index.has_members:  # members take different branches: all branches are run
            which = jnp.asarray(index.array, jnp.int32)
            branches = [self.run(branch, given) for branch in p["branches"]]
            results = []
            for values in zip(*branches, strict=True):
                xs = [with_members(v, self.members) for v in values]
                results.append(Value(lax.select_n(jnp.broadcast_to(which, xs[0].shape), *xs), True))
            return results
        mapped = [v.has_members for v in given]
        has_members = mapped_by_cond(p, mapped)

        def branch(program: Program, arrays: list[Array]) -> list[Array]:
            return self.with_member_axis(self.run(program, as_values(arrays, mapped)), has_members)

        branches = [partial(branch, b) for b in p["branches"]]
        return as_values(lax.switch(index.array, branches, [v.array for v in given]), has_members)


def _copy(*xs: Array) -> list[Array]:
    """The arrays, by an operation whose results `separate_call` stores: on the CPU the compiler ignores barriers."""
    return [x * 1 for x in xs]


def choice(on: Array, x: Array) -> Array:
    """A choice (..., members) for arrays (..., more, members): a loop made by `vmap` has one for each of its
    members."""
    return on.reshape(*on.shape[:-1], *(1,) * (x.ndim - on.ndim), on.shape[-1])


def as_values(arrays: Sequence[Array], has_members: Sequence[bool]) -> list[Value]:
    """Arrays, and which of them have the member axis."""
    return [Value(x, m) for x, m in zip(arrays, has_members, strict=True)]


def bind_operation(eqn: Operation, inputs: Sequence[Array]) -> list[Array]:
    """The operation itself, on inputs without members."""
    found = eqn.primitive.bind(*inputs, **eqn.params)
    if eqn.primitive.multiple_results:
        return list(found)
    return [found]
