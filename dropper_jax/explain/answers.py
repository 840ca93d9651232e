"""Answers on a mooring at rest, and why: numbers per line, each next to a closed form or a second equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.explain.catenary import Shape
from dropper_jax.explain.line_facts import LineFacts, line_facts, refuse_rigid
from dropper_jax.explain.wear import Wear, wear_of_lines
from dropper_jax.modelling.build import build_model
from dropper_jax.modelling.growth import overgrown
from dropper_jax.plausibility.line_weights import wet_weights
from dropper_jax.quantities.end_forces import end_angles, end_forces
from dropper_jax.scene import whole_lines
from dropper_jax.statics.rigid_group import stiffness_of_group

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.statics.equilibrium import Equilibrium


@dataclass(frozen=True)
class Explained:
    """All answers on a scene.

    Attributes:
        lines, wear: by line.
        held: upper fixed points, which move together as a floater does.
        stiffness: of these about the origin (6, 6); None without any.
        closed_stiffness: horizontal stiffness along x and y by the closed forms of the lines; None if one has none.
        ignored: what the source file has and the scene does not.
    """

    lines: tuple[LineFacts, ...]
    wear: tuple[Wear, ...]
    held: tuple[str, ...]
    stiffness: np.ndarray | None
    closed_stiffness: tuple[float, float] | None
    ignored: tuple[str, ...]


def explain(scene: Scene, pose: Equilibrium) -> Explained:
    """The answers on a scene at rest.

    Args:
        pose: `equilibrium(scene)`, with status ok.

    Raises:
        SceneError: rigid links, whose tensions do not follow from lengths.
    """
    refuse_rigid(scene)
    positions = pose.positions
    shapes = {}
    facts = []
    grown = overgrown(scene)
    lines = whole_lines(grown)
    weights = wet_weights(grown)
    forces = end_forces(grown, positions[None], pose.tension[None])
    uplift = end_angles(positions[None], lines)
    for line in lines:
        ends = forces[line.name][0], uplift[line.name][0]
        found, shape = line_facts(grown, line, positions[line.nodes], weights[line.links].sum(), *ends)
        facts.append(found)
        shapes[line.name] = shape
    held = _held_above(scene)
    matrix = None
    if held:
        matrix = stiffness_of_group(build_model(scene), pose.state, held, (0.0, 0.0, 0.0)).matrix
    return Explained(
        lines=tuple(facts),
        wear=tuple(wear_of_lines(scene, pose.state)),
        held=held,
        stiffness=matrix,
        closed_stiffness=_closed_stiffness(scene, positions, shapes, held),
        ignored=tuple(scene.notes),
    )


def _held_above(scene: Scene) -> tuple[str, ...]:
    """Fixed points at which all lines end with their upper end."""
    height = {point.name: point.position[2] for point in scene.points}
    lower = set()
    ends = set()
    for line in whole_lines(scene):
        first, *_, last = line.stops.values()
        lower.add(min((first, last), key=lambda name: height[name]))
        ends.update(line.stops.values())
    return tuple(name for name in scene.fixed_points if name in ends - lower)


def _closed_stiffness(
    scene: Scene, positions: np.ndarray, shapes: dict[str, Shape | None], held: tuple[str, ...]
) -> tuple[float, float] | None:
    """Sum of the horizontal stiffnesses [N/m] along x and y of the lines at these points, all from a fixed anchor.

    None without such points, and if a line has no closed form, a free end, or hangs straight down.
    """
    if not held:
        return None
    total = np.zeros(2)
    for line in whole_lines(scene):
        ends = set(line.stops.values())
        if not ends & set(held):
            continue
        shape = shapes[line.name]
        if shape is None or shape.stiffness is None or not ends <= set(scene.fixed_points):
            return None
        across = (positions[line.nodes[-1]] - positions[line.nodes[0]])[:2]
        span = np.hypot(*across)
        if span == 0.0:
            return None
        along = (across / span) ** 2
        # a displacement across turns the line
        total += along * shape.stiffness[0, 0] + (1.0 - along) * shape.horizontal / span
    return total[0], total[1]
