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
from dropper_jax.effects.cylinder import steady_drag
from dropper_jax.effects.morison_drag import relative_roughness
from dropper_jax.load.scene import Scene
from dropper_jax.run.arrays import bare_model, static_pose
from dropper_jax.run.wake_model import TURBULENCE, Elements, Wakes, solve_wakes
from dropper_jax.scene import LineSlice, line_slices
from dropper_jax.scene.data import first_nodes, link_differences


@dataclasses.dataclass(frozen=True)
class SceneWakes:
    """Solved wakes, fraction of the current per link (n,), the lines, direction of the current [rad], positions (n,
    3)."""

    wakes: Wakes
    share: np.ndarray
    lines: tuple[LineSlice, ...]
    direction: float
    positions: np.ndarray


def has_wakes(scene: Scene) -> bool:
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
    most = 30000  # maximum number of links with wakes: 200 rows of `longline-rows` have 20 800
    drag = scene.effects.get("morison_drag")
    if drag is None or scene.sea is None or scene.sea.current is None:
        raise SceneError(f"effects.morison_drag.wakes: scene {scene.name!r} lacks morison_drag or [sea.current]")
    if scene.line.links > most:
        raise SceneError(f"effects.morison_drag.wakes: more than {most} links; allowed: at most {most}")
    bare = dataclasses.replace(scene, effects={**scene.effects, "morison_drag": {**drag, "wakes": "none"}})
    model = bare_model(bare, "float64")
    sea = model.needed_sea
    nodes = static_pose(bare, model).positions
    first = nodes[first_nodes(scene)]
    along = link_differences(scene, nodes[None])[0]
    middle = first + 0.5 * along
    weight = np.linalg.norm(along, axis=1) * drag_diameter(scene)
    height = float(np.sum(weight * middle[:, 2]) / np.sum(weight))
    stream = np.zeros(2)
    if sea.current is not None:
        stream = np.asarray(sea.current.profile(jnp.asarray([height]), sea.depth))[0, :2]
    speed = float(np.hypot(*stream))
    if speed < 1e-6:
        raise SceneError(
            "effects.morison_drag.wakes: the current is zero at the height of the lines; allowed: above 0 m/s"
        )
    course = stream / speed
    side = np.array([-course[1], course[0]])
    coefficient = drag["cdn"]
    if coefficient is None:
        coefficient = steady_drag(relative_roughness(scene))
    elements = Elements(
        x=middle[:, :2] @ course,
        y=middle[:, :2] @ side,
        z=np.clip(middle[:, 2], -scene.sea.depth, 0.0),
        width=np.abs(along[:, :2] @ side),
        height=np.abs(along[:, 2]),
        diameter=drag_diameter(scene) * np.ones(len(middle)),
        drag_coefficient=coefficient * np.ones(len(middle)),
    )
    turbulence = TURBULENCE
    if drag["turbulence"] is not None:
        turbulence = float(drag["turbulence"])
    wakes = solve_wakes(elements, speed, scene.sea.depth, turbulence)
    return SceneWakes(wakes, wakes.inflow / speed, line_slices(scene), float(np.arctan2(stream[1], stream[0])), middle)


def wake_facts(found: SceneWakes) -> Table:
    """Fractions of the current by line, total drag over that without wakes, and the momentum balance."""
    wakes = found.wakes
    alone = 0.5 * np.sum(wakes.elements.drag_coefficient * wakes.elements.area) * wakes.speed**2
    lines = []
    for line in found.lines:
        lines.append({"line": line.name, "share": spread(found.share[line.links], ("min", "mean", "max"))})
    return {
        "current_m_per_s": wakes.speed,
        "turbulence": wakes.turbulence,
        "lines": lines,
        "drag_over_unsheltered": float(np.sum(wakes.drag) / alone) if alone > 0.0 else 1.0,
        "balance": wakes.balance,
    }
