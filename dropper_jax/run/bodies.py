"""Rigid bodies of a scene, and bodies and buoys at its points, as points and effects of a model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import jax
import numpy as np

from dropper_jax.base.numerics import as_array
from dropper_jax.effects import Effect
from dropper_jax.effects.body_bed import BodyBed, BodyBedFriction
from dropper_jax.effects.body_buoyancy import BodyBuoyancy, BodyBuoyancyInWaves, Pieces
from dropper_jax.effects.body_water import BodyWater
from dropper_jax.effects.point_bodies import PointBodies, PointBodiesWithAddedMass, WetPointBodies
from dropper_jax.effects.rigid_bodies import MOMENTS, RigidBodies, tetrahedron
from dropper_jax.effects.seabed import Seabed
from dropper_jax.effects.spar_buoys import SparBuoys
from dropper_jax.model import Point
from dropper_jax.scene import BodySpec, BuoySpec, PointSpec, SceneData


def make_bodies(scene: SceneData, index: dict[str, int]) -> tuple[list[Point], list[Effect]]:
    """The bodies' corners as points, after those of the scene, and the effects that make bodies of them."""
    if not scene.bodies:
        return [], []
    corner = np.array([tetrahedron(body.mass, body.centre_of_mass, body.inertia_matrix) for body in scene.bodies])
    points = []
    for body, own in zip(scene.bodies, corner, strict=True):
        for i in range(4):
            points.append(
                Point(position=as_array(body.world(own[i])), name=f"{body.name}: corner {i + 1}", kind="free")
            )
    affine = np.linalg.inv(np.concatenate([corner, np.ones((len(corner), 4, 1))], axis=2))
    seats = [(i, name, position) for i, body in enumerate(scene.bodies) for name, position in body.attachments.items()]
    rigid = RigidBodies(
        mass=as_array([body.mass for body in scene.bodies]),
        centre_of_mass=as_array([body.centre_of_mass for body in scene.bodies]),
        moments=as_array(np.array([body.inertia_matrix for body in scene.bodies])[:, *np.transpose(MOMENTS)]),
        corner=as_array(corner),
        affine=as_array(affine),
        seat=as_array(np.array([position for _, _, position in seats]).reshape(-1, 3)),
        velocity=as_array([_centre_velocity(body) for body in scene.bodies]),
        spin=as_array([body.angular_velocity for body in scene.bodies]),
        gravity=as_array(scene.gravity),
        first=len(scene.points),
        points=tuple(index[name] for _, name, _ in seats),
        owner=tuple(i for i, _, _ in seats),
        names=tuple(body.name for body in scene.bodies),
        pin=as_array(np.array([body.position for body in scene.bodies if body.pinned]).reshape(-1, 3)),
        pinned=tuple(i for i, body in enumerate(scene.bodies) if body.pinned),
    )
    shaped = any(body.shapes for body in scene.bodies)
    return points, [rigid, *(_in_water(scene, rigid) if shaped else ()), *_on_bed(scene, rigid)]


def _centre_velocity(body: BodySpec) -> np.ndarray:
    """Velocity (3,) [m/s] of the centre of mass at the start; of a pinned body that of its turning."""
    if not body.pinned:
        return body.velocity
    return body.rotation @ np.cross(body.angular_velocity, body.centre_of_mass)


def _on_bed(scene: SceneData, rigid: RigidBodies) -> list[Effect]:
    """Seabed contact of the bodies for which the scene requests it."""
    if not any(body.touches_bed for body in scene.bodies):
        return []
    bed = Seabed.build(scene.effects["seabed"], scene)
    pieces = _pieces(scene, rigid, sliced=True, only=lambda body: body.touches_bed)
    if not any(body.bed_friction for body in scene.bodies):
        return [BodyBed(bed, pieces)]
    owners = (*pieces.cylinder_of, *pieces.cylinder_of, *pieces.sphere_of)
    return [BodyBedFriction(bed, pieces, friction=as_array([scene.bodies[i].bed_friction for i in owners]))]


