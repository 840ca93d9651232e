"""Contact of lines with each other and with bodies: a contact force between chosen pairs."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Hashable, Iterable
from dataclasses import field

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import as_array, dot
from dropper_jax.base.read import Pairs, Values
from dropper_jax.base.records import by_name, names_of
from dropper_jax.effects.contact_bars import Bars, ContactPairs, Group
from dropper_jax.effects.nearest_points import Nearest, contact_force, nearest_points, relative_motion
from dropper_jax.effects.rigid_bodies import tetrahedron
from dropper_jax.model import Effect, Kinematics, ModelView, at_pieces, sum_of_pieces
from dropper_jax.scene import LineSpec, SceneData


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
    contact passes a node, both its links push. A broken link touches nothing. Bodies and buoys are treated as cylinders
    with round ends.
    """

    name = "line_contact"
    reach = 2
    breaks_with_links = True
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
        if scene.single_line is not None:
            raise SceneError("effects.line_contact: acts between lines of a system. Use it in scenes of several lines")
        path = "effects.line_contact"
        lines = _lines_by_name(scene)
        others = names_of((*scene.bodies, *scene.buoys))
        shapeless = names_of(body for body in scene.bodies if not body.shapes)
        listed: set[Hashable] = set()

        def check_line(where: str, name: str) -> Group:
            _check_name(where, name, lines, "line")
            if values["radius"] is None and any(scene.lines[n].diameter is None for n in lines[name]):
                raise SceneError(f"line.{name}.diameter: missing; {path} needs it, or its own `radius` [m]")
            return lines[name]

        for i, pair in enumerate(values["pairs"]):
            own = f"{path}.pairs.{i}"
            first, second = (check_line(f"{own}.{j}", name) for j, name in enumerate(pair))
            if not set(first).isdisjoint(second):
                raise SceneError(f"{own}: {pair[0]!r} and {pair[1]!r} are the same line; allowed: two lines")
            _list_once(own, map(frozenset, itertools.product(first, second)), listed)
        for i, (line, name) in enumerate(values["bodies"]):
            own = f"{path}.bodies.{i}"
            group = check_line(f"{own}.0", line)
            _check_name(f"{own}.1", name, others, "body or buoy")
            if name in shapeless:
                raise SceneError(f"{path}.bodies: {name!r} has no cylinders or spheres to touch")
            _list_once(own, itertools.product(group, [name]), listed)

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        values = dict(values)
        if values["radius"] is None:
            values["radius"] = np.concatenate(list(map(_radii, scene.lines)))
        kind = FrictionlessContact
        if values["damping"] > 0.0 or values["friction"] > 0.0:
            kind = LinksInContact
        return kind(**values, touching=_contact_pairs(values, scene))


#: Motion over a step, relative to the reach, below which the third-order error of the energy balance is not corrected.
SMALL_MOTION = 1e-5
#: Fraction of the reach by which links may move relative to each other in a step.
LARGEST_MOTION = 0.25


@component
class LinksInContact(LineContact):
    """The effect in a model, with numbers of lines for their names; its work is recorded."""

    touching: ContactPairs = field(kw_only=True)

    def piece_nodes(self, model: ModelView) -> np.ndarray:
        return self.touching.nodes(model.geometry)

    def _bars(self, model: ModelView) -> Bars:
        return Bars(self.touching, self.radius, model)

    force = sum_of_pieces

    def piece_force(self, k: Kinematics, r: Array, v: Array) -> Array:
        bars = self._bars(k.model)
        p = bars.axes(r)
        speed = bars.at_axis_ends(v)
        near = nearest_points(p, bars.reach, bars.parallel_rounding)
        push = bars.intact * contact_force(near.distance, bars.reach, self.stiffness)[1]
        force = near.shares[..., None] * (push[..., None] * near.separation)[..., None, :]
        if k.h is not None:  # the middle of a step
            force = force + self._correct_push(bars, p, k.h * speed, force)
        return bars.to_nodes(force + self._dissipative_force(near, push, speed))

    def contact_energy(self, k: Kinematics) -> Array:
        """Energy of compressed contacts, scalar [J]."""
        bars = self._bars(k.model)
        return jnp.sum(self._energy(bars, bars.axes(at_pieces(k, self.piece_nodes(k.model))[0])))

    def _energy(self, bars: Bars, p: Array) -> Array:
        distance = nearest_points(p, bars.reach, bars.parallel_rounding).distance
        return bars.intact * contact_force(distance, bars.reach, self.stiffness)[0]

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
        start = bars.axes(at_pieces(before, nodes)[0])
        motion = relative_motion(start, bars.axes(at_pieces(after, nodes)[0]))
        distance = nearest_points(start, bars.reach, bars.parallel_rounding).distance
        may_touch = (distance - motion < bars.reach) & (bars.intact > 0.0)
        return jnp.any((motion > LARGEST_MOTION * bars.reach) & may_touch)


