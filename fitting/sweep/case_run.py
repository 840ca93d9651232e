"""The run of one case of a sweep: its values in the model, all steps, and the requested quantities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.numerics import safe_norm
from dropper_jax.model import Model, State
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.quantity_extremes import quantity_signals
from dropper_jax.quantities.statistics import statistic
from dropper_jax.residual import Stepper
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.observe import observe
from dropper_jax.stepping.progress import Progress, Trajectory, begin
from fitting.parameters.parameter import with_parameter_values
from fitting.sweep.plan import STATUS, Plan


class Tally(NamedTuple):
    """Running extremes and sums of one case; `cosine` (n,) is the minimum of each link's angle from straight down."""

    largest: Array
    smallest: Array
    total: Array
    cosine: Array
    excursion: Array
    residual: Array


Carry = tuple[Progress, Tally]


def run_case(plan: Plan, stepper: Stepper, model: Model, start: State, values: Array, dt: Array) -> dict[str, Array]:
    """One case, with these values (axes,), from start to end; a pure function to batch."""
    for axis, value in zip(plan.axes, values, strict=True):
        if axis.parameters:
            model = with_parameter_values(model, axis.parameters, jnp.broadcast_to(value, (len(axis.parameters),)))
    run = plan.scene.run
    named = plan.named_quantities
    watch = None
    if run.save_every > 1 or plan.is_adaptive:
        watch = quantity_signals(named, start.r)
    accuracy = jnp.asarray(run.accuracy, model.dtype) if plan.is_adaptive else None

    def save(carry: Carry, _: None) -> tuple[Carry, dict[str, Array]]:
        progress, tally = carry
        progress, row = advance(stepper, model, progress, dt, 1, run.save_every, accuracy, watch=watch)
        tally = _add_row(model, start, progress.state, tally, row)
        extremes = {}
        if watch is not None and row.extremes is not None:
            extremes = watch.over_steps(row.extremes)
        return (progress, tally), _saved_values(plan, model, start, progress.state, extremes)

    first = begin(stepper, model, start, plan.is_adaptive)
    (progress, tally), saved = jax.lax.scan(save, (first, _empty_tally(start)), None, length=run.rows)
    for one in named:
        if one.at_rest:  # the start is not among the saved states
            saved[one.name] = one.of_state(model, start)
        else:
            saved[one.name] = statistic(one.statistic, saved[one.name], run.interval, over_steps=watch is not None)
    for name, value in _tallied_quantities(model, progress.state, tally, run.rows).items():
        if name in plan.quantities:
            saved[name] = value
    failed = progress.first_bad >= 0
    why = jnp.where(jnp.isfinite(tally.residual), STATUS.index("not_converged"), STATUS.index("non_finite"))
    saved["status"] = jnp.where(failed, why, 0).astype(jnp.int8)
    saved["failed_at"] = jnp.where(failed, (progress.first_bad + 1) * dt, jnp.nan)
    return saved


def _saved_values(
    plan: Plan, model: Model, start: State, s: State, extremes: Mapping[Quantity, Array]
) -> dict[str, Array]:
    """What is saved of a case in state s: the named quantities, by their extremes since the last one if these are
    known, and the traces."""
    saved = {}
    for one in plan.named_quantities:
        if one in extremes:
            saved[one.name] = extremes[one]
        elif not one.at_rest:
            saved[one.name] = one.instant(model, start.r, s.r, s.v, s.tension, s.t, s.parted)
    if plan.traces:
        saved |= {"positions": s.r, "tension": s.tension}
    return saved


def _empty_tally(start: State) -> Tally:
    """The tally of a case that has not started."""
    zero = jnp.zeros((), start.r.dtype)
    return Tally(zero - jnp.inf, zero + jnp.inf, zero, jnp.ones_like(start.tension), zero, zero)


def _tallied_quantities(model: Model, s: State, tally: Tally, rows: int) -> dict[str, Array]:
    """All of `QUANTITIES` of a case that ended in state s, by name; those that are not returned cost nothing."""
    end = observe(model, s.r, s.v, s.t, s.parted, s.own)
    return {
        "tension_max": tally.largest,
        "tension_mean": tally.total / rows,
        "tension_min": tally.smallest,
        "angle_max": jnp.arccos(jnp.clip(tally.cosine, -1.0, 1.0)),
        "excursion": tally.excursion,
        "energy_final": end.kinetic + end.potential,
    }


def _add_row(model: Model, start: State, s: State, tally: Tally, row: Trajectory) -> Tally:
    """The tally with a saved row of the run, which ends in state s."""
    links = model.links(s.r, model.ends(s.t))
    length = model.line.length
    if model.line.axial.elastic:  # rigid links keep their lengths
        length = safe_norm(links)
    tension = row.tension[0]
    smallest = tension
    largest = tension
    if row.extremes is not None:
        smallest, largest = (rows[0, : tension.size] for rows in row.extremes[:2])
    # a NaN is permanent: `maximum` propagates it
    return Tally(
        jnp.maximum(tally.largest, jnp.max(largest)),
        jnp.minimum(tally.smallest, jnp.min(smallest)),
        tally.total + jnp.mean(tension),
        jnp.minimum(tally.cosine, -links[:, 2] / length),
        jnp.maximum(tally.excursion, jnp.max(safe_norm(s.r - start.r))),
        jnp.maximum(tally.residual, row.residual[0]),
    )
