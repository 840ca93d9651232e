"""Newton's method on the rows of a step, and linear solves with its Jacobian to rounding."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.base.numerics import store_once
from dropper_jax.residual.problem import StepProblem, Unknowns, add, norm
from dropper_jax.residual.scheme import Solver

Linear = Callable[[Unknowns], Unknowns]
#: Fractions for a cycling iteration.
SEARCHED = (0.85, 0.7, 0.55, 0.4, 0.25, 0.12, 0.06, 0.03)
#: Sequence of smoothings of set-valued laws, as a fraction of the rate that friction stops within the step.
EASING = (1.0,) * 3 + tuple(0.4**k for k in range(1, 31)) + (0.0,) * 4
#: With such a law corrections stop at this fraction of the tolerance, near rounding, so that sticking joints do not
#: creep.
CONVERGED = 1e-3


def newton(
    problem: StepProblem,
    solver: Solver,
    u: Unknowns,
    iterations: int,
    limit: float | None = None,
    extra: jax.Array | None = None,
) -> tuple[Unknowns, jax.Array]:
    """`u <- u - P^-1 R(u)` a fixed number of times; returns the unknowns and the maximum scaled row.

    With a limit corrections stop if the rows are at 1e-5 times it, or below it and no longer decreasing. Rows that are
    still above it get `extra` corrections, in bunches with a matrix of their own.
    """
    if extra is None:
        return _correct(problem, solver, u, iterations, limit)
    bunch = 4

    def go(carry: tuple[Any, ...]) -> jax.Array:
        _, residual, count = carry
        # a NaN compares false: more iterations cannot remove it
        return (count == 0) | ((residual > limit) & (bunch * count <= extra))

    def more(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        u, _, count = carry
        # the first corrections and the extra ones by the same equations: they are in the program once
        some, stops = jnp.where(count == 0, iterations, bunch), (count == 0) & (iterations > 2)
        return *_correct(problem, solver, u, some, limit, stops), count + 1

    start = u, jnp.full((), jnp.inf, u.x.dtype), jnp.zeros((), jnp.int32)
    return jax.lax.while_loop(go, more, start)[:2]


def _correct(
    problem: StepProblem,
    solver: Solver,
    u: Unknowns,
    iterations: int | jax.Array,
    limit: float | None,
    stops: jax.Array | bool = True,
) -> tuple[Unknowns, jax.Array]:
    """Corrections with one prepared matrix; if `stops`, they end early at the limit."""
    prepared, scale = solver.prepare(problem, u), problem.row_scale()

    def rows_at(u: Unknowns) -> Unknowns:
        return store_once(problem.residual(u))

    def apply_correction(u: Unknowns, rows: Unknowns) -> Unknowns:
        return add(u, solver.apply(solver.factor(problem, u, prepared), rows), -1.0)

    # minimum number of iterations
    if limit is None or (isinstance(iterations, int) and iterations <= 2):
        u, _ = jax.lax.scan(lambda u, _: (apply_correction(u, rows_at(u)), None), u, None, length=iterations)
        return u, norm(problem.residual(u), scale)
    # if many iterations are allowed they stop at this fraction of the tolerance, at rounding, to conserve energy
    enough = 1e-5 * limit

    def needs_correction(now: tuple[Any, ...]) -> jax.Array:
        _, _, _, done, count = now
        return ~done & (count < iterations)

    def correct(now: tuple[Any, ...]) -> tuple[Any, ...]:
        u, rows, size, _, count = now
        u = apply_correction(u, rows)
        rows = rows_at(u)
        after = norm(rows, scale)
        # rows within the tolerance that decrease by less than this factor are rounding
        return u, rows, after, stops & ((after <= enough) | ((after <= limit) & (after > 0.3 * size))), count + 1

    rows = problem.residual(u)
    # A good guess is corrected as well: its error would otherwise accumulate over the steps. Under `vmap` a loop ends
    # with its slowest member, whereas a `scan` of conditions would correct every member `iterations` times.
    start = u, rows, norm(rows, scale), jnp.zeros((), bool), jnp.zeros((), jnp.int32)
    u, _, size, _, _ = jax.lax.while_loop(needs_correction, correct, start)
    return u, size


class Found(NamedTuple):
    """End of an iteration.

    Attributes:
        u: the unknowns.
        residual: maximum scaled row there, scalar.
        evaluated: intermediate values of the problem there (`StepProblem.evaluate`).
    """

    u: Unknowns
    residual: jax.Array
    evaluated: Any


@jax.custom_jvp
def _apply_correction(u: Unknowns, du: Unknowns, fraction: jax.Array) -> Unknowns:
    """`u - fraction du`, whose derivative is that of the whole correction."""
    return add(u, du, -fraction)


@_apply_correction.defjvp
def _apply_correction_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Unknowns, Unknowns]:
    return _apply_correction(*primals), add(*tangents[:2], -1.0)


def newton_until(
    problem: StepProblem, solver: Solver, u: Unknowns, most: int, limit: float, still: StepProblem | None = None
) -> Found:
    """Iterate until the rows are below `limit`, at most `most` times.

    For systems with slack lines and contact: most steps need three corrections, those with a switch up to a dozen.
    If the stiffness of a link or a contact has a maximum within a correction (a damper at its limit, a lagging spring),
    full corrections may cycle between both sides: these are shortened.

    The guess is evaluated by the loop itself, after a correction of zero, so that the rows are in the program once: a
    seventh of the operations of a longline's step. In a batch this costs one more Jacobian per step.

    With `still`, the same problem without tangents, forward mode of these iterations is the implicit derivative:

        du <- du - P^-1 (R_theta dtheta + R_u du)

    Its matrix is that of the corrections, and a last correction, at the solution, changes the tangents only.
    """
    held, fixed = still or problem, jax.lax.stop_gradient
    scale = held.row_scale()
    evaluated = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(problem.evaluate, u)[1])
    # minimum number of corrections of a step: in float32 a guess may be within the tolerance, and a line would not move
    least = {"float32": 2}.get(str(u.x.dtype), 0)
    fractions, never = jnp.asarray(SEARCHED, u.x.dtype), jnp.full((), jnp.inf, u.x.dtype)

    def keep_iterating(carry: tuple[Any, ...]) -> jax.Array:
        _, _, _, size, (last, _), count = carry
        # a NaN compares false: more iterations cannot remove it
        more = (count < least) | ((size > limit) & (count < most))
        return more if still is None else more | ((size <= limit) & (last > limit))

    def correct(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        u, rows, evaluated, size, (last, last_but_one), count = carry
        du = jax.lax.cond(
            count < 0,
            lambda: jax.tree.map(jnp.zeros_like, u),
            lambda: solver.apply(solver.factor(held, fixed(u)), rows),
        )
        solved = (size <= limit) & (count >= least)
        # a cycling iteration has rows above this fraction of their value two corrections before
        circling = (size > 0.5 * last_but_one) & ~solved
        # one evaluation with the full correction, or one with each fraction and one with the best
        most_trials = jnp.where(circling, len(SEARCHED), 0)

        def unseen(trial: tuple[Any, ...]) -> jax.Array:
            return trial[0] <= most_trials

        def try_fraction(trial: tuple[Any, ...]) -> tuple[Any, ...]:
            k, best, least, _ = trial
            fraction = jnp.where(k < most_trials, fractions[jnp.minimum(k, len(SEARCHED) - 1)], best)
            rows, evaluated = problem.evaluate(_apply_correction(u, du, fraction))
            size = norm(fixed(rows), scale)
            better = (k < most_trials) & (size < least)  # false where they are not finite
            return (
                k + 1,
                jnp.where(better, fraction, best),
                jnp.where(better, size, least),
                (fraction, rows, evaluated, size),
            )

        none = jnp.zeros((), jnp.int32)
        whole = jnp.where(solved, 0.0, 1.0)
        first = none, jnp.where(circling, fractions[0], whole), never, (never, rows, evaluated, size)
        fraction, rows, evaluated, after = jax.lax.while_loop(unseen, try_fraction, first)[-1]
        return _apply_correction(u, du, fraction), rows, evaluated, after, (size, last), count + 1

    # no rows yet: arrays of their shapes, with tangents where they will have some, so that JAX differentiates once
    start = u, u, evaluated, never, (never, never), jnp.full((), -1, jnp.int32)
    u, _, evaluated, size, _, _ = jax.lax.while_loop(keep_iterating, correct, start)
    return Found(u, size, evaluated)


def damped_newton(problem: StepProblem, solver: Solver, u: Unknowns, iterations: int) -> tuple[Unknowns, jax.Array]:
    """Iterate with each correction shortened if that gives a smaller residual; for steps that do not converge."""
    if problem.model.laws:
        return follow(problem, solver, u)
    scale = problem.row_scale()
    # fractions of a correction that are tried; the residual must fall
    fractions, never = jnp.asarray((1.0, 0.5, 0.2, 0.05), u.x.dtype), jnp.full((), jnp.inf, u.x.dtype)

    def correct(now: tuple[Unknowns, Unknowns], _: None) -> tuple[tuple[Unknowns, Unknowns], None]:
        u, rows = now
        du = solver.apply(solver.factor(problem, u), rows)

        def try_fraction(k: jax.Array, best: tuple[Any, ...]) -> tuple[Any, ...]:
            moved = add(u, du, -fractions[k])
            rows = problem.residual(moved)
            size = norm(rows, scale)
            better = size < best[-1]  # false where they are not finite
            return jax.tree.map(lambda a, b: jnp.where(better, a, b), (moved, rows, size), best)

        # a loop, not a batch: one more copy of the rows in the program instead of three
        u, rows, _ = jax.lax.fori_loop(0, len(fractions), try_fraction, (u, rows, never))
        return (u, rows), None

    (u, rows), _ = jax.lax.scan(correct, (u, problem.residual(u)), None, length=iterations)
    return u, norm(rows, scale)


def follow(problem: StepProblem, solver: Solver, u: Unknowns) -> tuple[Unknowns, jax.Array]:
    """Solve with smoothed laws, reduce the smoothing in stages, and finally solve the laws themselves.

    This continuation determines which joints slide and which stick. Newton on the laws themselves cycles if several
    joints stop at once. The primal-dual form of the smoothed law (Chan, Golub and Mulet 1999) allows full corrections
    while its unknowns are admissible.
    """

    def correct(u: Unknowns, easing: jax.Array) -> tuple[Unknowns, None]:
        smoothed_problem = problem.with_smoothing(easing)
        u = add(u, solver.apply(solver.factor(smoothed_problem, u), smoothed_problem.residual(u)), -1.0)
        laws = problem.model.laws
        z = tuple(law.admissible(z) for law, z in zip(laws, u.z, strict=False))  # then multipliers
        return u._replace(z=z + u.z[len(laws) :]), None

    u, _ = jax.lax.scan(correct, u, jnp.asarray(EASING, u.x.dtype))
    return u, norm(problem.residual(u), problem.row_scale())


def refine(matvec: Linear, apply: Linear, b: Unknowns, column_scale: Unknowns) -> Unknowns:
    """Solve `J x = b` with the solver's `apply` = P^-1 as preconditioner, until x stops changing.

    Stationary iteration `x <- x + P^-1 (b - J x)`, which is equivalent to Newton with P and converges as fast. It stops
    when a correction is below 1000 rounding errors of x, or no longer decreases.
    """
    x = apply(b)
    enough = 1e3 * jnp.finfo(b.x.dtype).eps

    def keep_iterating(carry: tuple[Any, ...]) -> jax.Array:
        _, _, change, before, size, count = carry
        # maximum number of preconditioned corrections of a derivative solve. The condensed solver needs about as many
        # as Newton
        return (change > enough * size) & (count < 200) & ((change < before) | (count < 8))

    def correct(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        x, _, change, _, _, count = carry
        dx = apply(add(b, matvec(x), -1.0))
        x = add(x, dx)
        return x, dx, norm(dx, column_scale), change, norm(x, column_scale), count + 1

    size = norm(x, column_scale)
    start = (x, x, size, jnp.full_like(size, jnp.inf), size, jnp.zeros((), jnp.int32))
    return jax.lax.while_loop(keep_iterating, correct, start)[0]
