"""Contact of lines with each other and with bodies: a contact force between chosen pairs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import field

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import as_array, dot
from dropper_jax.base.read import Pairs, Values
from dropper_jax.effects.contact_bars import Bars, ContactPairs, Group
from dropper_jax.effects.nearest_points import Nearest, contact_force, nearest_points, relative_motion
from dropper_jax.effects.rigid_bodies import tetrahedron
from dropper_jax.model import Effect, Kinematics, ModelView, at_pieces, sum_of_pieces
from dropper_jax.scene import SceneData


@component
class LineContact(Effect):
    """Contact force between links of chosen lines, and between links and the cylinders and spheres of bodies and buoys.

    Links are round bars that touch if the distance d of their axes is below the sum R of their radii. Compressed by
    `p = R - d` they store `V = k/2 p^2 R/d`, a spring k at first touch and 49 k R^2 where axes meet. Over a step the
    force is the discrete gradient of V (Gonzalez 1996): V at the middle of the step, plus the part along the links'
    motion that makes its work equal the change of V. Damping `c p'` adds at most as much force again and removes at
    most all of it. Dry friction is `-mu N u/sqrt(|u|^2 + u0^2)` for the sliding velocity u. Neither adds energy, and
    neither sticks.

    A step in which links that may touch move relative to each other by more than half their mean radius is halved.

    Every link of one line is checked against every link of the other, except those that end at a common point. Where a
    contact passes a node, both its links push. Bodies and buoys are treated as cylinders with round ends.
    """

    name = "line_contact"
    reach = 2
    stiffness: Array = parameter("contact force per depth at first touch", unit="N/m", above=0.0)
    damping: Array = parameter("contact force per speed of approach", unit="N s/m", low=0.0, default=0.0)
    friction: Array = parameter("coefficient of dry friction", unit="-", low=0.0, default=0.0)
    slip: Array = parameter("sliding speed at which friction is 0.7 of its value", unit="m/s", above=0.0, default=0.01)
    radius: Array = parameter(
        "radius of the links; half the diameter if not given", unit="m", shape="link", low=0.0, default=None
    )
    pairs: tuple[tuple[str, str], ...] = option("lines that may touch each other", type=Pairs, default=())
    bodies: tuple[tuple[str, str], ...] = option(
        "lines with the bodies or buoys they may touch", type=Pairs, default=()
    )

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        if not (values["pairs"] or values["bodies"]):
            raise SceneError(
                'effects.line_contact.pairs: missing; needed: names of lines, such as [["dropper-1", "dropper-2"]]'
            )
        if not scene.branched:
            raise SceneError("effects.line_contact: acts between lines of a system. Use it in scenes of several lines")
        lines = _lines_of(scene)
        others = [b.name for b in (*scene.bodies, *scene.buoys)]
        path = "effects.line_contact"

        def check_name(where: str, name: str, names: Iterable[str], what: str) -> None:
            if name not in names:
                hint = nearest(name, names) if names else "none exist"
                raise SceneError(f"{path}.{where}: {name!r} is not a {what}; {hint}")

        def check_line(where: str, name: str) -> None:
            check_name(where, name, lines, "line")
            if values["radius"] is None and any(scene.lines[n].diameter is None for n in lines[name]):
                raise SceneError(f"line.{name}.diameter: missing; {path} needs it, or its own `radius` [m]")

        for i, (first, second) in enumerate(values["pairs"]):
            check_line(f"pairs.{i}.0", first)
            check_line(f"pairs.{i}.1", second)
            if first == second:
                raise SceneError(f"{path}.pairs.{i}: {first!r} is paired with itself; allowed: two lines")
        for i, (line, name) in enumerate(values["bodies"]):
            check_line(f"bodies.{i}.0", line)
            check_name(f"bodies.{i}.1", name, others, "body or buoy")
        touched = [name for _, name in values["bodies"]]
        for body in scene.bodies:
            if body.name in touched and not body.shapes:
                raise SceneError(f"{path}.bodies: {body.name!r} has no cylinders or spheres to touch")

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        lines = _lines_of(scene)
        values = dict(values)
        if values["radius"] is None:
            each = [np.zeros(n.links) if n.diameter is None else 0.5 * n.diameter for n in scene.lines]
            values["radius"] = np.concatenate(each)
        bars = [(lines[line], *bar) for line, name in values["bodies"] for bar in _bars_of(scene, name)]
        along = tuple((group, owner) for group, owner, *_ in bars)
        mixed = [_mixture(scene, owner, axis) for _, owner, axis, _ in bars]
        touching = ContactPairs(
            axis=as_array(np.array([axis for _, _, axis, _ in bars]).reshape(-1, 2, 3)),
            radius=as_array([0.5 * diameter for *_, diameter in bars]),
            mixed=as_array(np.array(mixed).reshape(-1, 2, 4)),
            corner=len(scene.points),
            beside=tuple((lines[a], lines[b]) for a, b in values["pairs"]),
            along=along,
        )
        if values["damping"] > 0.0 or values["friction"] > 0.0:
            return LinksInContact(**values, touching=touching)
        return LinksPushed(**values, touching=touching)


#: Motion over a step, relative to the reach, below which the third-order error of the energy balance is not corrected.
SMALL_MOTION = 1e-5
#: Fraction of the reach by which links may move relative to each other in a step.
LARGEST_MOTION = 0.25


@component
class LinksInContact(LineContact):
    """The same with indices for names and its work recorded."""

    touching: ContactPairs = field(kw_only=True)

    def piece_nodes(self, model: ModelView) -> np.ndarray:
        return self.touching.nodes(model.geometry)

    def _bars(self, model: ModelView) -> Bars:
        return Bars(self.touching, self.radius, model)

    def force(self, k: Kinematics) -> Array:
        return sum_of_pieces(self, k)

    def piece_force(self, k: Kinematics, r: Array, v: Array) -> Array:
        bars = self._bars(k.model)
        p = bars.axes(r)
        speed = bars.mix_velocities(v)
        near = nearest_points(p, bars.reach, bars.spread)
        _, push = contact_force(near.distance, bars.reach, self.stiffness)
        force = near.shares[..., None] * (push[..., None] * near.separation)[..., None, :]
        if k.h is not None:  # the middle of a step
            force = force + self._correct_push(bars, p, k.h * speed, force)
        return bars.spread_out(force + self._dissipative_force(near, push, speed))

    def contact_energy(self, k: Kinematics) -> Array:
        """Energy of compressed contacts, scalar [J]."""
        bars = self._bars(k.model)
        return jnp.sum(self._energy(bars, bars.axes(at_pieces(k, self.piece_nodes(k.model))[0])))

    def _energy(self, bars: Bars, p: Array) -> Array:
        distance = nearest_points(p, bars.reach, bars.spread).distance
        return contact_force(distance, bars.reach, self.stiffness)[0]

    def _correct_push(self, bars: Bars, p: Array, displacement: Array, force: Array) -> Array:
        """Contact force over a step minus that at its middle, along the motion (pieces, 4, 3) [N]."""
        gained = self._energy(bars, p + 0.5 * displacement) - self._energy(bars, p - 0.5 * displacement)
        lacking = gained + jnp.sum(force * displacement, axis=(-2, -1))
        own = displacement - jnp.mean(displacement, axis=-2, keepdims=True)  # the force has no net motion as a whole
        size = jnp.sum(own**2, axis=(-2, -1)) + (SMALL_MOTION * bars.reach) ** 2
        return -(lacking / size)[..., None, None] * own

    def _dissipative_force(self, near: Nearest, push: Array, speed: Array) -> Array:
        """Damping and friction (pieces, 4, 3) [N]."""
        relative = jnp.sum(near.shares[..., None] * speed, axis=-2)
        unit = near.separation / jnp.sqrt(dot(near.separation, near.separation) + 1e-30)[..., None]
        along = dot(unit, relative)
        damper = jnp.clip(-self.damping * along, -push, push)
        sliding = relative - along[..., None] * unit
        rub = self.friction * push / jnp.sqrt(dot(sliding, sliding) + self.slip**2)
        return near.shares[..., None] * (damper[..., None] * unit - rub[..., None] * sliding)[..., None, :]

    def too_far(self, before: Kinematics, after: Kinematics) -> Array:
        bars = self._bars(before.model)
        nodes = self.piece_nodes(before.model)
        start, end = (bars.axes(at_pieces(k, nodes)[0]) for k in (before, after))
        way = relative_motion(start, end)
        distance = nearest_points(start, bars.reach, bars.spread).distance
        return jnp.any((way > LARGEST_MOTION * bars.reach) & (distance - way < bars.reach))


@component
class LinksPushed(LinksInContact):
    """Contact without damping and friction: conservative."""

    def _dissipative_force(self, near: Nearest, push: Array, speed: Array) -> Array:
        return jnp.zeros((), speed.dtype)

    def potential(self, k: Kinematics) -> Array:
        return self.contact_energy(k)


def _bars_of(scene: SceneData, name: str) -> list[tuple[int, np.ndarray, float]]:
    """Owner, ends of the axis (2, 3) relative to it and diameter of each bar of a body or buoy."""
    for i, body in enumerate(scene.bodies):
        if body.name == name:
            cylinders = [(i, np.array([c.start, c.end]), c.diameter) for c in body.cylinders]
            return cylinders + [(i, np.array([s.centre, s.centre]), s.diameter) for s in body.spheres]
    buoy = next(buoy for buoy in scene.buoys if buoy.name == name)
    points = [point.name for point in scene.points]
    axis = np.zeros((2, 3))
    axis[:, 2] = [-buoy.attachment, buoy.height - buoy.attachment]
    return [(-1 - points.index(buoy.point), axis, buoy.diameter)]


def _mixture(scene: SceneData, owner: int, positions: np.ndarray) -> np.ndarray:
    """Weights (2, 4) of positions (2, 3) of a body in its corners; those of a buoy, with as many nodes, refer to its
    point."""
    if owner < 0:
        return np.array([[1.0, 0.0, 0.0, 0.0]] * 2)
    body = scene.bodies[owner]
    corners = tetrahedron(body.mass, body.centre_of_mass, body.inertia_matrix)
    return np.column_stack([positions, np.ones(2)]) @ np.linalg.inv(np.column_stack([corners, np.ones(4)]))


def _lines_of(scene: SceneData) -> dict[str, Group]:
    """Indices of the lines of each name; the pieces of a line cut by attached points also under the name of the full
    line."""
    found: dict[str, Group] = {}
    for i, line in enumerate(scene.lines):
        for name in {line.name, line.piece_of or line.name}:
            found[name] = (*found.get(name, ()), i)
    return found
