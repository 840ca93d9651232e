"""Rigid bodies of a scene, and bodies and buoys at its points, as points and effects of a model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jax import Array

from dropper_jax.base.numerics import as_array
from dropper_jax.base.records import names_of
from dropper_jax.effects import Effect
from dropper_jax.effects.body_bed import BodyBed, BodyBedFriction
from dropper_jax.effects.body_buoyancy import BodyBuoyancy, BodyBuoyancyInWaves
from dropper_jax.effects.body_pieces import Pieces
from dropper_jax.effects.body_water import BodyWater
from dropper_jax.effects.point_bodies import PointBodies, PointBodiesWithAddedMass, WetPointBodies
from dropper_jax.effects.rigid_bodies import MOMENT_AXES, RigidBodies, tetrahedron
from dropper_jax.effects.seabed import Seabed
from dropper_jax.effects.spar_buoys import SparBuoys
from dropper_jax.model import Point
from dropper_jax.scene import BodySpec, BuoySpec, CylinderSpec, PointSpec, SceneData


def make_bodies(scene: SceneData, index: dict[str, int]) -> tuple[list[Point], list[Effect]]:
    """The bodies' corners as points, after those of the scene, and the effects that make bodies of them."""
    if not scene.bodies:
        return [], []
    bodies = scene.bodies
    corner = np.array([tetrahedron(body.mass, body.centre_of_mass, body.inertia_matrix) for body in bodies])
    points = []
    for body, own in zip(bodies, corner, strict=True):
        for i, position in enumerate(own, start=1):
            points.append(Point(as_array(body.world(position)), name=f"{body.name}: corner {i}", kind="free"))
    affine = np.linalg.inv(np.concatenate([corner, np.ones((len(corner), 4, 1))], axis=2))
    owner = []
    seats = {}
    for i, body in enumerate(bodies):
        owner += [i] * len(body.attachments)
        seats |= body.attachments
    velocity = []
    for body in bodies:
        # of the centre of mass; of a pinned body that of its turning
        turning = body.rotation @ np.cross(body.angular_velocity, body.centre_of_mass)
        velocity.append(turning if body.pinned else body.velocity)
    rigid = RigidBodies(
        **_columns(bodies, ("mass", "centre_of_mass")),
        moments=as_array(np.array([body.inertia_matrix for body in bodies])[:, *np.transpose(MOMENT_AXES)]),
        corner=as_array(corner),
        affine=as_array(affine),
        seat=as_array(np.array(list(seats.values())).reshape(-1, 3)),
        velocity=as_array(velocity),
        spin=as_array([body.angular_velocity for body in bodies]),
        gravity=as_array(scene.gravity),
        first=len(scene.points),
        points=tuple(index[name] for name in seats),
        owner=tuple(owner),
        names=tuple(names_of(bodies)),
        pin=as_array(np.array([body.position for body in bodies if body.pinned]).reshape(-1, 3)),
        pinned=tuple(i for i, body in enumerate(bodies) if body.pinned),
    )
    effects: list[Effect] = [rigid]
    if any(body.shapes for body in bodies):
        effects += _in_water(scene, rigid)
    if any(body.touches_bed for body in bodies):
        effects.append(_on_bed(scene, rigid))
    return points, effects


def _on_bed(scene: SceneData, rigid: RigidBodies) -> Effect:
    """Seabed contact of the bodies for which the scene requests it."""
    bed = Seabed.build(scene.effects["seabed"], scene)
    pieces = _pieces(rigid, [(i, body) for i, body in enumerate(scene.bodies) if body.touches_bed], sliced=True)
    if not any(body.bed_friction for body in scene.bodies):
        return BodyBed(bed, pieces)
    owners = (*pieces.cylinder_of, *pieces.cylinder_of, *pieces.sphere_of)
    return BodyBedFriction(bed, pieces, friction=as_array([scene.bodies[i].bed_friction for i in owners]))


class EndPlate(NamedTuple):
    """An end of a cylinder in water: number of the body, the cylinder, its position and axis in the body's axes."""

    body: int
    cylinder: CylinderSpec
    position: np.ndarray
    axis: np.ndarray