def _in_water(scene: SceneData, rigid: RigidBodies) -> list[Effect]:
    """Buoyancy, drag and added mass of the bodies' shapes; in waves buoyancy goes slice by slice."""
    slices = _pieces(scene, rigid, sliced=True)
    if scene.needed_sea.waves is None:
        buoyancy = BodyBuoyancy(_pieces(scene, rigid, sliced=False))
    else:
        buoyancy = BodyBuoyancyInWaves(slices)
    cylinders = [cylinder for body in scene.bodies for cylinder in body.cylinders]
    spheres = [sphere for body in scene.bodies for sphere in body.spheres]
    of = [(i, cylinder) for i, body in enumerate(scene.bodies) for cylinder in body.cylinders]
    ends = [(i, c, end) for i, c in of for end in ("from", "to") if c.ends in ("both", end)]
    positions = [(i, c.start if end == "from" else c.end) for i, c, end in ends]
    outward = [(i, (c.end - c.start) / c.length) for i, c, end in ends]
    each = lambda key: [getattr(c, key) for c in cylinders for _ in range(c.slices)]  # noqa: E731
    water = BodyWater(
        slices,
        cdn=as_array([*each("cdn"), *(s.cd for s in spheres)]),
        can=as_array([*each("can"), *(s.ca for s in spheres)]),
        end=_shares(rigid, positions),
        outward=_shares(rigid, outward) - _shares(rigid, [(i, np.zeros(3)) for i, _ in outward]),
        end_radius=as_array([0.5 * c.diameter for _, c, _ in ends]),
        cdt=as_array([c.cdt for _, c, _ in ends]),
        cat=as_array([c.cat for _, c, _ in ends]),
        end_of=tuple(i for i, _, _ in ends),
    )
    return [buoyancy, water]


def _pieces(
    scene: SceneData, rigid: RigidBodies, sliced: bool, only: Callable[[BodySpec], bool] = lambda _: True
) -> Pieces:
    """The cylinders, complete or in slices, and spheres of all or some bodies."""
    found = []
    chosen = [(i, body) for i, body in enumerate(scene.bodies) if only(body)]
    for i, body in chosen:
        for c in body.cylinders:
            count = c.slices if sliced else 1
            along = np.linspace(c.start, c.end, count + 1)
            found += [(i, along[j], along[j + 1], 0.5 * c.diameter, c.length / count) for j in range(count)]
    spheres = [(i, sphere) for i, body in chosen for sphere in body.spheres]
    return Pieces(
        ends=_shares(rigid, [(row[0], end) for row in found for end in row[1:3]]).reshape(-1, 2, 4),
        spheres=_shares(rigid, [(i, sphere.centre) for i, sphere in spheres]),
        radius=as_array([row[3] for row in found]),
        length=as_array([row[4] for row in found]),
        ball=as_array([0.5 * sphere.diameter for _, sphere in spheres]),
        first=rigid.first,
        cylinder_of=tuple(row[0] for row in found),
        sphere_of=tuple(i for i, _ in spheres),
    )


def _shares(rigid: RigidBodies, positions: list[tuple[int, np.ndarray]]) -> jax.Array:
    """Weights (positions, 4) of positions with respect to the corners of their bodies."""
    affine = np.asarray(rigid.affine)
    found = [np.append(position, 1.0) @ affine[i] for i, position in positions]
    return as_array(np.array(found).reshape(-1, 4))


def make_point_loads(scene: SceneData, index: dict[str, int]) -> list[Effect]:
    """Masses and loads attached to the points."""
    found: list[Effect] = []
    loaded = [p for p in scene.points if p.body]
    gravity = as_array(scene.gravity)
    if loaded:
        arrays = _columns(loaded, PointSpec.BODY)
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


def _columns(specs: Sequence[PointSpec | BuoySpec], keys: Iterable[str]) -> dict[str, jax.Array]:
    """Values of points or buoys by key; those not given are zero."""
    return {key: as_array([getattr(spec, key) or 0.0 for spec in specs]) for key in keys}
