"""Solving one step: check the residual, escalate, report; nothing here is ever differentiated.

Escalation, each stage only where the one before left a residual above tolerance (or not a number):
1. more iterations of the same solver;
2. damped iterations of the exact solver over the whole step;
3. the same over 2, 4, 8, ... substeps.
Stages sit in `while_loop`s that make no trip when all is well, under `vmap` too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.model import Model, State
from dropper_jax.newton import damped_newton, newton, newton_until
from dropper_jax.problem import Integrator, StepProblem
from dropper_jax.solvers import SOLVERS
from dropper_jax.system import Unknowns

#: The one tolerance: largest scaled residual row of a converged step. Rounding leaves about 1e-14 (7 links) to
#: 1e-12 (1000 links, nodes far from the origin) in float64; in float32 about 1e-5.
TOLERANCE = {"float64": 1e-11, "float32": 1e-4}

#: With a law iterations end at this part of the tolerance, near rounding, so that what is held does not creep. Most
#: steps slide on and are there after two, one in which a joint turns round takes three or four.
SETTLED = 1e-3

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
        reverse: derivatives in both modes; False, in forward mode alone, leaves the transposed step out of all traces.
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
    reverse: bool = True

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


def solve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> tuple[Any, ...]:
    """End state, unknowns, residual and level of a step; no derivative rule of its own."""
    if stepper.until_converged:
        return _solve_or_halve(stepper, model, s, h, alive)
    problem = stepper.integrator.problem(model, s, h)
    solver = SOLVERS[stepper.solver]
    if model.laws:
        enough = SETTLED * stepper.limit(model)
        u, residual = newton_until(problem, solver, problem.guess(), stepper.iterations, enough)
    else:
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
            now, u, residual = substep(stepper, model, now, h / pieces)
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


def substep(stepper: Stepper, model: Model, s: State, h: jax.Array) -> tuple[State, Unknowns, jax.Array]:
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
            now, _, residual = substep(stepper, model, now, h / pieces)
            return now, jnp.maximum(worst, residual)

        done, worst = jax.lax.fori_loop(0, pieces, piece, (start, jnp.zeros_like(carry[1])))
        return done, worst, level

    return jax.lax.while_loop(go, retry, first)


solve_once = partial(jax.jit, static_argnums=0)(solve)
substep_once = partial(jax.jit, static_argnums=0)(substep)
