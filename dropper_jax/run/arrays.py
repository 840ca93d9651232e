"""Convert a scene to the arrays of a model, its rigid bodies included."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.axial import LAWS, AxialLaw, Groups, Tabulated
from dropper_jax.axial.tabulated import stack_tables
from dropper_jax.base.errors import SceneError
from dropper_jax.effects import EFFECTS, Effect
from dropper_jax.effects.body_bed import BodyBed, BodyBedFriction
from dropper_jax.effects.body_buoyancy import BodyBuoyancy, BodyBuoyancyInWaves, Pieces
from dropper_jax.effects.body_water import BodyWater
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.effects.length_in_time import changing_lengths
from dropper_jax.effects.point_bodies import PointBodies, WetPointBodies
from dropper_jax.effects.rigid_bodies import MOMENTS, RigidBodies, tetrahedron
from dropper_jax.effects.spar_buoys import SparBuoys
from dropper_jax.effects.vessel_motion import VesselByTable, VesselInWaves
from dropper_jax.load.checks_water import line_reach
from dropper_jax.model import Failures, Graph, Line, Member, Model, Parted, Point, check_slots
from dropper_jax.scene import BodySpec, LineSpec, PointSpec, SceneData, VesselSpec, attitude, join_lines
from dropper_jax.sea import Sea
from dropper_jax.sea.make import make_sea
from dropper_jax.statics.search import Equilibrium
from dropper_jax.statics.static_pose import equilibrium, nodal_loads

# --- rigid bodies ---


def make_bodies(scene: SceneData, index: dict[str, int]) -> tuple[list[Point], list[Effect]]:
    """The bodies' corners as points, after those of the scene, and the effects that make bodies of them."""
    if not scene.bodies:
        return [], []
    corner = np.array([tetrahedron(body.mass, body.centre_of_mass, body.inertia_matrix) for body in scene.bodies])
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
        gravity=scene.gravity,
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
    return Pieces(
        ends=np.stack([_shares(rigid, [(row[0], row[side]) for row in found]) for side in (1, 2)], axis=1),
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
    covered = 0.95
    margin = 0.05
    waves = sea.waves
    omega = np.asarray(waves.omega, float)
    amplitude = np.asarray(waves.amplitude, float)
    course = np.broadcast_to(np.asarray(waves.direction, float), omega.shape) - vessel.heading
    table = vessel.rao.full_circle()
    energy = amplitude**2
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


def bare_model(scene: SceneData, dtype: str | None = None) -> Model:
    """The model of a scene without its growth; bodies and buoys become separate effects."""
    index = {point.name: i for i, point in enumerate(scene.points)}
    points = tuple(Point(position=p.position, name=p.name, kind=p.kind) for p in scene.points)
    effects = [EFFECTS[name].build(values, scene) for name, values in scene.effects.items()]
    corners, rigid = make_bodies(scene, index)
    if scene.sea is None:
        sea = None
    else:
        sea = make_sea(scene.sea, line_reach(scene))
    line = _line(scene, index, len(corners))
    model = Model(
        (*points, *corners),
        (line,),
        (*effects, *_bodies(scene, index), *rigid, *make_vessels(scene, sea), *changing_lengths(scene)),
        sea,
    )
    model = model.cast(dtype or scene.run.dtype)
    for effect in model.effects:
        if not type(effect).__module__.startswith("dropper_jax."):  # the project's own ones have their tests
            check_slots(model, effect)
    return model


def _line(scene: SceneData, index: dict[str, int], corners: int) -> Line:
    line = scene.line
    return Line(
        length=line.length,
        mass=line.mass,
        centre_of_mass=line.centre_of_mass,
        inertia=line.inertia,
        diameter=displaced_diameter(line, scene),
        outer_diameter=line.outer_diameter,
        geometry=_geometry(scene, index, corners),
        axial=_axial(scene.lines),
        failures=make_failures(scene),
        name="line" if scene.branched else line.name,
    )


def _geometry(scene: SceneData, index: dict[str, int], corners: int) -> Graph:
    far = scene.link_mass_nodes
    single = not scene.branched
    members = tuple(
        Member(n.name, n.links, index[n.start], index[n.end], single or far[n.name] == "far") for n in scene.lines
    )
    held = tuple(not p.is_free for p in scene.points)
    return Graph(members, held + (False,) * corners, is_path=single)


def _bodies(scene: SceneData, index: dict[str, int]) -> list[Effect]:
    """Masses and loads attached to the points."""
    found: list[Effect] = []
    loaded = [p for p in scene.points if p.body]
    if loaded:
        arrays = {key: np.array([getattr(p, key) or 0.0 for p in loaded]) for key in PointSpec.BODY}
        wet = scene.sea is not None
        if wet and np.any(arrays["volume"] * arrays["added_mass"]):
            cls = WetPointBodies
        else:
            cls = PointBodies
        found.append(cls(**arrays, gravity=scene.gravity, points=tuple(index[p.name] for p in loaded), wet=wet))
    if scene.buoys:
        keys = ("mass", "diameter", "height", "attachment", "cdn", "cdt", "can", "cat")
        arrays = {key: np.array([getattr(b, key) for b in scene.buoys]) for key in keys}
        kinds = {b.end_added_mass for b in scene.buoys}
        found.append(
            SparBuoys(
                **arrays,
                gravity=scene.gravity,
                points=tuple(index[b.point] for b in scene.buoys),
                end_added_mass=kinds.pop(),
            )
        )
    return found


def _axial(lines: tuple[LineSpec, ...]) -> AxialLaw:
    """The axial law of all links; groups of links if the lines differ."""
    names = tuple(dict.fromkeys(line.axial_law for line in lines))
    if len(names) == 1:
        return _law(join_lines(lines))
    of = np.concatenate([[names.index(line.axial_law)] * line.links for line in lines])
    laws = tuple(_law(join_lines(tuple(line for line in lines if line.axial_law == name))) for name in names)
    return Groups(laws, tuple(tuple(np.flatnonzero(of == i).tolist()) for i in range(len(names))))


def _law(line: LineSpec) -> AxialLaw:
    if line.rigid:
        return LAWS["rigid"]()
    if line.tables is not None:
        strain, force, slope = stack_tables(line.tables)
        return Tabulated(EA=line.EA, damping=line.axial_damping, strain=strain, force=force, slope=slope)
    return LAWS[line.axial_law](EA=line.EA, damping=line.axial_damping, **line.constants)


def static_pose(scene: SceneData, model: Model) -> Equilibrium:
    """The equilibrium of a scene's model, under its release force if it has one."""
    return equilibrium(model, nodal_loads(model, scene.start.release_nodes, scene.start.release_force))


def make_failures(scene: SceneData) -> Failures | None:
    """The arrays of a scene's `[[failure]]` entries; None without any."""
    if not scene.failures:
        return None
    starts = np.cumsum([0, *(line.links for line in scene.lines)])
    load = np.full((len(scene.failures), starts[-1]), np.inf)
    named = []
    for row, spec in zip(load, scene.failures, strict=True):
        i = next(i for i, line in enumerate(scene.lines) if line.name == spec.line)
        line = scene.lines[i]
        if spec.load is None and spec.time is None:
            own = line.breaking_load
        else:
            own = spec.load
        if own is not None:
            row[starts[i] : starts[i + 1]] = own
        named.append(-1 if spec.link is None else int(starts[i]) + spec.link - 1)
        if named[-1] >= 0:
            row[np.arange(len(row)) != named[-1]] = np.inf
    times = np.array([np.inf if spec.time is None else spec.time for spec in scene.failures])
    return Failures(load, times, tuple(named))


def breaks(scene: SceneData, parted: Parted | None) -> tuple[dict[str, Any], ...]:
    """Broken links of a run, by time: line, link (from 1), time [s] and tension [N]."""
    if parted is None:
        return ()
    starts = np.cumsum([0, *(line.links for line in scene.lines)])
    broken = np.flatnonzero(np.asarray(parted.link) >= 0)
    columns = (np.asarray(x)[broken].tolist() for x in (parted.link, parted.t, parted.tension))
    found = [
        {"line": scene.lines[i].name, "link": link - int(starts[i]) + 1, "time_s": t, "tension_n": tension}
        for link, t, tension in zip(*columns, strict=True)
        for i in [int(np.searchsorted(starts, link, side="right")) - 1]
    ]
    return tuple(sorted(found, key=lambda row: row["time_s"]))


def words(row: Mapping[str, Any]) -> str:
    """One line of text about a failure."""
    return (
        f"line {row['line']!r} broke at its link {row['link']} at t = {row['time_s']:.6g} s "
        f"under {row['tension_n']:.6g} N"
    )
