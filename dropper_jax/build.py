"""From a scene to the model: the arrays that move."""

from __future__ import annotations

from typing import Any

from dropper_jax.axial import LAWS, Axial
from dropper_jax.effects import EFFECTS
from dropper_jax.model import Line, Model, Point
from dropper_jax.scene import Scene
from dropper_jax.sea.checks import displaced_diameter, line_reach
from dropper_jax.sea.make import make_sea
from dropper_jax.sections import LineSpec


def build_model(scene: Scene, dtype: Any = None) -> Model:
    """The model of a scene, with arrays of `dtype` (default: the scene's precision)."""
    index = {point.name: i for i, point in enumerate(scene.points)}
    points = tuple(Point(position=p.position, name=p.name, kind=p.kind) for p in scene.points)
    lines = tuple(_line(line, index, scene) for line in scene.lines)
    effects = tuple(EFFECTS[name].build(values, scene) for name, values in scene.effects.items())
    sea = None if scene.sea is None else make_sea(scene.sea, line_reach(scene))
    return Model(points=points, lines=lines, effects=effects, sea=sea).cast(dtype or scene.run.dtype)


def _line(line: LineSpec, index: dict[str, int], scene: Scene) -> Line:
    return Line(
        length=line.length,
        mass=line.mass,
        centre_of_mass=line.centre_of_mass,
        inertia=line.inertia,
        diameter=displaced_diameter(line, scene),
        axial=_axial(line),
        name=line.name,
        start=index[line.start],
        end=index[line.end],
    )


def _axial(line: LineSpec) -> Axial:
    if line.rigid:
        return LAWS["rigid"]()
    return LAWS[line.axial_law](EA=line.EA, damping=line.axial_damping)
