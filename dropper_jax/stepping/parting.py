"""The step that ends with a link parting."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from dropper_jax.model import BREAKING, Model, Parted, State, as_parted, booked

#: Relative rounding of a time that is a whole number of steps.
ROUNDING = 1e-9


def step_and_part(advance: Callable[[Model, State], tuple[State, Any]], model: Model, s: State) -> tuple[State, Any]:
    """One step by `advance` with what has parted, and what parts at its end.

    The energy of stretch and bending that a link holds as it parts is lost, and booked as `breaking`.
    """
    before = as_parted(model, s.parted)
    s1, report = advance(before, dataclasses.replace(s, parted=None))
    parted = _part(model, s.parted, s1)
    if not s.work.size:
        return dataclasses.replace(s1, parted=parted), report
    lost = _held(as_parted(model, parted).entered(s1.own), s1) - _held(before.entered(s1.own), s1)
    return dataclasses.replace(s1, parted=parted, work=s1.work + booked(model, {BREAKING: lost})), report


def _held(model: Model, s: State) -> jax.Array:
    """Energy [J] that links hold until they part: of their stretch and, where lines resist it, of their bending."""
    k = model.kinematics(s.r, s.v, s.t)
    own = model.line.axial.energy(k.links, model.line.length)
    return sum((e.potential(k) for e in model.effects if e.parts), own)


def _part(model: Model, parted: Parted, s1: State) -> Parted:
    failures = model.line.failures
    tension, t = jax.lax.stop_gradient((s1.tension, s1.t))
    share = tension / failures.load
    named = jnp.asarray(failures.named, jnp.int32)
    link = jnp.where(named >= 0, named, jnp.argmax(share, axis=1))
    due = (jnp.max(share, axis=1) >= 1.0) | (t >= failures.time * (1.0 - ROUNDING))
    now = due & (parted.link < 0)
    return Parted(
        jnp.where(now, link, parted.link).astype(jnp.int32),
        jnp.where(now, t, parted.t),
        jnp.where(now, tension[link], parted.tension),
    )
