"""Convert a scene to the arrays of a model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dropper_jax.axial import LAWS, AxialLaw, Groups, Tabulated
from dropper_jax.axial.force_table import stack_tables
from dropper_jax.base.constants import GRAVITY
from dropper_jax.effects import EFFECTS, Effect
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.effects.point_bodies import PointBodies, WetPointBodies
from dropper_jax.effects.spar_buoys import SparBuoys
from dropper_jax.load.checks_water import line_reach
from dropper_jax.model import Failures, Geometry, Graph, Line, Member, Model, Parted, Path, Point, check_slots
from dropper_jax.run.bodies import make_bodies, make_vessels
from dropper_jax.scene import LineSpec, PointSpec, SceneData, join_lines
from dropper_jax.sea.make import make_sea
from dropper_jax.statics.search import Equilibrium
from dropper_jax.statics.static_pose import equilibrium, nodal_loads


def bare_model(scene: SceneData, dtype: str | None = None) -> Model:
    """The model of a scene without its growth; bodies and buoys become separate effects."""
    index = {point.name: i for i, point in enumerate(scene.points)}
    points = tuple(Point(position=p.position, name=p.name, kind=p.kind) for p in scene.points)
    effects = [EFFECTS[name].build(values, scene) for name, values in scene.effects.items()]
    corners, rigid = make_bodies(scene, index, _gravity(scene))
    sea = None if scene.sea is None else make_sea(scene.sea, line_reach(scene))
    line = _line(scene, index, len(corners))
    model = Model(
        (*points, *corners), (line,), (*effects, *_bodies(scene, index), *rigid, *make_vessels(scene, sea)), sea
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


def _geometry(scene: SceneData, index: dict[str, int], corners: int) -> Geometry:
    far = scene.link_mass_nodes
    members = tuple(Member(n.name, n.links, index[n.start], index[n.end], far[n.name] == "far") for n in scene.lines)
    held = tuple(not p.is_free for p in scene.points)
    return Graph(members, held + (False,) * corners) if scene.branched else Path(members, (True, held[members[0].end]))


def _bodies(scene: SceneData, index: dict[str, int]) -> list[Effect]:
    """Masses and loads attached to the points."""
    gravity = _gravity(scene)
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


def _gravity(scene: SceneData) -> float:
    water = None if scene.sea is None else scene.sea.gravity
    return scene.effects.get("weight", {}).get("gravity", water if water is not None else GRAVITY)


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
    loads = nodal_loads(model, scene.start.release_nodes, scene.start.release_force)
    return equilibrium(model, loads)


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
        own = line.breaking_load if spec.load is None and spec.time is None else spec.load
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
    found = []
    for link, t, tension in zip(
        *(np.asarray(x).tolist() for x in (parted.link, parted.t, parted.tension)), strict=True
    ):
        if link < 0:
            continue
        i = int(np.searchsorted(starts, link, side="right")) - 1
        row = {"line": scene.lines[i].name, "link": link - int(starts[i]) + 1, "time_s": t, "tension_n": tension}
        found.append(row)
    return tuple(sorted(found, key=lambda row: row["time_s"]))


def words(row: Mapping[str, Any]) -> str:
    """One line of text about a failure."""
    return (
        f"line {row['line']!r} broke at its link {row['link']} at t = {row['time_s']:.6g} s "
        f"under {row['tension_n']:.6g} N"
    )
