"""One step that never raises; its derivatives stand in `derivative`, how it is solved in `solve`."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from dropper_jax.model import Model, State
from dropper_jax.residual import Explicit
from dropper_jax.stepping.derivative import _solved
from dropper_jax.stepping.parting import step_and_part
from dropper_jax.stepping.solve import paced
from dropper_jax.stepping.stepper import FULL_STEP, Report, Stepper


def step(
    stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array | bool = True
) -> tuple[State, Report]:
    """Advance `s` by `h`. Dead runs (`alive` False: an earlier step failed) are not retried."""
    if s.parted is not None:
        return step_and_part(lambda seen, now: step(stepper, seen, now, h, alive), model, s)
    integrator = stepper.integrator
    if isinstance(integrator, Explicit):
        return _explicit(integrator, model, s, h)
    if len(integrator.stages) == 1:
        return _implicit(stepper, model, s, h, alive)

    def stage(s: State, fraction: jax.Array) -> tuple[State, Report]:
        return _implicit(stepper, model, s, fraction * h, alive)

    # a scan, not an unrolled loop: five copies of a step would take five times as long to compile
    s, reports = jax.lax.scan(stage, s, jnp.asarray(integrator.stages, model.dtype))
    return s, Report(jnp.max(reports.residual), jnp.max(reports.level))


def _explicit(integrator: Explicit, model: Model, s: State, h: jax.Array) -> tuple[State, Report]:
    begun, s = s, integrator.advance(model.entered(s.own), s, h)
    finite = jnp.all(jnp.isfinite(s.r)) & jnp.all(jnp.isfinite(s.v))
    residual = jnp.where(finite, 0.0, jnp.nan).astype(model.dtype)
    return s, Report(paced(model, begun, s, residual), jnp.full((), FULL_STEP, jnp.int32))


def _implicit(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array | bool) -> tuple[State, Report]:
    s1, residual, level = _solved(stepper, model, s, jnp.asarray(h, model.dtype), jnp.asarray(alive))
    return s1, Report(residual, level)
