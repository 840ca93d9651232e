"""Exact derivatives of a study by its parameters: of its start, its run and its quantity, each a small program."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State, state
from dropper_jax.modelling.build import initial_state
from dropper_jax.residual import Stepper
from dropper_jax.statics.host_stiffness import follow_parameters
from dropper_jax.statics.loads import release_loads
from dropper_jax.statics.rest_problem import rest, unbalanced_at
from dropper_jax.statics.search import outward
from dropper_jax.stepping.equal_steps import advance_and_save
from dropper_jax.stepping.integrate import Steps, empty_trajectory, scan_steps
from dropper_jax.stepping.progress import Progress, Trajectory, begin
from fitting.parameters.forward_derivatives import WithSlopes, differentiate, floats_of, split, swap_rows
from fitting.parameters.parameter import Parameter, with_parameter_values
from fitting.sensitivity.problem import Study, StudyProgram, start_as_trajectory
from fitting.sensitivity.study_steps import padded, saved_times


def _differentiate(
    function: Callable[..., Any], parameters: Sequence[Parameter], model: Model, values: Array, *given: WithSlopes
) -> WithSlopes:
    """`function(model, *trees)` with its derivatives by the parameters, of which the trees are functions too."""

    def of_values(p: Array, *trees: Any) -> Any:
        return function(with_parameter_values(model, parameters, p), *trees)

    return differentiate(of_values, values, jnp.eye(len(values)), *given)


def differentiate_start(plan: StudyProgram, model: Model, s: State, values: Array) -> WithSlopes:
    """The initial state s of the model with these values, and its derivatives; a small program for elastic lines."""
    still = rest(model)
    if not plan.start_spec.is_static or still.constraints or outward(model) or not still.line.axial.elastic:
        return _differentiate_any_start(plan, model, s, values)
    count = len(values)
    found, unsolved = follow_parameters(still, count, partial(_slopes_at_rest, plan, model, s, values))
    return WithSlopes(found.tree, [x[-count:].at[unsolved].set(jnp.nan) for x in found.slopes])


@cached_jit(static=("plan",))
def _differentiate_any_start(plan: StudyProgram, model: Model, s: State, values: Array) -> WithSlopes:
    """The same for any initial state."""
    return _differentiate(
        lambda changed: initial_state(changed, plan.start_spec, s, is_equilibrium=True), plan.parameters, model, values
    )


@cached_jit(static=("plan",))
def _slopes_at_rest(
    plan: StudyProgram, model: Model, s: State, values: Array, by_value: Array, by_position: Array
) -> tuple[Array, WithSlopes]:
    """Derivatives of the unbalanced forces (k, free, 3) [N] at rest, and of the state, along k directions of the
    parameters (k, p) and of the positions (k, free, 3) [m]."""

    def at(p: Array, x: Array) -> tuple[tuple[Array, list[Array]], State]:
        full = with_parameter_values(model, plan.parameters, p)
        loads = release_loads(full, plan.start_spec)
        rows, tension = unbalanced_at(rest(full), state(full, s.r), loads, x)
        found = state(full, s.r + x, tension=tension)
        return (rows, floats_of(found)), found

    def along(*direction: Array) -> tuple[Array, WithSlopes]:
        _, (rows, slopes), found = jax.jvp(at, (values, jnp.zeros_like(s.r)), direction, has_aux=True)
        return rows, WithSlopes(found, slopes)

    directions = (part.astype(model.dtype) for part in (by_value, by_position))
    return jax.vmap(along, out_axes=(0, WithSlopes(None, 0)))(*directions)


class _RunBetween(NamedTuple):
    """A run between two saved times: its state, and the tensions over the time since the last one (n,) [N s]."""

    progress: Progress
    impulse: Array


def _take_step(
    stepper: Stepper, is_adaptive: bool, h: Array, before: Array, since: Array, model: Model, run: _RunBetween
) -> tuple[_RunBetween, Trajectory]:
    """One step of h [s] after one of `before` [s], to the time `since` the last saved one [s]; and the row to save
    after it, of steps that follow an accuracy with mean tensions."""
    if not is_adaptive:
        progress, row = advance_and_save(stepper, model, run.progress, h)
        return run._replace(progress=progress), row
    progress, row = advance_and_save(stepper, model, run.progress, h[None], before=before[None])
    impulse = run.impulse + h * row.tension
    return _RunBetween(progress, impulse), row._replace(tension=impulse / since)


class _StepLoop(NamedTuple):
    """The loop over the steps between two saved times: the run, the row to save, and the time since the last one."""

    now: WithSlopes
    row: WithSlopes
    since: Array


@cached_jit(static=("stepper", "parameters", "is_adaptive"), kernel=True)
def _differentiate_run(
    stepper: Stepper,
    parameters: tuple[Parameter, ...],
    is_adaptive: bool,
    model: Model,
    values: Array,
    start: WithSlopes,
    steps: Steps,
    count: Array | int,
) -> WithSlopes:
    """`count` saved states of a run along known steps, in the first of as many rows as these have ends, with
    derivatives: one program for any duration, quantity and start.
    """

    def save(now: WithSlopes, i: Array) -> tuple[WithSlopes, WithSlopes]:
        first = jnp.where(i > 0, steps.ends[i - 1], 0)
        nothing = now.tree._replace(impulse=jnp.zeros_like(now.tree.impulse))
        now = WithSlopes(nothing, [*now.slopes[:-1], jnp.zeros_like(now.slopes[-1])])

        def take(k: Array, loop: _StepLoop) -> _StepLoop:
            h = steps.length[k]
            since = loop.since + h
            before = jnp.where(k > 0, steps.length[k - 1], 0.0)
            one = partial(_take_step, stepper, is_adaptive, h, before, since)
            after, new = split(_differentiate(one, parameters, model, values, loop.now))
            return _StepLoop(after, new._replace(tree=_add_row(loop.row.tree, new.tree)), since)

        loop = _StepLoop(now, jax.tree.map(lambda x: x[0], rows), jnp.zeros((), model.dtype))
        loop = jax.lax.fori_loop(first, steps.ends[i], take, loop)
        return loop.now, loop.row

    def start_run(changed: Model, s: State) -> _RunBetween:
        return _RunBetween(begin(stepper, changed, s), jnp.zeros_like(s.tension))

    now = _differentiate(start_run, parameters, model, values, start)
    capacity = len(steps.ends)
    rows = empty_trajectory(now.tree.progress, capacity)
    slopes = [jnp.zeros((capacity, len(values), *x.shape[1:]), x.dtype) for x in floats_of(rows)]
    rows = WithSlopes(rows, slopes)
    return swap_rows(scan_steps(save, now, count, rows)[1])


def _add_row(earlier: Trajectory, row: Trajectory) -> Trajectory:
    """The row after a step, with the maximum residual and the counts of all steps since the last saved time."""
    return row._replace(
        residual=jnp.maximum(earlier.residual, row.residual),
        retried=earlier.retried + row.retried,
        failed=earlier.failed + row.failed,
    )


@cached_jit(static=("plan",))
def _differentiate_quantity(
    plan: StudyProgram, model: Model, values: Array, start: WithSlopes, run: WithSlopes | None, t: Array | np.ndarray
) -> WithSlopes:
    """The quantity of a run from `start` with states saved at t (k,) [s], or of the start alone."""
    if run is None:

        def measure_start(changed: Model, s: State) -> Array:
            return plan.measure(changed, s, start_as_trajectory(s), s.t[None])

        return _differentiate(measure_start, plan.parameters, model, values, start)
    return _differentiate(partial(plan.measure, t=jnp.asarray(t)), plan.parameters, model, values, start, run)


def differentiate_study(
    problem: Study, at: Array, start: WithSlopes, steps: Steps
) -> tuple[WithSlopes, WithSlopes | None]:
    """The quantity of a run from `start` along these steps, and the run, with derivatives."""
    plan = problem.plan
    model = problem.model
    t = start.tree.t
    if plan.of.at_rest:
        return _differentiate_quantity(plan, model, at, start, None, t[None]), None
    saves = len(steps.ends)
    run = _differentiate_run(plan.stepper, plan.parameters, plan.is_adaptive, model, at, start, padded(steps), saves)
    rows = jax.tree.map(lambda x: np.asarray(x)[:saves], run.tree)
    if np.any(steps.failed):
        rows = rows._replace(first_bad=np.zeros_like(rows.first_bad))
    run = WithSlopes(rows, [np.asarray(x)[:, :saves] for x in run.slopes])
    return _differentiate_quantity(plan, model, at, start, run, np.asarray(t) + saved_times(steps)), run
