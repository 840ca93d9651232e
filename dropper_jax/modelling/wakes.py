"""Wakes of lines in the current: the fraction of the current at each link, constant during the run.

The wakes are those of the equilibrium in the undisturbed current. Each link is an element of `wake_model` with its drag
coefficient `cdn` and its frontal area. The current of the wake model is uniform, with the value at the mean height of
the lines; the resulting fractions multiply the profile. Waves are not reduced.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import spread
from dropper_jax.base.read import Table
from dropper_jax.effects.buoyancy import drag_diameter
from dropper_jax.effects.morison_drag import relative_roughness
from dropper_jax.effects.rough_cylinder import steady_drag
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.scene_model import bare_model, resting_nodes
from dropper_jax.modelling.wake_model import TURBULENCE, Elements, Wakes, solve_wakes
from dropper_jax.scene import LineSlice, line_slices
from dropper_jax.scene.slices import first_nodes, link_differences
from dropper_jax.sea import Sea

#: Maximum number of links with wakes: 200 rows of `longline-rows` have 20 800.
MAX_LINKS = 30000
#: Minimum speed of a current that has wakes [m/s]: its direction is otherwise rounding.
MIN_SPEED = 1e-6


@dataclasses.dataclass(frozen=True)
class SceneWakes:
    """Wakes of a scene's links.

    Attributes:
        wakes: the solved wakes.
        share: fraction of the current at each link (n,).
        lines: the lines, with their links.
        direction: of the current from x towards y [rad].
    """

    wakes: Wakes
    share: np.ndarray
    lines: tuple[LineSlice, ...]
    direction: float


def has_wakes(scene: Scene) -> bool:
    """Whether lines of the scene slow the current for others."""
    return scene.effects.get("morison_drag", {}).get("wakes", "none") != "none"


def with_wakes(scene: Scene) -> Scene:
    """The scene with the current fractions of its wakes as `shelter`; a scene without wakes is unchanged."""
    if not has_wakes(scene):
        return scene
    drag = {**scene.effects["morison_drag"], "shelter": scene_wakes(scene).share, "wakes": "none", "turbulence": None}
    return dataclasses.replace(scene, effects={**scene.effects, "morison_drag": drag})


def scene_wakes(scene: Scene) -> SceneWakes:
    """The wakes of a scene's links.

    Raises:
        SceneError: no drag, no current, a zero current, or too many links.
    """
    depth = _checked_depth(scene)
    drag = scene.effects["morison_drag"]
    bare = dataclasses.replace(scene, effects={**scene.effects, "morison_drag": {**drag, "wakes": "none"}})
    model = bare_model(bare, "float64")
    nodes = resting_nodes(bare, model)
    along = link_differences(scene, nodes[None])[0]
    middle = nodes[first_nodes(scene)] + 0.5 * along
    stream = _stream(scene, model.needed_sea, middle, along)
    speed = float(np.hypot(*stream))
    if speed < MIN_SPEED:
        raise SceneError(
            "effects.morison_drag.wakes: the current is zero at the height of the lines; allowed: above 0 m/s"
        )
    turbulence = TURBULENCE
    if drag["turbulence"] is not None:
        turbulence = float(drag["turbulence"])
    elements = _elements(scene, depth, middle, along, stream / speed)
    wakes = solve_wakes(elements, speed, depth, turbulence)
    return SceneWakes(wakes, wakes.inflow / speed, line_slices(scene), float(np.arctan2(stream[1], stream[0])))


def _checked_depth(scene: Scene) -> float:
    """Depth of the water [m]; scenes without drag or current, or with too many links, are rejected."""
    if "morison_drag" not in scene.effects or scene.sea is None or scene.sea.current is None:
        raise SceneError(f"effects.morison_drag.wakes: scene {scene.name!r} lacks morison_drag or [sea.current]")
    if scene.line.links > MAX_LINKS:
        raise SceneError(f"effects.morison_drag.wakes: more than {MAX_LINKS} links; allowed: at most {MAX_LINKS}")
    return scene.sea.depth


def _stream(scene: Scene, sea: Sea, middle: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Horizontal current (2,) [m/s] at the mean height of the links, weighted by their area.

    Args:
        middle: middles of the links (n, 3) [m].
        along: vectors from their first to their last node (n, 3) [m].
    """
    if sea.current is None:
        return np.zeros(2)
    area = np.linalg.norm(along, axis=1) * drag_diameter(scene)
    height = float(np.sum(area * middle[:, 2]) / np.sum(area))
    return np.asarray(sea.current.profile(jnp.asarray([height]), sea.depth))[0, :2]


def _elements(scene: Scene, depth: float, middle: np.ndarray, along: np.ndarray, course: np.ndarray) -> Elements:
    """The links as elements of the wake model, in a current along the unit vector `course` (2,)."""
    side = np.array([-course[1], course[0]])
    coefficient = scene.effects["morison_drag"]["cdn"]
    if coefficient is None:
        coefficient = steady_drag(relative_roughness(scene))
    return Elements(
        x=middle[:, :2] @ course,
        y=middle[:, :2] @ side,
        z=np.clip(middle[:, 2], -depth, 0.0),
        width=np.abs(along[:, :2] @ side),
        height=np.abs(along[:, 2]),
        diameter=drag_diameter(scene) * np.ones(len(middle)),
        drag_coefficient=coefficient * np.ones(len(middle)),
    )


def wake_facts(found: SceneWakes) -> Table:
    """Fractions of the current by line, total drag over that without wakes, and the momentum balance."""
    wakes = found.wakes
    alone = 0.5 * np.sum(wakes.elements.drag_coefficient * wakes.elements.area) * wakes.speed**2
    lines = []
    for line in found.lines:
        lines.append({"line": line.name, "share": spread(found.share[line.links], ("min", "mean", "max"))})
    return {
        "current_m_per_s": wakes.speed,
        "turbulence": wakes.solver.turbulence,
        "lines": lines,
        "drag_over_unsheltered": float(np.sum(wakes.drag) / alone) if alone > 0.0 else 1.0,
        "balance": wakes.balance,
    }