@component
class FrictionlessContact(LinksInContact):
    """Contact without damping and friction, which is conservative."""

    def _dissipative_force(self, near: Nearest, push: Array, speed: Array) -> Array:
        return jnp.zeros((), speed.dtype)

    def potential(self, k: Kinematics) -> Array:
        return self.contact_energy(k)


def _check_name(where: str, name: str, names: Collection[str], what: str) -> None:
    if name not in names:
        raise SceneError(f"{where}: {name!r} is not a {what}; {nearest(name, names)}")


def _list_once(path: str, contacts: Iterable[Hashable], listed: set[Hashable]) -> None:
    """Add the contacts of an entry to those listed; reject one that is: its force would act twice."""
    new = set(contacts)
    if not listed.isdisjoint(new):
        raise SceneError(f"{path}: is listed before; allowed: each pair once")
    listed |= new


def _radii(line: LineSpec) -> np.ndarray:
    """Radii (links,) [m]; zero without a diameter, of lines that touch nothing."""
    if line.diameter is None:
        return np.zeros(line.links)
    return 0.5 * line.diameter


def _contact_pairs(values: Values, scene: SceneData) -> ContactPairs:
    """The pairs of an effect, with numbers of lines for their names."""
    lines = _lines_by_name(scene)
    axes = []
    diameters = []
    weights = []
    line_bars = []
    for line, name in values["bodies"]:
        owner, bars = _bars_of(scene, name)
        for axis, diameter in bars:
            axes.append(axis)
            diameters.append(diameter)
            weights.append(_weights(scene, owner, axis))
            line_bars.append((lines[line], owner))
    return ContactPairs(
        axis=as_array(np.array(axes).reshape(-1, 2, 3)),
        radius=as_array(0.5 * np.array(diameters)),
        weights=as_array(np.array(weights).reshape(-1, 2, 4)),
        corner=len(scene.points),
        line_pairs=tuple((lines[first], lines[second]) for first, second in values["pairs"]),
        line_bars=tuple(line_bars),
    )


def _bars_of(scene: SceneData, name: str) -> tuple[int, list[tuple[np.ndarray, float]]]:
    """The owner of the bars of a body or buoy; of each bar the ends of its axis (2, 3) relative to it, and the
    diameter."""
    for i, body in enumerate(scene.bodies):
        if body.name == name:
            cylinders = [(np.array([c.start, c.end]), c.diameter) for c in body.cylinders]
            return i, cylinders + [(np.array([s.centre, s.centre]), s.diameter) for s in body.spheres]
    buoy = by_name(scene.buoys)[name]
    points = names_of(scene.points)
    axis = np.zeros((2, 3))
    axis[:, 2] = [-buoy.attachment, buoy.height - buoy.attachment]
    return -1 - points.index(buoy.point), [(axis, buoy.diameter)]


def _weights(scene: SceneData, owner: int, positions: np.ndarray) -> np.ndarray:
    """Weights (2, 4) of positions (2, 3) on a body in its corners; on a buoy, all four of whose nodes are its point,
    in the first one."""
    if owner < 0:
        return np.array([[1.0, 0.0, 0.0, 0.0]] * 2)
    body = scene.bodies[owner]
    corners = tetrahedron(body.mass, body.centre_of_mass, body.inertia_matrix)
    return np.column_stack([positions, np.ones(2)]) @ np.linalg.inv(np.column_stack([corners, np.ones(4)]))


def _lines_by_name(scene: SceneData) -> dict[str, Group]:
    """Indices of the lines of each name; the pieces of a line cut by attached points also under the name of the full
    line."""
    found: dict[str, Group] = {}
    for i, line in enumerate(scene.lines):
        for name in {line.name, line.piece_of or line.name}:
            found[name] = (*found.get(name, ()), i)
    return found
