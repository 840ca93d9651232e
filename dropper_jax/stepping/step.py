"""One step that never raises; see `derivative` for its derivatives and `solve` for its solution."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from dropper_jax.model import BREAKING, Model, Parted, State, as_parted, book_works
from dropper_jax.residual import Explicit
from dropper_jax.stepping.derivative import _solve_step
from dropper_jax.stepping.solve import limit_pace
from dropper_jax.stepping.stepper import FULL_STEP, Report, Stepper


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
    if not s.work.size:
        return dataclasses.replace(s1, parted=parted), report
    lost = _link_energy(as_parted(model, parted).with_internal_state(s1.own), s1) - _link_energy(
        before.with_internal_state(s1.own), s1
    )
    return dataclasses.replace(s1, parted=parted, work=s1.work + book_works(model, {BREAKING: lost})), report


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
