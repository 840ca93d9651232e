"""Many members of one function side by side: `jax.vmap` with the member axis last in memory.

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

from dropper_jax.backend.one_kernel import ELEMENTWISE, separate_call
from dropper_jax.lanes.rules import STRUCTURAL, Parameters, Value, lined_up, spread

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
    """

    def run_batch(*args: Any) -> Tree:
        axes = in_axes if isinstance(in_axes, tuple) else (in_axes,) * len(args)
        values, tree = jax.tree.flatten(args)
        many = [axis == 0 for arg, axis in zip(args, axes, strict=True) for _ in jax.tree.leaves(arg)]
        members = jnp.shape(values[many.index(True)])[0]
        shapes = [jnp.shape(x)[1:] if m else jnp.shape(x) for x, m in zip(values, many, strict=True)]
        one = [jax.ShapeDtypeStruct(s, jnp.result_type(x)) for s, x in zip(shapes, values, strict=True)]
        program, shape = jax.make_jaxpr(lambda *leaves: f(*jax.tree.unflatten(tree, leaves)), return_shape=True)(*one)
        inputs = [Value(jnp.moveaxis(x, 0, -1) if m else x, m) for x, m in zip(values, many, strict=True)]
        try:
            done = Interpreter(members).run(program, inputs)
        except Unreadable as error:
            what = f"members run by vmap, several times slower: this JAX writes the operation '{error}' in a new way"
            warnings.warn(what, RuntimeWarning, stacklevel=2)
            return jax.vmap(f, in_axes)(*args)
        return jax.tree.unflatten(jax.tree.structure(shape), [jnp.moveaxis(spread(v, members), -1, 0) for v in done])

    return run_batch


#: Of JAX, which makes them by `jax.make_jaxpr`: a traced function, an operation of it, and what this reads.
Program = Any
Operation = Any
Atom = Any

#: Operations that call a function once, and which parameter holds it.
CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "checkpoint": "jaxpr",
    "remat2": "jaxpr",
}


def split_constants(program: Program) -> tuple[Program, Sequence[Array]]:
    """A traced function, and its constants: that of a call may have none."""
    if hasattr(program, "consts"):
        return program.jaxpr, program.consts
    return program, ()


def is_literal(atom: Atom) -> bool:
    """Whether it is a number in the program, not a variable."""
    return hasattr(atom, "val")


def _which(program: Program, many: Sequence[bool]) -> list[bool]:
    jaxpr, _ = split_constants(program)
    known = dict.fromkeys(jaxpr.constvars, False) | dict(zip(jaxpr.invars, many, strict=True))

    def read(atom: Atom) -> bool:
        return not is_literal(atom) and known[atom]

    for eqn in jaxpr.eqns:
        known.update(zip(eqn.outvars, _which_of(eqn, [read(a) for a in eqn.invars]), strict=True))
    return [read(a) for a in jaxpr.outvars]


def _which_of(eqn: Operation, many: list[bool]) -> list[bool]:
    name = eqn.primitive.name
    p = eqn.params
    if not any(many):
        return [False] * len(eqn.outvars)
    if name in CALLS:
        return _which(p[CALLS[name]], many)
    if name == "scan":
        return which_scanned(p, many)
    if name == "while":
        return which_looped(p, many)[0]
    if name == "cond" and not many[0]:
        return which_branched(p, many[1:])
    return [True] * len(eqn.outvars)


def scan_parts(p: Parameters) -> tuple[int, int]:
    """Number of constants and of carried values among the inputs of a scan."""
    if "num_consts" in p:
        return p["num_consts"], p["num_carry"]
    consts, carry, _ = p["ft_in"].unpack()  # JAX 0.12
    return len(consts), len(carry)


def _grow(carry: list[bool], next_carry: Callable[[list[bool]], list[bool]]) -> list[bool]:
    """Which carried values have members: one that gets them in an iteration has them from the start."""
    while True:
        grown = [a or b for a, b in zip(carry, next_carry(carry), strict=False)]
        if grown == carry:
            return carry
        carry = grown


def which_scanned(p: Parameters, many: list[bool]) -> list[bool]:
    """For the carry and the saved values."""
    consts, carried = scan_parts(p)

    def next_carry(carry: list[bool]) -> list[bool]:
        return _which(p["jaxpr"], [*many[:consts], *carry, *many[consts + carried :]])

    carry = _grow(many[consts : consts + carried], next_carry)
    return [*carry, *next_carry(carry)[carried:]]


def which_looped(p: Parameters, many: list[bool]) -> tuple[list[bool], bool]:
    """For the carry and the test: if members disagree on when to stop, the whole carry has members."""
    tests = p["cond_nconsts"]
    bodies = tests + p["body_nconsts"]

    def stops(carry: list[bool]) -> bool:
        return _which(p["cond_jaxpr"], [*many[:tests], *carry])[0]

    def next_carry(carry: list[bool]) -> list[bool]:
        if stops(carry):
            return [True] * len(carry)
        return _which(p["body_jaxpr"], [*many[tests:bodies], *carry])

    carry = _grow(many[bodies:], next_carry)
    return carry, stops(carry)


def which_branched(p: Parameters, many: list[bool]) -> list[bool]:
    """For the results: those for which any branch has members."""
    branches = [_which(branch, many) for branch in p["branches"]]
    return [any(found) for found in zip(*branches, strict=True)]


class Unreadable(Exception):
    """An operation whose parameters have other names in this JAX; its name."""


