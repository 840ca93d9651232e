"""Contact of lines with each other and with bodies: a contact force between chosen pairs."""

from __future__ import annotations

from dataclasses import field

import jax
import jax.numpy as jnp
import numpy as np

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
    stiffness: jax.Array = parameter("contact force per depth at first touch", unit="N/m", low=0.0, open_low=True)
    damping: jax.Array = parameter("contact force per speed of approach", unit="N s/m", low=0.0, default=0.0)
    friction: jax.Array = parameter("coefficient of dry friction", unit="-", low=0.0, default=0.0)
    slip: jax.Array = parameter(
        "sliding speed at which friction is 0.7 of its value", unit="m/s", low=0.0, open_low=True, default=0.01
    )
    radius: jax.Array = parameter(
        "radius of the links; half the diameter if not given", unit="m", shape="link", low=0.0, default=None
    )
    pairs: tuple[tuple[str, str], ...] = option("lines that may touch each other", type=Pairs, default=())
    bodies: tuple[tuple[str, str], ...] = option(
        "lines with the bodies or buoys they may touch", type=Pairs, default=()
    )

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        if not values["pairs"] and not values["bodies"]:
            raise SceneError(
                'effects.line_contact.pairs: missing; needed: names of lines, such as [["dropper-1", "dropper-2"]]'
            )
        if not scene.branched:
            raise SceneError("effects.line_contact: acts between lines of a system. Use it in scenes of several lines")
        lines = _lines_of(scene)
        others = [*(b.name for b in scene.bodies), *(b.name for b in scene.buoys)]
        for key, second in (("pairs", list(lines)), ("bodies", others)):
            for i, pair in enumerate(values[key]):
                path = f"effects.line_contact.{key}.{i}"
                for j, (name, known) in enumerate(zip(pair, (list(lines), second), strict=True)):
                    if name not in known:
                        what = "body or buoy"
                        if known is not others:
                            what = "line"
                        raise SceneError(
                            f"{path}.{j}: {name!r} is not a {what}; {nearest(name, known) if known else 'none exist'}"
                        )
                if pair[0] == pair[1]:
                    raise SceneError(f"{path}: {pair[0]!r} is paired with itself; allowed: two lines")
                if values["radius"] is None:
                    for name in pair if key == "pairs" else pair[:1]:
                        if any(scene.lines[i].diameter is None for i in lines[name]):
                            raise SceneError(
                                f"line.{name}.diameter: missing; effects.line_contact needs it, or its own `radius` [m]"
                            )
        for _, name in values["bodies"]:
            body = next((b for b in scene.bodies if b.name == name), None)
            if body is not None and not body.shapes:
                raise SceneError(f"effects.line_contact.bodies: {name!r} has no cylinders or spheres to touch")

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        lines = _lines_of(scene)
        values = dict(values)
        if values["radius"] is None:
            each = [np.zeros(n.links) if n.diameter is None else 0.5 * n.diameter for n in scene.lines]
            values["radius"] = np.concatenate(each)
        index = {x.name: i for i, x in enumerate(scene.points)}
        number = {x.name: i for i, x in enumerate(scene.bodies)}
        buoys = {b.name: b for b in scene.buoys}
        bars: list[tuple[Group, int, np.ndarray, np.ndarray, float]] = []
        for line, name in values["bodies"]:
            if name in number:
                body = scene.bodies[number[name]]
                bars += [(lines[line], number[name], c.start, c.end, 0.5 * c.diameter) for c in body.cylinders]
                bars += [(lines[line], number[name], s.centre, s.centre, 0.5 * s.diameter) for s in body.spheres]
            else:
                buoy = buoys[name]
                low, high = (np.array([0.0, 0.0, z - buoy.attachment]) for z in (0.0, buoy.height))
                bars.append((lines[line], -1 - index[buoy.point], low, high, 0.5 * buoy.diameter))
        if values["damping"] > 0.0 or values["friction"] > 0.0:
            kind = LinksInContact
        else:
            kind = LinksPushed
        mixed = [_mixture(scene, owner, np.array([start, end])) for _, owner, start, end, _ in bars]
        return kind(
            **values,
            touching=ContactPairs(
                axis=as_array(np.array([[start, end] for _, _, start, end, _ in bars]).reshape(-1, 2, 3)),
                radius=as_array([radius for *_, radius in bars]),
                mixed=as_array(np.array(mixed).reshape(-1, 2, 4)),
                corner=len(scene.points),
                beside=tuple((lines[a], lines[b]) for a, b in values["pairs"]),
                along=tuple((group, owner) for group, owner, *_ in bars),
            ),
        )


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

    def force(self, k: Kinematics) -> jax.Array:
        return sum_of_pieces(self, k)

    def piece_force(self, k: Kinematics, r: jax.Array, v: jax.Array) -> jax.Array:
        bars = self._bars(k.model)
        p = bars.axes(r)
        speed = bars.mix_velocities(v)
        near = nearest_points(p, bars.reach, bars.spread)
        _, push = contact_force(near.distance, bars.reach, self.stiffness)
        force = near.shares[..., None] * (push[..., None] * near.separation)[..., None, :]
        if k.h is not None:  # the middle of a step
            force = force + self._correct_push(bars, p, k.h * speed, force)
        return bars.spread_out(force + self._dissipative_force(near, push, speed))

    def contact_energy(self, k: Kinematics) -> jax.Array:
        """Energy of compressed contacts, scalar [J]."""
        bars = self._bars(k.model)
        return jnp.sum(self._energy(bars, bars.axes(at_pieces(k, self.piece_nodes(k.model))[0])))

    def _energy(self, bars: Bars, p: jax.Array) -> jax.Array:
        distance = nearest_points(p, bars.reach, bars.spread).distance
        return contact_force(distance, bars.reach, self.stiffness)[0]

    def _correct_push(self, bars: Bars, p: jax.Array, displacement: jax.Array, force: jax.Array) -> jax.Array:
        """Contact force over a step minus that at its middle, along the motion (pieces, 4, 3) [N]."""
        gained = self._energy(bars, p + 0.5 * displacement) - self._energy(bars, p - 0.5 * displacement)
        lacking = gained + jnp.sum(force * displacement, axis=(-2, -1))
        own = displacement - jnp.mean(displacement, axis=-2, keepdims=True)  # the force has no net motion as a whole
        size = jnp.sum(own**2, axis=(-2, -1)) + (SMALL_MOTION * bars.reach) ** 2
        return -(lacking / size)[..., None, None] * own

    def _dissipative_force(self, near: Nearest, push: jax.Array, speed: jax.Array) -> jax.Array:
        """Damping and friction (pieces, 4, 3) [N]."""
        relative = jnp.sum(near.shares[..., None] * speed, axis=-2)
        unit = near.separation / jnp.sqrt(dot(near.separation, near.separation) + 1e-30)[..., None]
        along = dot(unit, relative)
        damper = jnp.clip(-self.damping * along, -push, push)
        sliding = relative - along[..., None] * unit
        rub = self.friction * push / jnp.sqrt(dot(sliding, sliding) + self.slip**2)
        return near.shares[..., None] * (damper[..., None] * unit - rub[..., None] * sliding)[..., None, :]

    def too_far(self, before: Kinematics, after: Kinematics) -> jax.Array:
        bars = self._bars(before.model)
        nodes = self.piece_nodes(before.model)
        start = bars.axes(at_pieces(before, nodes)[0])
        end = bars.axes(at_pieces(after, nodes)[0])
        way = relative_motion(start, end)
        distance = nearest_points(start, bars.reach, bars.spread).distance
        return jnp.any((way > LARGEST_MOTION * bars.reach) & (distance - way < bars.reach))


@component
class LinksPushed(LinksInContact):
    """Contact without damping and friction: conservative."""

    def _dissipative_force(self, near: Nearest, push: jax.Array, speed: jax.Array) -> jax.Array:
        return jnp.zeros((), speed.dtype)

    def potential(self, k: Kinematics) -> jax.Array:
        return self.contact_energy(k)


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
        for name in dict.fromkeys([line.name, line.piece_of or line.name]):
            found[name] = (*found.get(name, ()), i)
    return found
