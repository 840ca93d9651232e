"""Where a free parameter acts: in the model, the camera, the markers, the clock, the release or another recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.model import Model

CAMERA = "camera.offset"
MARKER = "marker.offset"
NODE = "marker.node"
CLOCK = "clock.rate"
LOST = "clock.lost"
SCALE = "rig.scale"
RECORDING = "recording"
#: Angle [rad] about which a recording has its scale: straight down.
DOWN = np.pi / 2


@dataclass(frozen=True)
class ModelTarget:
    """A field of the model, or one of its entries.

    Attributes:
        section: `points`, `lines` or `effects`.
        index: within the section.
        field: of the point, line or effect.
        entry: of the field, counted through all its axes; None is the whole field.
    """

    section: str
    index: int
    field: str
    entry: int | None = None

    def set_in(self, model: Model, value: Array) -> Model:
        """The model with the value set; differentiable."""
        items = list(getattr(model, self.section))
        old = getattr(items[self.index], self.field)
        new = jnp.broadcast_to(value, jnp.shape(old))
        if self.entry is not None:
            number = np.arange(np.size(old)).reshape(np.shape(old))
            new = jnp.where(number == self.entry, value, old)
        items[self.index] = replace(items[self.index], **{self.field: new})
        return replace(model, **{self.section: tuple(items)})


@dataclass(frozen=True, eq=False)
class Direction:
    """Many numbers of the model at once, along a straight line.

    Attributes:
        slopes: by number of the model's leaf, the derivative of the leaf with respect to the number.
        origin: value for which the model is the given one.
        linear: whether the model equals that of the scene far from the origin too.
    """

    slopes: dict[int, np.ndarray]
    origin: float
    linear: bool
    field: ClassVar[str] = ""

    def set_in(self, model: Model, value: Array) -> Model:
        """The model moved to the value; differentiable."""
        leaves, tree = jax.tree.flatten(model)
        for leaf, slope in self.slopes.items():
            leaves[leaf] = leaves[leaf] + (value - self.origin) * slope
        return jax.tree.unflatten(tree, leaves)


@dataclass(frozen=True)
class RigScale:
    """Factor of all lengths, positions of points and centres of mass, whose square is that of moments of inertia.

    It acts on the model with all other values set, so that a length of the rig is the factor times the value of its
    own parameter.
    """

    field: ClassVar[str] = SCALE

    def set_in(self, model: Model, value: Array) -> Model:
        """The model grown by the value; differentiable."""
        line = model.line
        lengths = {"length": line.length * value}
        if line.centre_of_mass is not None and line.inertia is not None:
            lengths |= {"centre_of_mass": line.centre_of_mass * value, "inertia": line.inertia * value**2}
        points = tuple(replace(p, position=p.position * value) for p in model.points)
        return replace(model, lines=(replace(line, **lengths), *model.lines[1:]), points=points)


def all_joints(model: Model, field: str) -> Direction:
    """A common change of a friction coefficient of all joints, `viscous` or `dry`."""

    def grown(more: Array) -> Model:
        effects = []
        for e in model.effects:
            if e.name == "joint_friction":
                e = replace(e, **{field: getattr(e, field) + more})
            effects.append(e)
        return replace(model, effects=tuple(effects))

    slopes = map(np.asarray, jax.tree.leaves(jax.jacfwd(grown)(jnp.zeros(()))))
    return Direction({i: slope for i, slope in enumerate(slopes) if np.any(slope)}, 0.0, linear=True)


@dataclass(frozen=True)
class SetupTarget:
    """A number of the start, a sensor or a camera of a run: section, number in it, field, entry of the field."""

    section: str
    index: int
    field: str
    entry: tuple[int, ...] = ()


@dataclass(frozen=True)
class CameraTarget:
    """Rotation of the camera; with a link, the rotation of its marker or its encoder's zero relative to it."""

    link: int | None = None
    field: ClassVar[str] = CAMERA


@dataclass(frozen=True)
class NodeMarkerTarget:
    """Offset of a node's marker: along (0) or across (1) the link that ends there; at a fixed end, x (0) or z (1)."""

    node: int
    axis: int
    field: ClassVar[str] = NODE


@dataclass(frozen=True)
class LostTarget:
    """Delay of the motion of a run relative to its clock, from one of its frames on, and that frame's time."""

    run: int
    frame: int
    time: float = 0.0
    field: ClassVar[str] = LOST


@dataclass(frozen=True)
class ClockTarget:
    """Rate of the motion's time relative to the traces' clock [s/s]: above 1 if the true frame interval is longer."""

    field: ClassVar[str] = CLOCK


@dataclass(frozen=True)
class ReleaseTarget:
    """The instant (`time`) at which a run is released, or an `entry` of the `force` that holds it until then."""

    run: int
    field: str
    entry: int | None = None


@dataclass(frozen=True)
class RecordingTarget:
    """The `zero` of a link, the `scale` or the `delay` of a recording; `applied`: what was taken off its samples."""

    recording: int
    field: str
    link: int | None = None
    applied: float = 0.0


@dataclass(frozen=True)
class MissingForce:
    """The size of a force that the scene lacks (`missing_forces`); `field` is its kind."""

    field: str
