"""From a scene to the model: the arrays that move."""

from __future__ import annotations

import numpy as np

from dropper_jax.axial import LAWS, AxialLaw, Tabulated
from dropper_jax.axial.force_table import stacked
from dropper_jax.effects import EFFECTS, Effect
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.effects.point_bodies import PointBodies, WetPointBodies
from dropper_jax.effects.spar_buoys import SparBuoys
from dropper_jax.load.checks_water import line_reach
from dropper_jax.model import Graph, Line, Lines, Member, Model, Point, System
from dropper_jax.run.failures import make_failures
from dropper_jax.scene import LineSpec, PointSpec, SceneData
from dropper_jax.sea.make import make_sea
from dropper_jax.statics.static_pose import Equilibrium, equilibrium, nodal_loads


def bare_model(scene: SceneData, dtype: str | None = None) -> Model:
    """The model of a scene as it stands, its growth left out."""
    index = {point.name: i for i, point in enumerate(scene.points)}
    if scene.branched:
        return _system(scene).cast(dtype or scene.run.dtype)
    points = tuple(Point(position=p.position, name=p.name, kind=p.kind) for p in scene.points)
    lines = tuple(_line(line, index, scene) for line in scene.lines)
    effects = tuple(EFFECTS[name].build(values, scene) for name, values in scene.effects.items())
    sea = None if scene.sea is None else make_sea(scene.sea, line_reach(scene))
    return Model(points=points, lines=lines, effects=effects, sea=sea).cast(dtype or scene.run.dtype)


def _line(line: LineSpec, index: dict[str, int], scene: SceneData) -> Line:
    return Line(
        length=line.length,
        mass=line.mass,
        centre_of_mass=line.centre_of_mass,
        inertia=line.inertia,
        diameter=displaced_diameter(line, scene),
        axial=_axial(line),
        failures=make_failures(scene),
        name=line.name,
        start=index[line.start],
        end=index[line.end],
    )


def _system(scene: SceneData) -> System:
    """Lines joined at points; bodies and buoys become effects of their own."""
    index = {point.name: i for i, point in enumerate(scene.points)}
    members = tuple(Member(n.name, n.links, index[n.start], index[n.end]) for n in scene.lines)
    graph = Graph(members, tuple(p.kind == "fixed" for p in scene.points))
    line = scene.line
    lines = Lines(
        length=line.length,
        mass=line.mass,
        diameter=displaced_diameter(line, scene),
        axial=_axial(line),
        failures=make_failures(scene),
        graph=graph,
    )
    effects = [EFFECTS[name].build(values, scene) for name, values in scene.effects.items()]
    points = tuple(Point(position=p.position, name=p.name, kind=p.kind) for p in scene.points)
    sea = None if scene.sea is None else make_sea(scene.sea, line_reach(scene))
    return System(points=points, lines=(lines,), effects=(*effects, *_bodies(scene, index)), sea=sea)


def _bodies(scene: SceneData, index: dict[str, int]) -> list[Effect]:
    """What the points carry."""
    water = None if scene.sea is None else scene.sea.gravity
    gravity = scene.effects.get("weight", {}).get("gravity", water if water is not None else 9.81)
    found: list[Effect] = []
    loaded = [p for p in scene.points if p.body]
    if loaded:
        arrays = {key: np.array([getattr(p, key) or 0.0 for p in loaded]) for key in PointSpec.BODY}
        wet = scene.sea is not None
        cls = WetPointBodies if wet and np.any(arrays["volume"] * arrays["added_mass"]) else PointBodies
        found.append(cls(**arrays, gravity=gravity, points=tuple(index[p.name] for p in loaded), wet=wet))
    if scene.buoys:
        keys = ("mass", "diameter", "height", "attachment", "cdn", "cdt", "can", "cat")
        arrays = {key: np.array([getattr(b, key) for b in scene.buoys]) for key in keys}
        kinds = {b.end_added_mass for b in scene.buoys}
        found.append(
            SparBuoys(
                **arrays,
                gravity=gravity,
                points=tuple(index[b.point] for b in scene.buoys),
                end_added_mass=kinds.pop(),
            )
        )
    return found


def _axial(line: LineSpec) -> AxialLaw:
    if line.rigid:
        return LAWS["rigid"]()
    if line.tables is not None:
        strain, force, slope = stacked(line.tables)
        return Tabulated(EA=line.EA, damping=line.axial_damping, strain=strain, force=force, slope=slope)
    return LAWS[line.axial_law](EA=line.EA, damping=line.axial_damping)


def static_pose(scene: SceneData, model: Model) -> Equilibrium:
    """The pose at rest of a scene's model, held by its release force where it has one."""
    loads = nodal_loads(model, scene.start.release_nodes, scene.start.release_force)
    return equilibrium(model, loads)