class Interpreter:
    """Operations of a function of one member, evaluated for `members` of them."""

    def __init__(self, members: int) -> None:
        self.members = members
        self.control = {"scan": self._scan, "while": self._while, "cond": self._cond}

    def with_member_axis(self, values: Sequence[Value], many: Sequence[bool]) -> list[Array]:
        """Arrays with the member axis where `many` requires it."""
        return [spread(v, self.members) if m else v.array for v, m in zip(values, many, strict=True)]

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
            try:
                found = self.operation(eqn, [read(a) for a in eqn.invars])
            except (KeyError, AttributeError) as error:  # of parameters with other names
                raise Unreadable(eqn.primitive.name) from error
            known.update(zip(eqn.outvars, found, strict=True))
        return [read(a) for a in jaxpr.outvars]

    def operation(self, eqn: Operation, inputs: list[Value]) -> list[Value]:
        name = eqn.primitive.name
        p = eqn.params
        if name in CALLS:
            return self.run(p[CALLS[name]], inputs)
        if not any(v.many for v in inputs):
            return [Value(x, False) for x in alone(eqn, [v.array for v in inputs])]
        if name in self.control:
            return self.control[name](p, inputs)
        if name == "optimization_barrier":  # the compiler ignores it on the CPU
            stored = separate_call(lambda *xs: [x * 1 for x in xs])(*(v.array for v in inputs))
            return as_values(stored, [v.many for v in inputs])
        if name in ELEMENTWISE:
            shape = eqn.outvars[0].aval.shape
            return [Value(eqn.primitive.bind(*(lined_up(v, shape, self.members) for v in inputs), **p), True)]
        found = STRUCTURAL[name](p, self.members, inputs) if name in STRUCTURAL else None
        if found is not None:
            return [Value(found, True)]
        first = [jnp.moveaxis(v.array, -1, 0) if v.many else v.array for v in inputs]
        axes = tuple(0 if v.many else None for v in inputs)
        rows = jax.vmap(lambda *xs: alone(eqn, xs), in_axes=axes, axis_size=self.members)(*first)
        return [Value(jnp.moveaxis(x, 0, -1), True) for x in rows]

    def _scan(self, p: Parameters, inputs: list[Value]) -> list[Value]:
        consts, carried = scan_parts(p)
        out = which_scanned(p, [v.many for v in inputs])
        start = self.with_member_axis(inputs[consts : consts + carried], out[:carried])
        rows = inputs[consts + carried :]

        def body(carry: list[Array], row: list[Array]) -> tuple[list[Array], list[Array]]:
            given = [*inputs[:consts], *as_values(carry, out[:carried]), *as_values(row, [v.many for v in rows])]
            found = self.with_member_axis(self.run(p["jaxpr"], given), out)
            return found[:carried], found[carried:]

        options = {key: p[key] for key in ("length", "reverse", "unroll")}
        end, saved = lax.scan(body, start, [v.array for v in rows], **options)
        return as_values([*end, *saved], out)

    def _while(self, p: Parameters, inputs: list[Value]) -> list[Value]:
        tests = p["cond_nconsts"]
        bodies = p["body_nconsts"]
        many, disagree = which_looped(p, [v.many for v in inputs])

        def going(carry: list[Array]) -> Array:
            return self.run(p["cond_jaxpr"], [*inputs[:tests], *as_values(carry, many)])[0].array

        def body(carry: list[Array]) -> list[Array]:
            given = [*inputs[tests : tests + bodies], *as_values(carry, many)]
            found = self.with_member_axis(self.run(p["body_jaxpr"], given), many)
            if not disagree:
                return found
            on = going(carry)
            return [jnp.where(choice(on, old), new, old) for new, old in zip(found, carry, strict=True)]

        start = self.with_member_axis(inputs[tests + bodies :], many)
        end = lax.while_loop((lambda carry: jnp.any(going(carry))) if disagree else going, body, start)
        return as_values(end, many)

    def _cond(self, p: Parameters, inputs: list[Value]) -> list[Value]:
        index = inputs[0]
        given = inputs[1:]
        if index.many:  # members take different branches: all branches are run
            which = jnp.asarray(index.array, jnp.int32)
            results = []
            for values in zip(*(self.run(branch, given) for branch in p["branches"]), strict=True):
                xs = [spread(v, self.members) for v in values]
                results.append(Value(lax.select_n(jnp.broadcast_to(which, xs[0].shape), *xs), True))
            return results
        many = which_branched(p, [v.many for v in given])

        def branch(program: Program, arrays: list[Array]) -> list[Array]:
            return self.with_member_axis(self.run(program, as_values(arrays, [v.many for v in given])), many)

        branches = [partial(branch, b) for b in p["branches"]]
        return as_values(lax.switch(index.array, branches, [v.array for v in given]), many)


def choice(on: Array, x: Array) -> Array:
    """A choice (..., members) for arrays (..., more, members): a loop made by `vmap` has one for each of its
    members."""
    return on.reshape(*on.shape[:-1], *(1,) * (x.ndim - on.ndim), on.shape[-1])


def as_values(arrays: Sequence[Array], many: Sequence[bool]) -> list[Value]:
    """Arrays, and which of them have the member axis."""
    return [Value(x, m) for x, m in zip(arrays, many, strict=True)]


def alone(eqn: Operation, inputs: Sequence[Array]) -> list[Array]:
    """The operation itself, on inputs without members."""
    found = eqn.primitive.bind(*inputs, **eqn.params)
    if eqn.primitive.multiple_results:
        return list(found)
    return [found]


__all__ = ["lanes"]
