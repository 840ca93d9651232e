"""One step that never raises: solve, check, escalate, report; with exact derivatives in both modes.

Escalation, each stage only where the one before left a residual above tolerance (or not a number):
1. more iterations of the same solver;
2. damped iterations of the exact solver over the whole step;
3. the same over 2, 4, 8, ... substeps.
Stages sit in `while_loop`s that make no trip when all is well, under `vmap` too.

Derivatives follow from the implicit function theorem at the solution, never through the iterations: with rows
`R(theta, u) = 0` and end state `S(theta, u)`, `theta` = (model, state, step size),

    du = -R_u^-1 R_theta dtheta,    dS = S_theta dtheta + S_u du,

and its transpose for reverse mode. A step that was halved chains its substeps, recomputed when asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from dropper_jax.model import Model, State
from dropper_jax.newton import damped_newton, newton, newton_until, refine
from dropper_jax.problem import Integrator, StepProblem
from dropper_jax.solvers import SOLVERS
from dropper_jax.system import Unknowns, norm

#: The one tolerance: largest scaled residual row of a converged step. Rounding leaves about 1e-14 (7 links) to
#: 1e-12 (1000 links, nodes far from the origin) in float64; in float32 about 1e-5.
TOLERANCE = {"float64": 1e-11, "float32": 1e-4}

FULL_STEP = -1  # level of a step that needed no retry


@dataclass(frozen=True)
class Stepper:
    """Everything static about stepping.

    Attributes:
        integrator: the scheme.
        solver, fallback: names of the first and the last-resort linear solver.
        iterations: Newton iterations of every step.
        tolerance: largest scaled residual of a converged step; None takes `TOLERANCE` of the model's precision.
        extra: further iterations of the first solver before anything else is tried.
        halvings: most times a step is halved; 0 disables retries altogether.
        track_work: count the work of each effect in `State.work`.
        until_converged: iterate each step until it has converged, at most `iterations` times, and halve what has not;
            for systems of lines.
    """

    integrator: Integrator
    solver: str
    fallback: str
    iterations: int
    tolerance: float | None = None
    extra: int = 48
    halvings: int = 6
    track_work: bool = True
    until_converged: bool = False

    def limit(self, model: Model) -> float:
        return TOLERANCE[str(jnp.dtype(model.dtype))] if self.tolerance is None else self.tolerance


class Report(NamedTuple):
    """How a step went.

    Attributes:
        residual: largest scaled row at its end (NaN when not finite).
        level: -1 when the step solved as a whole at first, k >= 0 when it took 2^k substeps of the fallback solver.
    """

    residual: jax.Array
    level: jax.Array


def step(
    stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array | bool = True
) -> tuple[State, Report]:
    """Advance `s` by `h`. Dead runs (`alive` False: an earlier step failed) are not retried."""
    integrator = stepper.integrator
    if not integrator.implicit:
        return _explicit(stepper, model, s, h)
    if len(integrator.stages) == 1:
        return _implicit(stepper, model, s, h, alive)

    def stage(s: State, fraction: jax.Array) -> tuple[State, Report]:
        return _implicit(stepper, model, s, fraction * h, alive)

    # a scan, not an unrolled loop: five copies of a step would take five times as long to compile
    s, reports = jax.lax.scan(stage, s, jnp.asarray(integrator.stages, model.dtype))
    return s, Report(jnp.max(reports.residual), jnp.max(reports.level))


def _explicit(stepper: Stepper, model: Model, s: State, h: jax.Array) -> tuple[State, Report]:
    s = stepper.integrator.advance(model, s, h)
    finite = jnp.all(jnp.isfinite(s.r)) & jnp.all(jnp.isfinite(s.v))
    residual = jnp.where(finite, 0.0, jnp.nan).astype(model.dtype)
    return s, Report(residual, jnp.full((), FULL_STEP, jnp.int32))


def _implicit(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array | bool) -> tuple[State, Report]:
    s1, residual, level = _solved(stepper, model, s, jnp.asarray(h, model.dtype), jnp.asarray(alive))
    return s1, Report(residual, level)


def _solve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> tuple[Any, ...]:
    """End state, unknowns, residual and level of a step; no derivative rule of its own."""
    if stepper.until_converged:
        return _solve_or_halve(stepper, model, s, h, alive)
    problem = stepper.integrator.problem(model, s, h)
    solver = SOLVERS[stepper.solver]
    u, residual = newton(problem, solver, problem.guess(), stepper.iterations)
    first = problem.finish(u), u, residual, jnp.full((), FULL_STEP, jnp.int32)
    if not (stepper.extra or stepper.halvings):
        return first
    limit = stepper.limit(model)

    def resist(carry: tuple[Any, ...]) -> jax.Array:
        tried, (_, _, residual, _) = carry
        return ~(residual <= limit) & ~tried & alive

    def escalate(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        _, (s1, u, residual, level) = carry
        if stepper.extra:
            u, residual = _more_iterations(problem, solver, u, residual, limit, stepper.extra)
            s1 = problem.finish(u)
        if stepper.halvings:
            s1, residual, level = _halve(stepper, model, s, h, (s1, residual, level))
        return jnp.ones((), bool), (s1, u, residual, level)

    # one loop around all of it, so that a good step pays for a single test
    return jax.lax.while_loop(resist, escalate, (jnp.zeros((), bool), first))[1]


def _solve_or_halve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> tuple[Any, ...]:
    """The whole step, then 2, 4, 8, ... substeps of the same kind: the step's equations stand in the program once.

    What a system of lines takes: a second copy of its equations would double the time to compile.
    """
    limit = stepper.limit(model)
    problem = stepper.integrator.problem(model, s, h)
    unsolved = jnp.full((), jnp.inf, model.dtype)
    start = jax.tree.map(jnp.asarray, s), problem.guess(), unsolved, jnp.full((), FULL_STEP - 1, jnp.int32)

    def resist(carry: tuple[Any, ...]) -> jax.Array:
        _, _, residual, level = carry
        retry = ~(residual <= limit) & (level < stepper.halvings) & alive
        return (level < FULL_STEP) | retry

    def attempt(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        level = jnp.where(carry[3] == FULL_STEP, 1, carry[3] + 1)  # one substep would be the whole step again
        pieces = 2 ** jnp.maximum(level, 0)

        def piece(i: jax.Array, inner: tuple[Any, ...]) -> tuple[Any, ...]:
            now, _, worst = inner
            now, u, residual = _substep(stepper, model, now, h / pieces)
            return now, u, jnp.maximum(worst, residual)

        s1, u, worst = jax.lax.fori_loop(0, pieces, piece, (start[0], start[1], jnp.zeros_like(unsolved)))
        return s1, u, worst, level

    return jax.lax.while_loop(resist, attempt, start)


def _more_iterations(
    problem: StepProblem, solver: Any, u: Unknowns, residual: jax.Array, limit: float, extra: int
) -> tuple[Unknowns, jax.Array]:
    bunch = 4

    def go(carry: tuple[Any, ...]) -> jax.Array:
        _, residual, count = carry
        return (residual > limit) & (count < extra // bunch)  # a NaN compares false: iterating cannot mend it

    def more(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        u, residual = newton(problem, solver, carry[0], bunch)
        return u, residual, carry[2] + 1

    u, residual, _ = jax.lax.while_loop(go, more, (u, residual, jnp.zeros((), jnp.int32)))
    return u, residual


def _substep(stepper: Stepper, model: Model, s: State, h: jax.Array) -> tuple[State, Unknowns, jax.Array]:
    """One substep by the fallback solver, damped."""
    problem = stepper.integrator.problem(model, s, h)
    solver = SOLVERS[stepper.fallback]
    if stepper.until_converged:
        u, residual = newton_until(problem, solver, problem.guess(), stepper.iterations, stepper.limit(model))
        return problem.finish(u), u, residual
    iterations = 3 * stepper.integrator.iterations
    u, residual = damped_newton(problem, solver, problem.guess(), iterations)
    return problem.finish(u), u, residual


def _halve(stepper: Stepper, model: Model, s: State, h: jax.Array, first: tuple[Any, ...]) -> Any:
    limit = stepper.limit(model)
    start = jax.tree.map(jnp.asarray, s)

    def go(carry: tuple[Any, ...]) -> jax.Array:
        _, residual, level = carry
        return ~(residual <= limit) & (level < stepper.halvings)

    def retry(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        level = carry[2] + 1
        pieces = 2**level

        def piece(i: jax.Array, inner: tuple[State, jax.Array]) -> tuple[State, jax.Array]:
            now, worst = inner
            now, _, residual = _substep(stepper, model, now, h / pieces)
            return now, jnp.maximum(worst, residual)

        done, worst = jax.lax.fori_loop(0, pieces, piece, (start, jnp.zeros_like(carry[1])))
        return done, worst, level

    return jax.lax.while_loop(go, retry, first)


_solve_once = partial(jax.jit, static_argnums=0)(_solve)
_substep_once = partial(jax.jit, static_argnums=0)(_substep)


# --- derivatives ------------------------------------------------------------------------------------------------


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _solved(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> Any:
    solve = _solve_once if model.laws else _solve
    s1, _, residual, level = solve(stepper, model, s, h, alive)
    return s1, residual, level


@partial(_solved.defjvp, symbolic_zeros=True)
def _solved_jvp(stepper: Stepper, primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> Any:
    model, s, h, alive = primals
    s1, u, residual, level = _solve_once(stepper, model, s, h, alive)
    leaves, tree = jax.tree.flatten(model)
    dmodel, ds, dh = (jax.tree.leaves(dot, is_leaf=_is_zero) for dot in tangents[:3])
    moving = tuple(i for i, dot in enumerate(dmodel) if not _is_zero(dot))
    filled = [jnp.zeros_like(x) if _is_zero(dot) else dot for x, dot in zip(jax.tree.leaves(s), ds, strict=True)]
    given = _At([dmodel[i] for i in moving], jax.tree.unflatten(jax.tree.structure(s), filled), _nonzero(dh))
    at = _At([leaves[i] for i in moving], s, [h] if given.h else [])
    frozen = leaves, h, u, level
    forward = partial(_forward, stepper, tree, moving, frozen, at)
    backward = partial(_backward, stepper, tree, moving, frozen, at)
    ds1 = _linear(forward, backward, given, s1, (frozen, at))
    zeros = jnp.zeros_like(residual), jnp.zeros(level.shape, jax.dtypes.float0)
    return (s1, residual, level), (ds1, *zeros)


class _At(NamedTuple):
    """What a step is differentiated with respect to: some leaves of the model, the state, the step (or nothing)."""

    model: list[jax.Array]
    s: State
    h: list[jax.Array]


def _is_zero(dot: Any) -> bool:
    return isinstance(dot, SymbolicZero)


def _nonzero(dots: list[Any]) -> list[Any]:
    return [dot for dot in dots if not _is_zero(dot)]


def _linear(forward: Any, backward: Any, given: Any, like: Any, residuals: Any) -> Any:
    """Apply the linear map `forward`, whose transpose is `backward`, so that JAX can transpose and batch it.

    It is the solution x = (a, forward(a)) of `[[1, 0], [-forward, 1]] x = (a, 0)`, which JAX's linear solve carries
    together with the transposed solve. The matrix itself is never applied; differentiating it again is refused.
    """
    nothing = 0.0 * jnp.sum(
        jax.tree.leaves(given)[0]
    )  # a zero that depends on the input: the transpose rule wants no constants
    zeros = jax.tree.map(lambda a: jnp.broadcast_to(nothing, a.shape).astype(a.dtype), like)

    def matrix(x: Any) -> Any:
        one = _first_derivatives_only(residuals)
        return jax.tree.map(lambda a: a * one.astype(a.dtype), x)

    def solve(_: Any, b: Any) -> Any:
        return b[0], jax.tree.map(jnp.add, forward(b[0]), b[1])

    def transpose_solve(_: Any, b: Any) -> Any:
        return jax.tree.map(jnp.add, b[0], backward(b[1])), b[1]

    return jax.lax.custom_linear_solve(matrix, (given, zeros), solve, transpose_solve)[1]


def _first_derivatives_only(residuals: Any) -> jax.Array:
    """A one that depends on the residuals and refuses to be differentiated."""
    return 1.0 + _refusing.bind(0.0 * sum(jnp.sum(leaf) for leaf in jax.tree.leaves(residuals)))


def _refuse_second(primals: Any, tangents: Any) -> Any:
    raise NotImplementedError("second derivatives of a run are not available; take differences of first derivatives")


# A primitive, because partial evaluation (reverse mode) forgets the rules of custom_jvp functions. It stands in a
# matrix that is never applied, so that it is in no compiled program.
_refusing = Primitive("first_derivatives_only")
_refusing.def_impl(lambda x: x)
_refusing.def_abstract_eval(lambda x: x)
mlir.register_lowering(_refusing, lambda _, x: [x])
batching.primitive_batchers[_refusing] = lambda args, dims: (_refusing.bind(*args), dims[0])
ad.primitive_jvps[_refusing] = _refuse_second


# The functions below are traced once per kind of run, not each time that JAX looks at the derivative rule (it does so
# two or three times, and traces forward and transposed solve each time): tracing would cost more than compiling.


def _inputs(tree: Any, moving: tuple[int, ...], frozen: Any, at: _At) -> tuple[Model, State, jax.Array]:
    leaves = list(frozen[0])
    for i, value in zip(moving, at.model, strict=True):
        leaves[i] = value
    return jax.tree.unflatten(tree, leaves), at.s, at.h[0] if at.h else frozen[1]


def _pieces(level: jax.Array) -> jax.Array:
    """Substeps of a halved step, 0 of a whole one."""
    return jnp.where(level >= 0, 2 ** jnp.maximum(level, 0), 0)


def _cut(frozen: Any, at: _At, pieces: jax.Array) -> tuple[Any, _At]:
    """The same for one of several substeps."""
    many = jnp.maximum(pieces, 1)
    return (frozen[0], frozen[1] / many, *frozen[2:]), at._replace(h=[h / many for h in at.h])


@partial(jax.jit, static_argnums=(0, 1, 2))
def _forward(stepper: Stepper, tree: Any, moving: tuple[int, ...], frozen: Any, at: _At, given: _At) -> State:
    """Tangent of a step: of its one solve, or of its chain of substeps where it was halved."""
    _, _, u, level = frozen
    whole = _push(stepper, stepper.solver, partial(_inputs, tree, moving, frozen), at, given, u)
    if not stepper.halvings:
        return whole
    pieces = _pieces(level)
    part, at = _cut(frozen, at, pieces)
    given = given._replace(h=[dh / jnp.maximum(pieces, 1) for dh in given.h])
    inputs = partial(_inputs, tree, moving, part)

    def piece(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        i, now, dnow = carry
        here = at._replace(s=now)
        after, u, _ = _substep_once(stepper, *inputs(here))
        return i + 1, after, _push(stepper, stepper.fallback, inputs, here, given._replace(s=dnow), u)

    start = (jnp.zeros((), jnp.int32), at.s, given.s)
    _, _, split = jax.lax.while_loop(lambda c: c[0] < pieces, piece, start)
    return jax.tree.map(lambda a, b: jnp.where(pieces > 0, a, b), split, whole)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _backward(stepper: Stepper, tree: Any, moving: tuple[int, ...], frozen: Any, at: _At, cotangent: State) -> _At:
    """Cotangent of a step; the states and unknowns of substeps are found again and kept on a shelf."""
    _, _, u, level = frozen
    one_way = stepper.solver == stepper.fallback  # a whole step is then a chain of one, with half as much to compile
    if not (one_way and stepper.halvings):
        whole = _pull(stepper, stepper.solver, partial(_inputs, tree, moving, frozen), at, cotangent, u)
        if not stepper.halvings:
            return whole
    pieces = _pieces(level)
    part, at = _cut(frozen, at, pieces)
    inputs = partial(_inputs, tree, moving, part)
    room = 2**stepper.halvings
    shelf = jax.tree.map(lambda a: jnp.zeros((room, *a.shape), a.dtype).at[0].set(a), (at.s, u))

    def record(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        i, now, shelf = carry
        after, u, _ = _substep_once(stepper, *inputs(at._replace(s=now)))
        shelf = jax.tree.map(lambda all_, one: all_.at[i].set(one), shelf, (now, u))
        return i + 1, after, shelf

    begun = (jnp.zeros((), jnp.int32), at.s, shelf)
    _, _, shelf = jax.lax.while_loop(lambda c: c[0] < pieces, record, begun)

    def piece(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        i, ct, others = carry
        now, u = jax.tree.map(lambda all_: all_[i], shelf)
        found = _pull(stepper, stepper.fallback, inputs, at._replace(s=now), ct, u)
        return i - 1, found.s, jax.tree.map(jnp.add, others, (found.model, found.h))

    none = jax.tree.map(jnp.zeros_like, (at.model, at.h))
    last = (jnp.maximum(pieces, 1) if one_way else pieces) - 1
    _, ct, (ct_model, ct_h) = jax.lax.while_loop(lambda c: c[0] >= 0, piece, (last, cotangent, none))
    split = _At(ct_model, ct, [c / jnp.maximum(pieces, 1) for c in ct_h])
    return split if one_way else jax.tree.map(lambda a, b: jnp.where(pieces > 0, a, b), split, whole)


def _push(stepper: Stepper, solver: str, inputs: Any, at: _At, given: _At, u: Unknowns) -> State:
    problem = stepper.integrator.problem(*inputs(at))
    linear = SOLVERS[solver]
    factor = linear.factor(problem, u)
    rows = jax.jvp(lambda x: stepper.integrator.problem(*inputs(x)).residual(u), (at,), (given,))[1]
    _, jacobian = jax.linearize(problem.residual, u)
    du = refine(jacobian, partial(linear.apply, factor), jax.tree.map(jnp.negative, rows), problem.column_scale())
    return jax.jvp(lambda x, w: stepper.integrator.problem(*inputs(x)).finish(w), (at, u), (given, du))[1]


def _pull(stepper: Stepper, solver: str, inputs: Any, at: _At, cotangent: State, u: Unknowns) -> _At:
    problem = stepper.integrator.problem(*inputs(at))
    linear = SOLVERS[solver]
    factor = linear.factor(problem, u)
    _, pull_end = jax.vjp(lambda x, w: stepper.integrator.problem(*inputs(x)).finish(w), at, u)
    ct_at, ct_u = pull_end(cotangent)
    _, pull_rows = jax.vjp(lambda x: stepper.integrator.problem(*inputs(x)).residual(u), at)
    _, transpose = jax.vjp(problem.residual, u)
    inverse_scale = jax.tree.map(lambda a: 1 / a, problem.row_scale())
    adjoint = refine(lambda w: transpose(w)[0], partial(linear.apply_transposed, factor), ct_u, inverse_scale)
    (through,) = pull_rows(jax.tree.map(jnp.negative, adjoint))
    return jax.tree.map(jnp.add, ct_at, through)


__all__ = ["FULL_STEP", "TOLERANCE", "Report", "Stepper", "norm", "step"]
