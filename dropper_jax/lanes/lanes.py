"""Many members of one function side by side: `jax.vmap` with the member axis last in memory, for batches on the CPU.

`vmap` puts members first, and the loops over 3 components and some nodes innermost: too short for vector registers.
Here members come last, so that every kernel runs over them. A function is traced once for one member; its operations
are then carried out on arrays (..., members). What has no rule (`lane_rules`) falls back on JAX's own batching rule
between two moves of the axis: slower, never wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend import core

from dropper_jax.lanes.rules import ELEMENTWISE, STRUCTURAL, Value, lined_up, spread

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


def lanes(f: Callable[..., Any], in_axes: Any = 0) -> Callable[..., Any]:
    """Map `f` over the first axis of its arguments, as `jax.vmap(f, in_axes)` does, to rounding.

    Args:
        f: a pure function of pytrees of arrays.
        in_axes: 0 (mapped) or None (shared) for all arguments, or one of them for each.

    Returns:
        A function whose results have the members first, all of them mapped.
    """

    def mapped(*args: Any) -> Any:
        axes = in_axes if isinstance(in_axes, tuple) else (in_axes,) * len(args)
        values, tree = jax.tree.flatten(args)
        many = [axis == 0 for arg, axis in zip(args, axes, strict=True) for _ in jax.tree.leaves(arg)]
        members = next(jnp.shape(x)[0] for x, m in zip(values, many, strict=True) if m)
        shapes = [jnp.shape(x)[1:] if m else jnp.shape(x) for x, m in zip(values, many, strict=True)]
        one = [jax.ShapeDtypeStruct(s, jnp.result_type(x)) for s, x in zip(shapes, values, strict=True)]
        program, shape = jax.make_jaxpr(lambda *leaves: f(*jax.tree.unflatten(tree, leaves)), return_shape=True)(*one)
        inputs = [Value(jnp.moveaxis(x, 0, -1) if m else x, m) for x, m in zip(values, many, strict=True)]
        try:
            done = _run(program, members, inputs)
        except (KeyError, AttributeError):  # the operations of a JAX that names their parameters otherwise
            return jax.vmap(f, in_axes)(*args)
        found = [jnp.moveaxis(spread(v, members), -1, 0) for v in done]
        return jax.tree.unflatten(jax.tree.structure(shape), found)

    return mapped


def _fitted(values: Sequence[Value], many: Sequence[bool], members: int) -> list[Any]:
    """Arrays with the member axis where `many` asks for it."""
    return [spread(v, members) if m else v.array for v, m in zip(values, many, strict=True)]


def _valued(arrays: Sequence[Any], many: Sequence[bool]) -> list[Value]:
    return [Value(x, m) for x, m in zip(arrays, many, strict=True)]


def _run(program: Any, members: int, inputs: Sequence[Value]) -> list[Value]:
    """Carry out a traced function."""
    jaxpr = program.jaxpr
    known = dict(zip(jaxpr.constvars, (Value(c, False) for c in program.consts), strict=True))
    known |= dict(zip(jaxpr.invars, inputs, strict=True))

    def read(atom: Any) -> Value:
        return Value(atom.val, False) if isinstance(atom, core.Literal) else known[atom]

    for eqn in jaxpr.eqns:
        known.update(zip(eqn.outvars, _operation(eqn, members, [read(a) for a in eqn.invars]), strict=True))
    return [read(a) for a in jaxpr.outvars]


def _operation(eqn: Any, members: int, inputs: list[Value]) -> list[Value]:
    name, p = eqn.primitive.name, eqn.params
    if name in CALLS:
        return _run(_closed(p[CALLS[name]]), members, inputs)
    if not any(v.many for v in inputs):
        return [Value(x, False) for x in _alone(eqn, [v.array for v in inputs])]
    if name in CONTROL:
        return CONTROL[name](p, members, inputs)
    if name in ELEMENTWISE:
        shape = eqn.outvars[0].aval.shape
        return [Value(eqn.primitive.bind(*(lined_up(v, shape, members) for v in inputs), **p), True)]
    found = STRUCTURAL[name](p, members, inputs) if name in STRUCTURAL else None
    if found is not None:
        return [Value(found, True)]
    first = [jnp.moveaxis(v.array, -1, 0) if v.many else v.array for v in inputs]
    axes = tuple(0 if v.many else None for v in inputs)
    rows = jax.vmap(lambda *xs: _alone(eqn, xs), in_axes=axes, axis_size=members)(*first)
    return [Value(jnp.moveaxis(x, 0, -1), True) for x in rows]


def _closed(program: Any) -> Any:
    return program if hasattr(program, "consts") else core.ClosedJaxpr(program, ())


def _alone(eqn: Any, inputs: Sequence[Any]) -> list[Any]:
    """The operation itself, on inputs without members."""
    found = eqn.primitive.bind(*inputs, **eqn.params)
    return list(found) if eqn.primitive.multiple_results else [found]


# --- which values of a function have members, without carrying it out ---------------------------------------------


def _which(program: Any, many: Sequence[bool]) -> list[bool]:
    jaxpr = program.jaxpr
    known = dict.fromkeys(jaxpr.constvars, False) | dict(zip(jaxpr.invars, many, strict=True))

    def read(atom: Any) -> bool:
        return not isinstance(atom, core.Literal) and known[atom]

    for eqn in jaxpr.eqns:
        known.update(zip(eqn.outvars, _which_of(eqn, [read(a) for a in eqn.invars]), strict=True))
    return [read(a) for a in jaxpr.outvars]


def _which_of(eqn: Any, many: list[bool]) -> list[bool]:
    name, p = eqn.primitive.name, eqn.params
    if not any(many):
        return [False] * len(eqn.outvars)
    if name in CALLS:
        return _which(_closed(p[CALLS[name]]), many)
    if name == "scan":
        return _which_scanned(p, many)
    if name == "while":
        return _which_looped(p, many)[0]
    if name == "cond" and not many[0]:
        return _which_branched(p, many[1:])
    return [True] * len(eqn.outvars)


def _scan_parts(p: dict[str, Any]) -> tuple[int, int]:
    """How many inputs of a scan are constants, and how many are carried."""
    if "num_consts" in p:
        return p["num_consts"], p["num_carry"]
    consts, carry, _ = p["ft_in"].unpack()  # JAX 0.12
    return len(consts), len(carry)


def _which_scanned(p: dict[str, Any], many: list[bool]) -> list[bool]:
    consts, carried = _scan_parts(p)
    carry = many[consts : consts + carried]
    while True:
        out = _which(p["jaxpr"], [*many[:consts], *carry, *many[consts + carried :]])
        grown = [a or b for a, b in zip(carry, out, strict=False)]
        if grown == carry:
            return [*carry, *out[carried:]]
        carry = grown


def _which_looped(p: dict[str, Any], many: list[bool]) -> tuple[list[bool], bool]:
    """Of the carry, and of the test: where members disagree on when to stop, all of the carry has members."""
    tests, bodies = p["cond_nconsts"], p["body_nconsts"]
    carry = many[tests + bodies :]
    while True:
        test = _which(p["cond_jaxpr"], [*many[:tests], *carry])[0]
        out = _which(p["body_jaxpr"], [*many[tests : tests + bodies], *carry])
        grown = [test or a or b for a, b in zip(carry, out, strict=True)]
        if grown == carry:
            return carry, test
        carry = grown


def _which_branched(p: dict[str, Any], many: list[bool]) -> list[bool]:
    return [any(found) for found in zip(*(_which(b, many) for b in p["branches"]), strict=True)]


# --- loops and branches -------------------------------------------------------------------------------------------


def _scan(p: dict[str, Any], members: int, inputs: list[Value]) -> list[Value]:
    consts, carried = _scan_parts(p)
    out = _which_scanned(p, [v.many for v in inputs])
    start = _fitted(inputs[consts : consts + carried], out[:carried], members)
    rows = inputs[consts + carried :]

    def body(carry: list[Any], row: list[Any]) -> tuple[list[Any], list[Any]]:
        given = [*inputs[:consts], *_valued(carry, out[:carried]), *_valued(row, [v.many for v in rows])]
        found = _fitted(_run(p["jaxpr"], members, given), out, members)
        return found[:carried], found[carried:]

    options = {"length": p["length"], "reverse": p["reverse"], "unroll": p["unroll"]}
    end, saved = lax.scan(body, start, [v.array for v in rows], **options)
    return _valued([*end, *saved], out)


def _while(p: dict[str, Any], members: int, inputs: list[Value]) -> list[Value]:
    tests, bodies = p["cond_nconsts"], p["body_nconsts"]
    many, disagree = _which_looped(p, [v.many for v in inputs])

    def going(carry: list[Any]) -> jax.Array:
        return _run(p["cond_jaxpr"], members, [*inputs[:tests], *_valued(carry, many)])[0].array

    def body(carry: list[Any]) -> list[Any]:
        given = [*inputs[tests : tests + bodies], *_valued(carry, many)]
        found = _fitted(_run(p["body_jaxpr"], members, given), many, members)
        if not disagree:
            return found
        on = going(carry)
        return [jnp.where(on, new, old) for new, old in zip(found, carry, strict=True)]

    start = _fitted(inputs[tests + bodies :], many, members)
    end = lax.while_loop((lambda carry: jnp.any(going(carry))) if disagree else going, body, start)
    return _valued(end, many)


def _cond(p: dict[str, Any], members: int, inputs: list[Value]) -> list[Value]:
    index, given = inputs[0], inputs[1:]
    if index.many:  # members go different ways: all branches are run
        found = [_fitted(out, [True] * len(out), members) for out in (_run(b, members, given) for b in p["branches"])]
        which = jnp.asarray(index.array, jnp.int32)
        chosen = (lax.select_n(jnp.broadcast_to(which, xs[0].shape), *xs) for xs in zip(*found, strict=True))
        return [Value(x, True) for x in chosen]
    many = _which_branched(p, [v.many for v in given])

    def branch(program: Any, arrays: list[Any]) -> list[Any]:
        return _fitted(_run(program, members, _valued(arrays, [v.many for v in given])), many, members)

    branches = [partial(branch, b) for b in p["branches"]]
    return _valued(lax.switch(index.array, branches, [v.array for v in given]), many)


CONTROL = {"scan": _scan, "while": _while, "cond": _cond}
