"""Derivatives of many quantities of a run in reverse mode: one run, then one backward pass for all of them.

    J_i = f_i(r_1, T_1, ..., r_K, T_K),    dJ_i = sum_k (df_i/dr_k dr_k + df_i/dT_k dT_k)

A run stores the state before each step and its unknowns (some 0.2 MB a step for 400 links), so the backward pass solves
no step again. Each step costs one factorisation, common to all quantities, and one transposed solve for each. Steps
that do not converge are not halved here: such a run must be repeated with a smaller step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper, Unknowns, finish_step, solve
from dropper_jax.stepping.integrate import begin


class Record(NamedTuple):
    """A run of k steps for the backward pass.

    Attributes:
        before: the state before each step, every leaf (k, ...).
        unknowns: solution of each step, every leaf (k, ...).
        r: free nodes (k, nodes, 3) [m] after each step.
        tension: links (k, n) [N].
        residual: maximum scaled row of all steps; NaN if one is NaN.
        last: the state after them.
    """

    before: State
    unknowns: Unknowns
    r: jax.Array
    tension: jax.Array
    residual: jax.Array
    last: State


def check_recordable(stepper: Stepper, model: Model) -> None:
    """Reject schemes and models without a backward pass.

    Raises:
        SceneError: an explicit scheme or one of several stages, a single line, links that break, effects with a state
            or laws of their own.
    """
    scheme = stepper.integrator
    if not scheme.implicit or len(scheme.stages) != 1:
        raise SceneError(f"run.integrator: {scheme.name!r} has no backward pass; allowed: energy_momentum")
    if model.geometry.is_path:
        raise SceneError("scene: a single line; allowed: systems of lines that join at points")
    start = model.initial_internal_state()
    if model.line.failures is not None or start or model.laws or model.constraints:
        if model.line.failures is not None:
            what = "links that break"
        else:
            what = "friction, bodies or effects with a state"
        raise SceneError(f"scene: {what} have no backward pass. Use a scene without them")


def record(stepper: Stepper, model: Model, s: State, h: jax.Array, steps: int) -> Record:
    """`steps` steps of `h` [s] from `s`, with the data for the backward pass."""
    s = begin(stepper, model, s).state
    h = jnp.asarray(h, model.dtype)

    def one(s: State, _: None) -> tuple[State, tuple[State, Unknowns, jax.Array]]:
        u, row = solve(stepper, (model, s, h))[:2]
        after, row = finish_step(stepper, (model, s, h), u, row)
        return after, (s, u, row)

    last, (before, unknowns, residual) = jax.lax.scan(one, jax.tree.map(jnp.asarray, s), None, length=steps)
    r = jnp.concatenate([before.r[1:], last.r[None]])
    tension = jnp.concatenate([before.tension[1:], last.tension[None]])
    return Record(before, unknowns, r, tension, jnp.max(residual), last)


def backward_pass(
    stepper: Stepper,
    model: Model,
    moving: Sequence[int],
    run: Record,
    h: jax.Array,
    by_position: jax.Array,
    by_tension: jax.Array,
    by_end: State | None = None,
) -> tuple[list[jax.Array], State]:
    """Derivatives of q quantities by leaves of the model and by the start.

    Args:
        moving: indices of the leaves of the model that are differentiated; static.
        by_position: df/dr_k (k, q, nodes, 3); by_tension: df/dT_k (k, q, n).
        by_end: derivatives by the last state, every leaf (q, ...), of the time after this run; zero by default.

    Returns:
        By the leaves, each (q, ...), and by the state that the run starts from, every leaf (q, ...).
    """
    leaves, tree = jax.tree.flatten(model)
    h = jnp.asarray(h, model.dtype)
    many = by_position.shape[1]
    chosen = [leaves[i] for i in moving]

    def end_state(values: list[jax.Array], s: State, u: Unknowns) -> State:
        given = list(leaves)
        for i, value in zip(moving, values, strict=True):
            given[i] = value
        return finish_step(stepper, (jax.tree.unflatten(tree, given), s, h), u, jnp.zeros((), h.dtype))[0]

    def one(
        carry: tuple[State, list[jax.Array]], row: tuple[State, Unknowns, jax.Array, jax.Array]
    ) -> tuple[Any, None]:
        ct, total = carry
        before, u, by_r, by_t = row
        _, pull = jax.vjp(lambda values, s: end_state(values, s, u), chosen, before)
        found, ct = jax.vmap(pull)(replace(ct, r=ct.r + by_r, tension=ct.tension + by_t))
        return (ct, [a + b for a, b in zip(total, found, strict=True)]), None

    first = jax.tree.map(lambda a: a[0], run.before)
    if by_end is None:
        ct = jax.tree.map(lambda a: jnp.zeros((many, *a.shape), a.dtype), first)
    else:
        ct = by_end
    total = [jnp.zeros((many, *a.shape), a.dtype) for a in chosen]
    rows = run.before, run.unknowns, by_position, by_tension
    (ct, total), _ = jax.lax.scan(one, (ct, total), rows, reverse=True)
    return total, ct
