"""Links that break at the end of a step: at their breaking load, or at a given time."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.model import BREAKING, Failures, Model, Parted, Potential, State, as_parted, book_works

#: Relative rounding of a time that is a whole number of steps.
SAME_TIME = 1e-9


def without_broken_links(model: Model, s: State) -> tuple[Model, State]:
    """The model during a step from s, in which broken links have no tension, and the state that it advances;
    `break_links` follows."""
    if s.parted is None:
        return model, s
    return as_parted(model, s.parted), replace(s, parted=None)


def break_links(model: Model, before: Model, s: State, s1: State) -> State:
    """The end of a step with the links that break there; their energy is booked as work of breaking.

    Args:
        before: the model during the step.
        s, s1: start and end of the step; `parted` is that of s.
    """
    failures = model.line.failures
    if failures is None or s.parted is None:
        return s1
    parted = _part(failures, s.parted, s1)
    work = s1.work
    if work.size:
        kept = as_parted(model, parted).with_internal_state(s1.own)
        whole = before.with_internal_state(s1.own)
        work = work + book_works(model, {BREAKING: _link_energy(kept, s1) - _link_energy(whole, s1)})
    return replace(s1, parted=parted, work=work)


def _link_energy(model: Model, s: State) -> Array:
    """Energy [J] of links before they break: of stretch and, for lines with bending stiffness, of bending."""
    k = model.kinematics(s.r, s.v, s.t)
    line = model.with_lengths(s.t).line
    own = line.axial.energy(k.links, line.length)
    return sum((e.potential(k) for e in model.effects_with(Potential) if e.breaks_with_links), own)


def _part(failures: Failures, parted: Parted, s1: State) -> Parted:
    """The broken links after a step: each entry acts once and each link breaks once; which and when has no derivative.

    Of several entries that are due at one link the first acts; the others may break another link later.
    """
    tension, t = jax.lax.stop_gradient((s1.tension, s1.t))
    share = tension / failures.load
    named = jnp.asarray(failures.named, jnp.int32)
    link = jnp.where(named >= 0, named, jnp.argmax(share, axis=1))
    due = (jnp.max(share, axis=1) >= 1.0) | (t >= failures.time * (1.0 - SAME_TIME))
    now = due & (parted.link < 0)
    same = link[:, None] == link
    earlier = np.tri(len(named), k=-1, dtype=bool)
    now = now & ~jnp.any(same & now & earlier, axis=1) & ~jnp.any(link[:, None] == parted.link, axis=1)
    return Parted(
        jnp.where(now, link, parted.link).astype(jnp.int32),
        jnp.where(now, t, parted.t),
        jnp.where(now, tension[link], parted.tension),
    )
