"""Where a free number lives: in the model, along a direction through it, at camera or clock, at a run's release."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Model

CAMERA, MARKER, CLOCK = "camera.offset", "marker.offset", "clock.rate"


@dataclass(frozen=True)
class ModelPlace:
    """A field of the model, or one of its entries.

    Attributes:
        section: `points`, `lines` or `effects`.
        index: in the section.
        field: of the point, line or effect.
        entry: of the field; None is the whole field.
    """

    section: str
    index: int
    field: str
    entry: int | None = None

    def put(self, model: Model, value: jax.Array) -> Model:
        """The model with the value in place; differentiable."""
        items = list(getattr(model, self.section))
        old = getattr(items[self.index], self.field)
        whole = self.entry is None
        new = jnp.broadcast_to(value, jnp.shape(old)) if whole else jnp.asarray(old).at[self.entry].set(value)
        items[self.index] = replace(items[self.index], **{self.field: new})
        return replace(model, **{self.section: tuple(items)})


@dataclass(frozen=True, eq=False)
class Direction:
    """Many numbers of the model at once, along a straight line.

    Attributes:
        slopes: by number of the model's leaf, the derivative of the leaf with respect to the number.
        origin: where the model is the given one.
        linear: whether the model is the one of the scene far from the origin too.
    """

    slopes: dict[int, np.ndarray]
    origin: float
    linear: bool
    field: ClassVar[str] = ""

    def put(self, model: Model, value: jax.Array) -> Model:
        """The model moved to the value; differentiable."""
        leaves, tree = jax.tree.flatten(model)
        for leaf, slope in self.slopes.items():
            leaves[leaf] = leaves[leaf] + (value - self.origin) * slope
        return jax.tree.unflatten(tree, leaves)


@dataclass(frozen=True)
class CameraPlace:
    """The rotation of the camera; of one link: how far its marker, or its encoder's zero, is turned against it."""

    link: int | None = None
    field: ClassVar[str] = CAMERA


@dataclass(frozen=True)
class ClockPlace:
    """How fast the motion's time goes by the traces' clock [s/s]: above 1 where frames are further apart than told."""

    field: ClassVar[str] = CLOCK


@dataclass(frozen=True)
class ReleasePlace:
    """The instant (`time`) at which a run is let go, or an `entry` of the `force` that holds it until then."""

    run: int
    field: str
    entry: int | None = None


Place = ModelPlace | Direction | CameraPlace | ClockPlace | ReleasePlace
