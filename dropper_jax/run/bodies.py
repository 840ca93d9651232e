"""Rigid bodies of a scene as arrays, and where they start."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.effects import EFFECTS, Effect
from dropper_jax.effects.body_bed import BodyBed, BodyBedFriction
from dropper_jax.effects.body_buoyancy import BodyBuoyancy, BodyBuoyancyInWaves, Pieces
from dropper_jax.effects.body_water import BodyWater
from dropper_jax.effects.rigid_bodies import MOMENTS, RigidBodies, tetrahedron
from dropper_jax.effects.vessel_motion import VesselByTable, VesselInWaves
from dropper_jax.model import Model, Point
from dropper_jax.scene import BodySpec, SceneData, VesselSpec, attitude
from dropper_jax.sea import Sea


def corners_of(body: BodySpec) -> np.ndarray:
    """Its four corners (4, 3) [m] in its own axes."""
    return tetrahedron(body.mass, body.centre_of_mass, body.inertia_matrix)


def make_bodies(scene: SceneData, index: dict[str, int], gravity: float) -> tuple[list[Point], list[Effect]]:
    """The bodies' corners as points, after those of the scene, and the effects that make bodies of them."""
    if not scene.bodies:
        return [], []
    corner = np.array([corners_of(body) for body in scene.bodies])
    points = [
        Point(position=body.world(own[i]), name=f"{body.name}: corner {i + 1}", kind="free")
        for body, own in zip(scene.bodies, corner, strict=True)
        for i in range(4)
    ]
    affine = np.linalg.inv(np.concatenate([corner, np.ones((len(corner), 4, 1))], axis=2))
    seats = [(i, name, position) for i, body in enumerate(scene.bodies) for name, position in body.attachments.items()]
    rigid = RigidBodies(
        mass=np.array([body.mass for body in scene.bodies]),
        centre_of_mass=np.array([body.centre_of_mass for body in scene.bodies]),
        moments=np.array([[body.inertia_matrix[i, j] for i, j in MOMENTS] for body in scene.bodies]),
        corner=corner,
        affine=affine,
        seat=np.array([position for _, _, position in seats]).reshape(-1, 3),
        velocity=np.array([_centre_velocity(body) for body in scene.bodies]),
        spin=np.array([body.angular_velocity for body in scene.bodies]),
        gravity=gravity,
        first=len(scene.points),
        points=tuple(index[name] for _, name, _ in seats),
        owner=tuple(i for i, _, _ in seats),
        names=tuple(body.name for body in scene.bodies),
        pin=np.array([body.position for body in scene.bodies if body.pinned]).reshape(-1, 3),
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
    bed = EFFECTS["seabed"].build(scene.effects["seabed"], scene)
    pieces = _pieces(scene, rigid, sliced=True, only=lambda body: body.touches_bed)
    if not any(body.bed_friction for body in scene.bodies):
        return [BodyBed(bed, pieces)]
    owners = np.array([*pieces.cylinder_of, *pieces.cylinder_of, *pieces.sphere_of], int)
    return [BodyBedFriction(bed, pieces, friction=np.array([body.bed_friction for body in scene.bodies])[owners])]


def _in_water(scene: SceneData, rigid: RigidBodies) -> list[Effect]:
    """Buoyancy, drag and added mass of the bodies' shapes; in waves buoyancy goes slice by slice."""
    slices = _pieces(scene, rigid, sliced=True)
    if scene.sea.waves is None:
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
        cdn=np.array([*each("cdn"), *(s.cd for s in spheres)]),
        can=np.array([*each("can"), *(s.ca for s in spheres)]),
        end=_shares(rigid, positions),
        outward=_shares(rigid, outward) - _shares(rigid, [(i, np.zeros(3)) for i, _ in outward]),
        end_radius=np.array([0.5 * c.diameter for _, c, _ in ends]),
        cdt=np.array([c.cdt for _, c, _ in ends]),
        cat=np.array([c.cat for _, c, _ in ends]),
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
    ends = [_shares(rigid, [(row[0], row[side]) for row in found]) for side in (1, 2)]
    return Pieces(
        ends=np.stack(ends, axis=1),
        spheres=_shares(rigid, [(i, sphere.centre) for i, sphere in spheres]),
        radius=np.array([row[3] for row in found]),
        length=np.array([row[4] for row in found]),
        ball=np.array([0.5 * sphere.diameter for _, sphere in spheres]),
        first=rigid.first,
        cylinder_of=tuple(row[0] for row in found),
        sphere_of=tuple(i for i, _ in spheres),
    )


def _shares(rigid: RigidBodies, positions: list[tuple[int, np.ndarray]]) -> np.ndarray:
    """Weights (positions, 4) of positions with respect to the corners of their bodies."""
    found = [np.append(position, 1.0) @ np.asarray(rigid.affine[i]) for i, position in positions]
    return np.array(found).reshape(-1, 4)


def body_motion(model: Model, r: jax.Array, v: jax.Array) -> dict[str, np.ndarray]:
    """Motion of the bodies by the names of a solution, from positions and velocities (k, free nodes, 3); empty without
    bodies.

    Roll and yaw are continuous in time; pitch is between -pi/2 and pi/2, where the three are not unique.
    """
    if not model.constraints:
        return {}
    pose = jax.vmap(lambda position: model.constraints[0].pose(model, position))
    (position, axes), (velocity, rates) = (jax.tree.map(np.asarray, pose(a)) for a in (r, v))
    turned = attitude(axes)
    turned[..., 0::2] = np.unwrap(turned[..., 0::2], axis=0)
    spin = rates @ np.swapaxes(axes, -1, -2)  # skew: the angular velocity's cross product
    angular = np.stack([spin[..., i, j] - spin[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1) / 2.0
    return {"body_position": position, "body_attitude": turned, "body_velocity": velocity, "body_rates": angular}


def make_vessels(scene: SceneData, sea: Sea | None) -> list[Effect]:
    """One moving point for each attachment of a vessel."""
    return [
        _vessel_effect(vessel, f"vessel.{i}", name, position, scene, sea)
        for i, vessel in enumerate(scene.vessels)
        for name, position in vessel.attachments.items()
    ]


def _vessel_effect(
    vessel: VesselSpec, path: str, name: str, position: np.ndarray, scene: SceneData, sea: Sea | None
) -> Effect:
    if vessel.rao is None:
        return VesselByTable(vessel.time, vessel.motion, position, np.array(vessel.heading), point=name)
    # fraction of the wave energy that the RAO table must cover, and how far waves may be outside its headings [rad]
    covered, margin = 0.95, 0.05
    waves = sea.waves
    omega, amplitude = np.asarray(waves.omega, float), np.asarray(waves.amplitude, float)
    course = np.broadcast_to(np.asarray(waves.direction, float), omega.shape) - vessel.heading
    table, energy = vessel.rao.full_circle(), amplitude**2
    heading = table.nearest_turn(course)
    inside = (omega >= table.frequency[0] * (1 - 1e-9)) & (omega <= table.frequency[-1] * (1 + 1e-9))
    if np.sum(energy[inside]) < covered * np.sum(energy):
        raise SceneError(
            f"{path}.rao.frequency: {table.frequency[0]:.4g} to {table.frequency[-1]:.4g} rad/s leave out "
            f"{1 - np.sum(energy[inside]) / np.sum(energy):.0%} of the waves' energy; allowed: at most 5%"
        )
    aside = (heading < table.headings[0] - margin) | (heading > table.headings[-1] + margin)
    if np.sum(energy[aside]) > (1.0 - covered) * np.sum(energy):
        worst = heading[aside][np.argmax(energy[aside])]
        raise SceneError(
            f"{path}.rao.headings: waves come at {worst:.4g} rad to the vessel; allowed: {table.headings[0]:.4g} to "
            f"{table.headings[-1]:.4g} rad"
        )
    response = table.response(omega, heading)
    return VesselInWaves(
        response.real,
        response.imag,
        place=vessel.position,
        arm=position,
        heading=np.array(vessel.heading),
        settled=jnp.array([0.0, scene.sea.ramp]),
        point=name,
    )
