"""One step that never raises, with exact derivatives in both modes; see `solve` for its solution."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, NoReturn

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jax.tree_util import PyTreeDef

from dropper_jax.model import BREAKING, Model, Parted, State, as_parted, book_works
from dropper_jax.residual import Explicit, Unknowns, refine
from dropper_jax.solvers import SOLVERS
from dropper_jax.stepping.stepper import (
    FULL_STEP,
    Report,
    Stepper,
    in_chosen_form,
    limit_pace,
    solve,
    solve_once,
    substep_once,
)

# --- derivatives ---
#
# Derivatives follow from the implicit function theorem at the solution, never through the iterations: with rows
# `R(theta, u) = 0` and end state `S(theta, u)`, `theta` = (model, state, step size),
#
#     du = -R_u^-1 R_theta dtheta,    dS = S_theta dtheta + S_u du,
#
# and its transpose for reverse mode. A halved step chains its substeps, which are recomputed when needed.
# In forward mode alone (`Stepper.reverse`), the iterations of a system's step carry du: half the program.

#: A step's end state, scaled residual and level of halving.
Stepped = tuple[State, jax.Array, jax.Array]
#: A tangent, or the mark of a zero tangent.
Dot = jax.Array | SymbolicZero
#: Constants of the differentiation of a step: leaves of the model, step size, unknowns, level of halving.
Frozen = tuple[list[jax.Array], jax.Array, Unknowns, jax.Array]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _solve_step(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> Stepped:
    s1, _, residual, level = (solve_once if model.laws else solve)(stepper, model, s, h, alive)
    return s1, residual, level


@partial(_solve_step.defjvp, symbolic_zeros=True)
def _solved_jvp(
    stepper: Stepper, primals: tuple[Model, State, jax.Array, jax.Array], tangents: tuple[Any, ...]
) -> tuple[Stepped, Stepped]:
    model, s, h, alive = primals
    leaves, tree = jax.tree.flatten(model)
    dmodel, ds, dh = (jax.tree.leaves(dot, is_leaf=_is_zero) for dot in tangents[:3])
    moving = tuple(i for i, dot in enumerate(dmodel) if not _is_zero(dot))
    filled = [jnp.zeros_like(x) if _is_zero(dot) else dot for x, dot in zip(jax.tree.leaves(s), ds, strict=True)]
    given = _At([dmodel[i] for i in moving], jax.tree.unflatten(jax.tree.structure(s), filled), _nonzero(dh))
    at = _At([leaves[i] for i in moving], s, [h] if given.h else [])
    if stepper.until_converged and not (stepper.reverse or model.constraints):
        leaves, at, h = jax.tree.map(_refusing.bind, (leaves, at, h))
        following = dataclasses.replace(stepper, follows=True)

        def solve_at(at: _At) -> tuple[State, tuple[jax.Array, jax.Array]]:
            s1, _, residual, level = solve(following, *_inputs(tree, moving, (leaves, h), at), alive)
            return s1, (residual, level)

        s1, ds1, (residual, level) = jax.jvp(solve_at, (at,), (given,), has_aux=True)
        return (s1, residual, level), (ds1, jnp.zeros_like(residual), jnp.zeros(level.shape, jax.dtypes.float0))
    s1, u, residual, level = solve_once(stepper, model, s, h, alive)
    zeros = jnp.zeros_like(residual), jnp.zeros(level.shape, jax.dtypes.float0)
    if not stepper.reverse:
        frozen = leaves, h, jax.tree.map(_refusing.bind, u), level
        ds1 = _forward(stepper, tree, moving, frozen, at, given)
        return (s1, residual, level), (ds1, *zeros)
    frozen = leaves, h, u, level
    forward = partial(_forward, stepper, tree, moving, frozen, at)
    ds1 = _linear(forward, partial(_backward, stepper, tree, moving, frozen, at), given, s1, (frozen, at))
    return (s1, residual, level), (ds1, *zeros)


class _At(NamedTuple):
    """Inputs with respect to which a step is differentiated: some leaves of the model, the state, the step (or
    none)."""

    model: list[jax.Array]
    s: State
    h: list[jax.Array]


#: Inputs of a step together with its end, in the form of the linear solve; conversion of inputs to a model, a state and
#: a step.
Pair = tuple[_At, State]
Inputs = Callable[[_At], tuple[Model, State, jax.Array]]


def _is_zero(dot: Dot) -> bool:
    return isinstance(dot, SymbolicZero)


def _nonzero(dots: list[Dot]) -> list[jax.Array]:
    return [dot for dot in dots if not _is_zero(dot)]


def _linear(
    forward: Callable[[_At], State],
    backward: Callable[[State], _At],
    given: _At,
    like: State,
    residuals: tuple[Any, ...],
) -> State:
    """Apply the linear map `forward`, whose transpose is `backward`, so that JAX can transpose and batch it.

    It is the solution x = (a, forward(a)) of `[[1, 0], [-forward, 1]] x = (a, 0)`, which JAX's linear solve stores
    together with the transposed solve. The matrix itself is never applied, and second derivatives are rejected. JAX
    transposes a linear solve only if no array of its right side is a constant, such as the zero tangent of a constant
    input. Therefore a zero that depends on all of them is added to each.
    """
    nothing = _nothing.bind(*jax.tree.leaves(given))
    given = jax.tree.map(lambda a: a + nothing.astype(a.dtype), given)
    zeros = jax.tree.map(lambda a: jnp.broadcast_to(nothing, a.shape).astype(a.dtype), like)

    def matrix(x: Pair) -> Pair:
        one = _first_derivatives_only(residuals)
        return jax.tree.map(lambda a: a * one.astype(a.dtype), x)

    def solve(_: Callable[[Pair], Pair], b: Pair) -> Pair:
        return b[0], jax.tree.map(jnp.add, forward(b[0]), b[1])

    def transpose_solve(_: Callable[[Pair], Pair], b: Pair) -> Pair:
        return jax.tree.map(jnp.add, b[0], backward(b[1])), b[1]

    return jax.lax.custom_linear_solve(matrix, (given, zeros), solve, transpose_solve)[1]


def _first_derivatives_only(residuals: tuple[Any, ...]) -> jax.Array:
    """A one that depends on the residuals and cannot be differentiated."""
    return 1.0 + _refusing.bind(0.0 * sum(jnp.sum(leaf) for leaf in jax.tree.leaves(residuals)))


def _refuse_second(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> NoReturn:
    raise NotImplementedError("second derivatives of a run are not available; take differences of first derivatives")


# A primitive, because partial evaluation (reverse mode) forgets the rules of custom_jvp functions. It is part of a
# matrix that is never applied, so it is not in any compiled program.
_refusing = Primitive("first_derivatives_only")
_refusing.def_impl(lambda x: x)
_refusing.def_abstract_eval(lambda x: x)
mlir.register_lowering(_refusing, lambda _, x: [x])
batching.primitive_batchers[_refusing] = lambda args, dims: (_refusing.bind(*args), dims[0])
ad.primitive_jvps[_refusing] = _refuse_second


# A zero that depends linearly on all its operands for JAX's rules, and is a plain zero in the compiled program.
_nothing = Primitive("zero_of_all")
_nothing.def_impl(lambda *x: jnp.zeros((), x[0].dtype))
_nothing.def_abstract_eval(lambda *x: x[0].update(shape=()))
mlir.register_lowering(_nothing, mlir.lower_fun(lambda *x: jnp.zeros((), x[0].dtype), multiple_results=False))
batching.primitive_batchers[_nothing] = lambda args, _: (_nothing.bind(*args), None)
ad.deflinear2(_nothing, lambda _, *x: [ad.Zero(a.aval) if ad.is_undefined_primal(a) else None for a in x])


def _inputs(tree: PyTreeDef, moving: tuple[int, ...], frozen: Frozen, at: _At) -> tuple[Model, State, jax.Array]:
    leaves = list(frozen[0])
    for i, value in zip(moving, at.model, strict=True):
        leaves[i] = value
    return jax.tree.unflatten(tree, leaves), at.s, at.h[0] if at.h else frozen[1]


def _pieces(level: jax.Array) -> jax.Array:
    """Number of substeps of a halved step, 0 for a full step."""
    return jnp.where(level >= 0, 2 ** jnp.maximum(level, 0), 0)


def _cut(frozen: Frozen, at: _At, pieces: jax.Array) -> tuple[Frozen, _At]:
    """The derivative of one of several substeps."""
    many = jnp.maximum(pieces, 1)
    return (frozen[0], frozen[1] / many, *frozen[2:]), at._replace(h=[h / many for h in at.h])


@partial(jax.jit, static_argnums=(0, 1, 2))
def _forward(stepper: Stepper, tree: PyTreeDef, moving: tuple[int, ...], frozen: Frozen, at: _At, given: _At) -> State:
    """Tangent of a step: of its single solve, or of its chain of substeps if it was halved."""
    _, _, u, level = frozen
    whole = _forward_step(stepper, stepper.solver, partial(_inputs, tree, moving, frozen), at, given, u)
    if not stepper.halvings:
        return whole
    pieces = _pieces(level)
    part, at = _cut(frozen, at, pieces)
    given = given._replace(h=[dh / jnp.maximum(pieces, 1) for dh in given.h])
    inputs = partial(_inputs, tree, moving, part)

    def piece(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        i, now, dnow = carry
        here = at._replace(s=now)
        after, u, _ = substep_once(stepper, *inputs(here))
        return i + 1, after, _forward_step(stepper, stepper.fallback, inputs, here, given._replace(s=dnow), u)

    _, _, split = jax.lax.while_loop(lambda c: c[0] < pieces, piece, (jnp.zeros((), jnp.int32), at.s, given.s))
    return jax.tree.map(lambda a, b: jnp.where(pieces > 0, a, b), split, whole)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _backward(
    stepper: Stepper, tree: PyTreeDef, moving: tuple[int, ...], frozen: Frozen, at: _At, cotangent: State
) -> _At:
    """Cotangent of a step; the states and unknowns of substeps are recomputed and stored in an array."""
    _, _, u, level = frozen
    one_way = stepper.solver == stepper.fallback  # a full step is then a chain of one: half the program to compile
    if not (one_way and stepper.halvings):
        whole = _backward_step(stepper, stepper.solver, partial(_inputs, tree, moving, frozen), at, cotangent, u)
        if not stepper.halvings:
            return whole
    pieces = _pieces(level)
    part, at = _cut(frozen, at, pieces)
    inputs = partial(_inputs, tree, moving, part)
    capacity = 2**stepper.halvings
    shelf = jax.tree.map(lambda a: _set_row(jnp.zeros((capacity, *a.shape), a.dtype), a, 0), (at.s, u))

    def record(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        i, now, shelf = carry
        after, u, _ = substep_once(stepper, *inputs(at._replace(s=now)))
        shelf = jax.tree.map(lambda all_, one: _set_row(all_, one, i), shelf, (now, u))
        return i + 1, after, shelf

    _, _, shelf = jax.lax.while_loop(lambda c: c[0] < pieces, record, (jnp.zeros((), jnp.int32), at.s, shelf))

    def piece(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        i, ct, others = carry
        now, u = jax.tree.map(lambda all_: all_[i], shelf)
        found = _backward_step(stepper, stepper.fallback, inputs, at._replace(s=now), ct, u)
        return i - 1, found.s, jax.tree.map(jnp.add, others, (found.model, found.h))

    none = jax.tree.map(jnp.zeros_like, (at.model, at.h))
    last = (jnp.maximum(pieces, 1) if one_way else pieces) - 1
    _, ct, (ct_model, ct_h) = jax.lax.while_loop(lambda c: c[0] >= 0, piece, (last, cotangent, none))
    split = _At(ct_model, ct, [c / jnp.maximum(pieces, 1) for c in ct_h])
    return split if one_way else jax.tree.map(lambda a, b: jnp.where(pieces > 0, a, b), split, whole)


def _set_row(rows: jax.Array, row: jax.Array, i: jax.Array | int) -> jax.Array:
    return jax.lax.dynamic_update_index_in_dim(rows, row, i, axis=0)  # `.at[i].set` is a scatter


@in_chosen_form
def _forward_step(stepper: Stepper, solver: str, inputs: Inputs, at: _At, given: _At, u: Unknowns) -> State:
    problem = stepper.integrator.problem(*inputs(at))
    linear = SOLVERS[solver]
    factor = linear.factor(problem, u)
    rows = jax.jvp(lambda x: stepper.integrator.problem(*inputs(x)).residual(u), (at,), (given,))[1]
    right = jax.tree.map(jnp.negative, rows)
    if stepper.batched and stepper.integrator.exact and solver == "condensed":
        du = linear.apply(factor, right)
    else:
        _, jacobian = jax.linearize(problem.residual, u)
        du = refine(jacobian, partial(linear.apply, factor), right, problem.column_scale())
    return jax.jvp(lambda x, w: stepper.integrator.problem(*inputs(x)).finish(w), (at, u), (given, du))[1]


@in_chosen_form
def _backward_step(stepper: Stepper, solver: str, inputs: Inputs, at: _At, cotangent: State, u: Unknowns) -> _At:
    problem = stepper.integrator.problem(*inputs(at))
    linear = SOLVERS[solver]
    factor = linear.factor(problem, u)
    _, backward_end = jax.vjp(lambda x, w: stepper.integrator.problem(*inputs(x)).finish(w), at, u)
    ct_at, ct_u = backward_end(cotangent)
    _, backward_rows = jax.vjp(lambda x: stepper.integrator.problem(*inputs(x)).residual(u), at)
    _, transpose = jax.vjp(problem.residual, u)
    inverse_scale = jax.tree.map(lambda a: 1 / a, problem.row_scale())
    adjoint = refine(lambda w: transpose(w)[0], partial(linear.apply_transposed, factor), ct_u, inverse_scale)
    (through,) = backward_rows(jax.tree.map(jnp.negative, adjoint))
    return jax.tree.map(jnp.add, ct_at, through)


def step(
    stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array | bool = True
) -> tuple[State, Report]:
    """Advance `s` by `h`. Failed runs (`alive` False: an earlier step failed) are not retried."""
    if s.parted is not None:
        return step_and_part(lambda current, now: step(stepper, current, now, h, alive), model, s)
    integrator = stepper.integrator
    if not integrator.implicit:
        return _explicit(integrator, model, s, h)
    if len(integrator.stages) == 1:
        return _implicit(stepper, model, s, h, alive)

    def stage(s: State, fraction: jax.Array) -> tuple[State, Report]:
        return _implicit(stepper, model, s, fraction * h, alive)

    # a scan, not an unrolled loop: five copies of a step would take five times as long to compile
    s, reports = jax.lax.scan(stage, s, jnp.asarray(integrator.stages, model.dtype))
    return s, Report(jnp.max(reports.residual), jnp.max(reports.level))


def _explicit(integrator: Explicit, model: Model, s: State, h: jax.Array) -> tuple[State, Report]:
    before, s = s, integrator.advance(model.with_internal_state(s.own), s, h)
    finite = jnp.all(jnp.isfinite(s.r)) & jnp.all(jnp.isfinite(s.v))
    residual = jnp.where(finite, 0.0, jnp.nan).astype(model.dtype)
    return s, Report(limit_pace(model, before, s, residual), jnp.full((), FULL_STEP, jnp.int32))


def _implicit(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array | bool) -> tuple[State, Report]:
    s1, residual, level = _solve_step(stepper.as_traced, model, s, jnp.asarray(h, model.dtype), jnp.asarray(alive))
    return s1, Report(residual, level)


def step_and_part(advance: Callable[[Model, State], tuple[State, Any]], model: Model, s: State) -> tuple[State, Any]:
    """One step by `advance` with broken links, and the links that break at its end.

    The energy of stretch and bending of a link is lost when it breaks, and counted as `breaking`.
    """
    before = as_parted(model, s.parted)
    s1, report = advance(before, dataclasses.replace(s, parted=None))
    parted = _part(model, s.parted, s1)
    work = s1.work
    if work.size:
        kept, whole = (m.with_internal_state(s1.own) for m in (as_parted(model, parted), before))
        work = work + book_works(model, {BREAKING: _link_energy(kept, s1) - _link_energy(whole, s1)})
    return dataclasses.replace(s1, parted=parted, work=work), report


def _link_energy(model: Model, s: State) -> jax.Array:
    """Energy [J] of links before they break: of stretch and, for lines with bending stiffness, of bending."""
    k = model.kinematics(s.r, s.v, s.t)
    own = model.line.axial.energy(k.links, model.line.length)
    return sum((e.potential(k) for e in model.effects if e.parts), own)


def _part(model: Model, parted: Parted, s1: State) -> Parted:
    failures = model.line.failures
    tension, t = jax.lax.stop_gradient((s1.tension, s1.t))
    share = tension / failures.load
    named = jnp.asarray(failures.named, jnp.int32)
    link = jnp.where(named >= 0, named, jnp.argmax(share, axis=1))
    # relative rounding of a time that is a whole number of steps
    due = (jnp.max(share, axis=1) >= 1.0) | (t >= failures.time * (1.0 - 1e-9))
    now = due & (parted.link < 0)
    return Parted(
        jnp.where(now, link, parted.link).astype(jnp.int32),
        jnp.where(now, t, parted.t),
        jnp.where(now, tension[link], parted.tension),
    )
