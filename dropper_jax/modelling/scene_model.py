"""Convert a scene to the arrays of a model."""

from __future__ import annotations

import numpy as np

from dropper_jax.axial import LAWS, AxialLaw, Groups
from dropper_jax.axial.force_table import stack_tables
from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import as_array
from dropper_jax.effects import EFFECTS
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.surface import line_reach
from dropper_jax.model import Failures, Graph, Line, Member, Model, Point, check_slots
from dropper_jax.scene import LineSpec, SceneData, join_lines, sliced_lines
from dropper_jax.sea.make import make_sea
from dropper_jax.statics.equilibrium import Equilibrium
from dropper_jax.statics.loads import release_loads
from dropper_jax.statics.static_pose import equilibrium


def bare_model(scene: SceneData, dtype: str | None = None) -> Model:
    """The model of a scene without its growth; bodies and buoys become separate effects."""
    index = {point.name: i for i, point in enumerate(scene.points)}
    points = tuple(Point(position=as_array(p.position), name=p.name, kind=p.kind) for p in scene.points)
    effects = [EFFECTS[name].build(values, scene) for name, values in scene.effects.items()]
    sea = None
    if scene.sea is not None:
        sea = make_sea(scene.sea, line_reach(scene))
    corners: list[Point] = []
    # imports inside: most scenes start without these modules
    if scene.bodies or scene.buoys or any(point.has_body for point in scene.points):
        from dropper_jax.modelling.bodies import make_bodies, make_point_loads  # noqa: PLC0415

        corners, rigid = make_bodies(scene, index)
        effects += [*make_point_loads(scene, index), *rigid]
    if scene.vessels:
        from dropper_jax.modelling.vessels import make_vessels  # noqa: PLC0415

        effects += make_vessels(scene, sea)
    if any(line.length_in_time for line in scene.lines):
        from dropper_jax.effects.length_in_time import changing_lengths  # noqa: PLC0415

        effects += changing_lengths(scene)
    model = Model((*points, *corners), (_line(scene, index, len(corners)),), tuple(effects), sea)
    model = model.cast(dtype or scene.run.dtype)
    for effect in model.effects:
        if not type(effect).__module__.startswith("dropper_jax."):  # the project's own ones have their tests
            check_slots(model, effect)
    return model


def _line(scene: SceneData, index: dict[str, int], corners: int) -> Line:
    line = scene.line
    return Line(
        length=as_array(line.length),
        mass=as_array(line.mass),
        centre_of_mass=as_array(line.centre_of_mass),
        inertia=as_array(line.inertia),
        diameter=as_array(displaced_diameter(line, scene)),
        outer_diameter=as_array(line.outer_diameter),
        geometry=_geometry(scene, index, corners),
        axial=_axial(scene.lines),
        failures=_failures(scene),
        name=line.name,
    )


def _geometry(scene: SceneData, index: dict[str, int], corners: int) -> Graph:
    nodes = scene.link_mass_nodes
    members = tuple(
        Member(n.name, n.links, index[n.start], index[n.end], nodes[n.name] != "shared", n.piece_of)
        for n in scene.lines
    )
    held = tuple(not p.is_free for p in scene.points)
    return Graph(members, held + (False,) * corners, is_path=scene.single_line is not None)


def _axial(lines: tuple[LineSpec, ...]) -> AxialLaw:
    """The axial law of all links; groups of links if the lines differ."""
    names = tuple(dict.fromkeys(line.axial_law for line in lines))
    if len(names) == 1:
        return _law(join_lines(lines))
    of = np.repeat([names.index(line.axial_law) for line in lines], [line.links for line in lines])
    laws = [_law(join_lines(tuple(line for line in lines if line.axial_law == name))) for name in names]
    return Groups(tuple(laws), tuple(tuple(np.flatnonzero(of == i).tolist()) for i in range(len(names))))


def _law(line: LineSpec) -> AxialLaw:
    if line.rigid:
        return LAWS["rigid"]()
    constants = line.constants
    if line.tables is not None:
        strain, force, slope = stack_tables(line.tables)
        constants = {"strain": strain, "force": force, "slope": slope}
    return LAWS[line.axial_law](EA=line.EA, damping=line.axial_damping, **constants)


def static_pose(scene: SceneData, model: Model) -> Equilibrium:
    """The equilibrium of a scene's model, under its release force if it has one."""
    return equilibrium(model, release_loads(model, scene.start))


def resting_nodes(scene: SceneData, model: Model) -> np.ndarray:
    """Nodes of a scene's model at rest, line after line (n + lines, 3) [m].

    Raises:
        SceneError: no equilibrium found.
    """
    pose = static_pose(scene, model)
    if pose.status != "ok":
        raise SceneError(f"start: {pose.message}")
    return pose.positions


def _failures(scene: SceneData) -> Failures | None:
    """The arrays of a scene's `[[failure]]` entries; None without any."""
    if not scene.failures:
        return None
    load = np.full((len(scene.failures), scene.line.links), np.inf)
    by_name = {line.name: (line, where.links) for line, where in sliced_lines(scene)}
    named = []
    times = []
    for row, spec in zip(load, scene.failures, strict=True):
        line, links = by_name[spec.line]
        own = spec.load
        if spec.load is None and spec.time is None:
            own = line.breaking_load
        if own is not None:
            row[links] = own
        number = -1
        if spec.link is not None:
            number = links.start + spec.link - 1
            row[np.arange(len(row)) != number] = np.inf
        named.append(number)
        times.append(np.inf if spec.time is None else spec.time)
    return Failures(as_array(load), as_array(times), tuple(named))
