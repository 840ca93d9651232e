"""Solve one step: check the residual, escalate, report. This code is never differentiated.

Escalation, each stage only if the residual of the previous one is above tolerance (or NaN):
1. more iterations of the same solver;
2. damped iterations of the exact solver over the full step;
3. damped iterations over 2, 4, 8, ... substeps.
Stages are in `while_loop`s without an iteration if the step converged, also under `vmap`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from dropper_jax.model import LimitsTimeStep, Model, State
from dropper_jax.residual import CONVERGED, Solver, StepProblem, Unknowns, damped_newton, newton, newton_until
from dropper_jax.solvers import SOLVERS
from dropper_jax.stepping.stepper import FULL_STEP, TOO_FAR, Stepper


def solve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> tuple[Any, ...]:
    """End state, unknowns, residual and level of a step, without a derivative rule."""
    with stepper.solving():
        return _solve(stepper, model, s, h, alive)


def _solve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> tuple[Any, ...]:
    if stepper.until_converged:
        return _solve_or_halve(stepper, model, s, h, alive)
    problem = stepper.integrator.problem(model, s, h)
    solver = SOLVERS[stepper.solver]
    if model.laws:
        enough = CONVERGED * stepper.limit(model)
        u, residual, seen = newton_until(problem, solver, problem.guess(), stepper.iterations, enough)
    else:
        u, residual = newton(problem, solver, problem.guess(), stepper.iterations, stepper.limit(model))
        seen = None
    first = problem.finish(u, seen), u, residual, jnp.full((), FULL_STEP, jnp.int32)
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

    # one loop around all stages, so that a converged step costs a single test
    return jax.lax.while_loop(resist, escalate, (jnp.zeros((), bool), first))[1]


def _solve_or_halve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> tuple[Any, ...]:
    """The full step, then 2, 4, 8, ... equal substeps, with a single copy of the step equations in the program.

    Used for systems of lines: a second copy of their equations would double the compile time.
    """
    if not stepper.halvings:
        return *substep(stepper, model, s, h), jnp.full((), FULL_STEP, jnp.int32)
    limit = stepper.limit(model)
    problem = stepper.integrator.problem(model, s, h)
    unsolved = jnp.full((), jnp.inf, model.dtype)
    start = jax.tree.map(jnp.asarray, s), problem.guess(), unsolved, jnp.full((), FULL_STEP - 1, jnp.int32)

    def resist(carry: tuple[Any, ...]) -> jax.Array:
        _, _, residual, level = carry
        retry = ~(residual <= limit) & (level < stepper.halvings) & alive
        return (level < FULL_STEP) | retry

    def attempt(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        level = jnp.where(carry[3] == FULL_STEP, 1, carry[3] + 1)  # one substep would repeat the full step
        pieces = 2 ** jnp.maximum(level, 0)

        def piece(i: jax.Array, inner: tuple[Any, ...]) -> tuple[Any, ...]:
            now, _, worst = inner
            now, u, residual = substep(stepper, model, now, h / pieces)
            return now, u, jnp.maximum(worst, residual)

        s1, u, worst = jax.lax.fori_loop(0, pieces, piece, (start[0], start[1], jnp.zeros_like(unsolved)))
        return s1, u, worst, level

    return jax.lax.while_loop(resist, attempt, start)


def _more_iterations(
    problem: StepProblem, solver: Solver, u: Unknowns, residual: jax.Array, limit: float, extra: int
) -> tuple[Unknowns, jax.Array]:
    bunch = 4

    def go(carry: tuple[Any, ...]) -> jax.Array:
        _, residual, count = carry
        return (residual > limit) & (count < extra // bunch)  # a NaN compares false: more iterations cannot remove it

    def more(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        u, residual = newton(problem, solver, carry[0], bunch)
        return u, residual, carry[2] + 1

    u, residual, _ = jax.lax.while_loop(go, more, (u, residual, jnp.zeros((), jnp.int32)))
    return u, residual


def substep(stepper: Stepper, model: Model, s: State, h: jax.Array) -> tuple[State, Unknowns, jax.Array]:
    """One substep by the fallback solver, damped."""
    with stepper.solving():
        return _substep(stepper, model, s, h)


def _substep(stepper: Stepper, model: Model, s: State, h: jax.Array) -> tuple[State, Unknowns, jax.Array]:
    problem = stepper.integrator.problem(model, s, h)
    solver = SOLVERS[stepper.fallback]
    if stepper.until_converged:
        u, residual, seen = newton_until(problem, solver, problem.guess(), stepper.iterations, stepper.limit(model))
        s1 = problem.finish(u, seen)
        return s1, u, limit_pace(model, s, s1, residual)
    iterations = 3 * stepper.integrator.iterations
    u, residual = damped_newton(problem, solver, problem.guess(), iterations)
    return problem.finish(u), u, residual


def limit_pace(model: Model, s: State, s1: State, residual: jax.Array) -> jax.Array:
    """The residual of a step from s to s1; `TOO_FAR` if nodes moved farther than an effect can follow."""
    watching = model.having(LimitsTimeStep)
    if not watching:
        return residual
    ends = tuple(model.kinematics(now.r, now.v, now.t) for now in (s, s1))
    far = jnp.any(jnp.stack([effect.too_far(*ends) for effect in watching]))
    return jnp.where(far, jnp.maximum(residual, TOO_FAR), residual)  # a NaN remains NaN


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
