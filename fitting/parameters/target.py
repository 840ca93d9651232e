"""Position of a free number: in the model, along a direction through it, at camera or clock, at a run's release."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Model
from fitting.traces.planar import directions

CAMERA, MARKER, NODE = "camera.offset", "marker.offset", "marker.node"
CLOCK, LOST = "clock.rate", "clock.lost"
SCALE = "rig.scale"


@dataclass(frozen=True)
class ModelPlace:
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

    def set_in(self, model: Model, value: jax.Array) -> Model:
        """The model with the value set; differentiable."""
        items = list(getattr(model, self.section))
        old = getattr(items[self.index], self.field)
        new = jnp.broadcast_to(value, jnp.shape(old))
        if self.entry is not None:
            new = jnp.ravel(old).at[self.entry].set(value).reshape(jnp.shape(old))
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
    section: ClassVar[str] = ""
    field: ClassVar[str] = ""

    def set_in(self, model: Model, value: jax.Array) -> Model:
        """The model moved to the value; differentiable."""
        leaves, tree = jax.tree.flatten(model)
        for leaf, slope in self.slopes.items():
            leaves[leaf] = leaves[leaf] + (value - self.origin) * slope
        return jax.tree.unflatten(tree, leaves)


def scale_direction(model: Model) -> Direction:
    """Scale all lengths, positions of points and centres of mass by one factor, moments of inertia by its square."""

    def grown(share: jax.Array) -> Model:
        line = model.line
        lengths = {"length": line.length * share}
        if line.compound:
            lengths |= {"centre_of_mass": line.centre_of_mass * share, "inertia": line.inertia * share**2}
        points = tuple(replace(p, position=p.position * share) for p in model.points)
        return replace(model, lines=(replace(line, **lengths), *model.lines[1:]), points=points)

    return _direction(grown, 1.0, linear=False)


def _direction(grown: Callable[[jax.Array], Model], origin: float, linear: bool) -> Direction:
    slopes = map(np.asarray, jax.tree.leaves(jax.jacfwd(grown)(jnp.full((), origin))))
    return Direction({i: slope for i, slope in enumerate(slopes) if np.any(slope)}, origin, linear)


def all_joints(model: Model, field: str) -> Direction:
    """A common change of a friction coefficient of all joints, `viscous` or `dry`."""

    def grown(more: jax.Array) -> Model:
        effects = [
            replace(e, **{field: getattr(e, field) + more}) if e.name == "joint_friction" else e for e in model.effects
        ]
        return replace(model, effects=tuple(effects))

    return _direction(grown, 0.0, linear=True)


@dataclass(frozen=True)
class CameraPlace:
    """Rotation of the camera; with a link, the rotation of its marker or its encoder's zero relative to it."""

    link: int | None = None
    section: ClassVar[str] = "camera"
    field: ClassVar[str] = CAMERA


@dataclass(frozen=True)
class NodeMarkerPlace:
    """Offset of a node's marker: along (0) or across (1) the link that ends there; at a fixed end, x (0) or z (1)."""

    node: int
    axis: int
    section: ClassVar[str] = "marker"
    field: ClassVar[str] = NODE


@dataclass(frozen=True)
class LostPlace:
    """Delay of the motion of a run relative to its clock, from one of its frames on, and that frame's time."""

    run: int
    frame: int
    time: float = 0.0
    section: ClassVar[str] = "lost"
    field: ClassVar[str] = LOST


@dataclass(frozen=True)
class ClockPlace:
    """Rate of the motion's time relative to the traces' clock [s/s]: above 1 if the true frame interval is longer."""

    section: ClassVar[str] = "clock"
    field: ClassVar[str] = CLOCK


@dataclass(frozen=True)
class ReleasePlace:
    """The instant (`time`) at which a run is released, or an `entry` of the `force` that holds it until then."""

    run: int
    field: str
    entry: int | None = None
    section: ClassVar[str] = "release"


@dataclass(frozen=True)
class MissingForce:
    """The size of a force that the scene lacks (`missing_forces`); `field` is its kind."""

    field: str
    section: ClassVar[str] = "missing"


Target = ModelPlace | Direction | CameraPlace | NodeMarkerPlace | ClockPlace | LostPlace | ReleasePlace | MissingForce


# Observation of a motion by camera, markers and clock: rotated angles and missing frames.
#
# Markers have offsets from the parts that they mark. The marker of a link is rotated relative to it, which adds to
# its angle. The marker of a node at p_i is seen at p_i + e_i and affects two links. With d_j = p_{j+1} - p_j, u_j its
# direction and n_j across it (towards larger angles), link j is seen rotated by
#
#     atan2(n_j . x_j, L_j + u_j . x_j),      x_j = e_{j+1} - e_j.
#
# The marker of a node between links is glued to the link that ends there, e_i = a u_{i-1} + b n_{i-1}. At a fixed end
# it is constant, e_i = (a, b) in x and z. At a free end it rotates the last link alone, as the marker of that link
# does.
#
# During frames that are missing without a mark the motion continues while the traces' clock stops. After such a frame
# the motion is `lost` later than the clock reads, in addition to the effect of a wrong rate.


class Placed(Protocol):
    """A free number with its position."""

    @property
    def where(self) -> Target: ...


def camera_angles(model: Model, parameters: Sequence[Placed], values: jax.Array, theta: jax.Array) -> jax.Array:
    """Angles (..., n) seen by the camera for links at theta (..., n) [rad]; differentiable."""
    turned = theta + node_markers(model, parameters, values, theta)
    return turned + camera_offset(parameters, values, theta.shape[-1])


def camera_offset(parameters: Sequence[Placed], values: jax.Array, links: int) -> jax.Array | float:
    """Rotation of the camera and of the links' markers, for each link (n,) [rad]; 0 if none is free."""
    total: jax.Array | float = 0.0
    for i, p in enumerate(parameters):
        if isinstance(p.where, CameraPlace):
            share = np.ones(links) if p.where.link is None else np.eye(links)[p.where.link]
            total = total + values[i] * share
    return total


def node_markers(model: Model, parameters: Sequence[Placed], values: jax.Array, theta: jax.Array) -> jax.Array | float:
    """Rotation of each link by the markers of nodes (..., n) [rad]; 0 if none is free."""
    mine = [(i, p.where) for i, p in enumerate(parameters) if isinstance(p.where, NodeMarkerPlace)]
    if not mine:
        return 0.0
    along, across = directions(theta)
    links = theta.shape[-1]
    moved = jnp.zeros((*theta.shape[:-1], links + 1, 2))
    for i, where in mine:
        direction = (along, across)[where.axis][..., where.node - 1, :]
        if where.node in (0, links):
            direction = jnp.asarray(np.eye(2)[where.axis])
        moved = moved.at[..., where.node, :].add(values[i] * direction)
    apart = moved[..., 1:, :] - moved[..., :-1, :]
    return jnp.arctan2(jnp.sum(across * apart, -1), model.line.length + jnp.sum(along * apart, -1))


def clock_rate(parameters: Sequence[Placed], values: jax.Array) -> jax.Array | None:
    """Time of the motion per time of the traces' clock, scalar [s/s]; None if it is not free."""
    return next((values[i] for i, p in enumerate(parameters) if isinstance(p.where, ClockPlace)), None)


def losses(parameters: Sequence[Placed]) -> list[int]:
    """The parameters that are lost times, in order."""
    return [i for i, p in enumerate(parameters) if isinstance(p.where, LostPlace)]
