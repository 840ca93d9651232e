"""Equilibria through a tidal cycle: displacement of the line, and its force on the fixed points."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.run.build import build_model
from dropper_jax.scene import held_loads, line_slices, utilisations
from dropper_jax.statics.static_pose import equilibrium, nodal_loads


def cycle_times(scene: Scene, count: int) -> np.ndarray:
    """Times (count,) [s] over the longest constituent of current and level, or over their tables.

    Raises:
        SceneError: neither changes with time.
    """
    parts = [] if scene.sea is None else [p for p in (scene.sea.current, scene.sea.level) if p is not None]
    periods = [float(np.max(p.period)) for p in parts if p.period is not None]
    spans = [p.time for p in parts if p.time is not None]
    if periods:
        return np.linspace(0.0, max(periods), count)
    if spans:
        return np.linspace(min(s[0] for s in spans), max(s[-1] for s in spans), count)
    raise SceneError("--tide: neither sea.current nor sea.level changes with time. Use a scene in which one does")


def tidal_cycle(scene: Scene, count: int = 13) -> dict[str, Any]:
    """Independent equilibria at times of a cycle: the line is assumed to follow the tide without delay.

    Returns:
        {rows, slack, slack_status}: per time {t_s, level_m, speed_m_per_s, status, displacement_m, line_moved_m,
        held_load_n, anchor_utilisation (of points with an `[[anchor]]`: load over capacity)}; `slack` are the positions
        (nodes, 3) [m] without a current at the mean level, `displacement_m` and `line_moved_m` the maximum horizontal
        displacements from there of all nodes and of the nodes of each line.
    """
    model = build_model(scene)
    loads = nodal_loads(model, scene.start.release_nodes, scene.start.release_force)
    times = cycle_times(scene, count)
    slack = equilibrium(replace(model, sea=replace(model.sea, current=None, level=None)), loads)
    rows = []
    for t in times:
        pose = equilibrium(model, loads, float(t))
        held = held_loads(scene, pose.positions, pose.tension)
        used = utilisations(scene.anchors, {name: (np.hypot(*load[:2]), load[2]) for name, load in held.items()})
        way = np.hypot(*(pose.positions - slack.positions)[:, :2].T)
        rows.append(
            {
                "t_s": float(t),
                "level_m": 0.0 if model.sea.level is None else float(model.sea.level.at(jnp.asarray(t))),
                "speed_m_per_s": _speed(model.sea, float(t)),
                "status": pose.status,
                "displacement_m": float(way.max()),
                "line_moved_m": {line.name: float(way[line.nodes].max()) for line in line_slices(scene)},
                "held_load_n": held,
                "anchor_utilisation": {name: float(value) for name, value in used.items()},
            }
        )
    return {"rows": rows, "slack": slack.positions, "slack_status": slack.status}


def _speed(sea: Any, t: float) -> float:
    """Speed of the current at the surface [m/s], negative after the current has turned."""
    if sea.current is None:
        return 0.0
    factor = float(sea.current.scale(jnp.asarray(t)))
    return factor * float(jnp.linalg.norm(sea.current.profile(jnp.zeros(1), sea.depth)))