def _in_water(scene: SceneData, rigid: RigidBodies) -> list[Effect]:
    """Buoyancy, drag and added mass of the bodies' shapes; under a surface that moves buoyancy goes slice by slice."""
    bodies = list(enumerate(scene.bodies))
    slices = _pieces(rigid, bodies, sliced=True)
    buoyancy = BodyBuoyancyInWaves(slices)
    if scene.needed_sea.waves is None and scene.needed_sea.level is None:
        buoyancy = BodyBuoyancy(_pieces(rigid, bodies, sliced=False))
    cdn = []
    can = []
    ends = []
    for i, body in bodies:
        for cylinder in body.cylinders:
            cdn += [cylinder.cdn] * cylinder.slices
            can += [cylinder.can] * cylinder.slices
            along = (cylinder.end - cylinder.start) / cylinder.length
            for name, position in (("from", cylinder.start), ("to", cylinder.end)):
                if cylinder.ends in ("both", name):
                    ends.append(EndPlate(i, cylinder, position, along))
    spheres = [sphere for body in scene.bodies for sphere in body.spheres]
    outward = _shares(rigid, [(end.body, end.axis) for end in ends])
    water = BodyWater(
        slices,
        cdn=as_array(cdn + [sphere.cd for sphere in spheres]),
        can=as_array(can + [sphere.ca for sphere in spheres]),
        end=_shares(rigid, [(end.body, end.position) for end in ends]),
        outward=outward - _shares(rigid, [(end.body, np.zeros(3)) for end in ends]),
        end_radius=as_array([0.5 * end.cylinder.diameter for end in ends]),
        **_columns([end.cylinder for end in ends], ("cdt", "cat")),
        end_of=tuple(end.body for end in ends),
    )
    return [buoyancy, water]


def _pieces(rigid: RigidBodies, bodies: list[tuple[int, BodySpec]], sliced: bool) -> Pieces:
    """The cylinders, complete or in slices, and the spheres of bodies, each body with its number."""
    owners = []
    ends = []
    radius = []
    length = []
    for i, body in bodies:
        for c in body.cylinders:
            count = c.slices if sliced else 1
            owners += [i] * count
            for start, end in pairwise(np.linspace(c.start, c.end, count + 1)):
                ends += [(i, start), (i, end)]
            radius += [0.5 * c.diameter] * count
            length += [c.length / count] * count
    spheres = [(i, sphere) for i, body in bodies for sphere in body.spheres]
    return Pieces(
        ends=_shares(rigid, ends).reshape(-1, 2, 4),
        spheres=_shares(rigid, [(i, sphere.centre) for i, sphere in spheres]),
        radius=as_array(radius),
        length=as_array(length),
        ball=as_array([0.5 * sphere.diameter for _, sphere in spheres]),
        first=rigid.first,
        cylinder_of=tuple(owners),
        sphere_of=tuple(i for i, _ in spheres),
    )


def _shares(rigid: RigidBodies, positions: list[tuple[int, np.ndarray]]) -> Array:
    """Weights (positions, 4) of positions with respect to the corners of their bodies."""
    affine = np.asarray(rigid.affine)
    found = [np.append(position, 1.0) @ affine[i] for i, position in positions]
    return as_array(np.array(found).reshape(-1, 4))


def make_point_loads(scene: SceneData, index: dict[str, int]) -> list[Effect]:
    """Masses and loads attached to the points."""
    found: list[Effect] = []
    loaded = [p for p in scene.points if p.has_body]
    gravity = as_array(scene.gravity)
    if loaded:
        arrays = _columns(loaded, PointSpec.BODY_FIELDS)
        kind = PointBodies
        if scene.sea is not None:
            kind = WetPointBodies
            if np.any(arrays["volume"] * arrays["added_mass"]):
                kind = PointBodiesWithAddedMass
        found.append(kind(**arrays, gravity=gravity, points=tuple(index[p.name] for p in loaded)))
    if scene.buoys:
        arrays = _columns(scene.buoys, ("mass", "diameter", "height", "attachment", "cdn", "cdt", "can", "cat"))
        points = tuple(index[b.point] for b in scene.buoys)
        kinds = {b.end_added_mass for b in scene.buoys}
        found.append(SparBuoys(**arrays, gravity=gravity, points=points, end_added_mass=kinds.pop()))
    return found


def _columns(specs: Sequence[PointSpec | BuoySpec | BodySpec | CylinderSpec], keys: Iterable[str]) -> dict[str, Array]:
    """Values of points, buoys, bodies or cylinders by key; those not given are zero."""
    found = {}
    for key in keys:
        values = [getattr(spec, key) for spec in specs]
        found[key] = as_array([0.0 if value is None else value for value in values])
    return found
