"""Links that have broken so far, and the model without them."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from dropper_jax.base.fields import component
from dropper_jax.model.model import Model


@component
class Parted:
    """What has broken so far, by entry (m,): the link's index (-1: none), when [s], and the tension then [N]."""

    link: jax.Array
    t: jax.Array
    tension: jax.Array


def nothing_parted(model: Model) -> Parted | None:
    """The state at the start of a run; None for a model in which nothing can break."""
    failures = model.line.failures
    if failures is None:
        return None
    entries = len(failures.named)
    zero = jnp.zeros(entries, model.dtype)
    return Parted(jnp.full(entries, -1, jnp.int32), zero, zero)


def as_parted(model: Model, parted: Parted | None) -> Model:
    """The model with zero tension in broken links."""
    if parted is None:
        return model
    line = model.line
    broken = jnp.any(parted.link[:, None] == jnp.arange(line.links), axis=0)
    axial = line.axial.with_broken_links(1.0 - broken.astype(model.dtype))
    return dataclasses.replace(model, lines=(dataclasses.replace(line, axial=axial),))
