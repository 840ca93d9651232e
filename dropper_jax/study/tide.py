"""Equilibria through a cycle of current and level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import build_model
from dropper_jax.plots import figures, style
from dropper_jax.quantities.end_forces import fixed_point_loads
from dropper_jax.scene import line_slices, utilisations
from dropper_jax.sea import Sea
from dropper_jax.statics.loads import release_loads
from dropper_jax.statics.static_pose import equilibrium
from dropper_jax.study.curves import marks, save_titled, series

STEADY = "--tide: neither sea.current nor sea.level changes with time. Use a scene in which one does"


def cycle_times(sea: Sea, count: int) -> np.ndarray:
    """Times (count,) [s] over the longest constituent of current and level, or over their tables.

    Raises:
        SceneError: neither changes with time.
    """
    parts = [p for p in (sea.current, sea.level) if p is not None]
    periods = [np.max(p.period) for p in parts if p.period is not None]
    times = [p.time for p in parts if p.time is not None]
    if periods:
        return np.linspace(0.0, max(periods), count)
    if times:
        return np.linspace(min(map(np.min, times)), max(map(np.max, times)), count)
    raise SceneError(STEADY)


def tidal_cycle(scene: Scene, count: int = 13) -> Table:
    """Independent equilibria at times of a cycle: the line is assumed to follow the tide without delay.

    Returns:
        {rows, slack, slack_status}: per time {t_s, level_m, speed_m_per_s, status, displacement_m, line_moved_m,
        held_load_n, anchor_utilisation (of points with an `[[anchor]]`: load over capacity)}; `slack` are the positions
        (nodes, 3) [m] without a current at the mean level, `displacement_m` and `line_moved_m` the maximum horizontal
        displacements from there of all nodes and of the nodes of each line.
    """
    model = build_model(scene)
    sea = model.sea
    if sea is None:
        raise SceneError(STEADY)
    loads = release_loads(model, scene.start)
    times = cycle_times(sea, count)
    slack = equilibrium(replace(model, sea=replace(sea, current=None, level=None)), loads)
    rows = []
    for t in times:
        pose = equilibrium(model, loads, float(t))
        held = fixed_point_loads(scene, pose.positions, pose.tension, float(t))
        loads_of_anchors = {name: (np.hypot(*load[:2]), load[2]) for name, load in held.items()}
        moved = np.hypot(*(pose.positions - slack.positions)[:, :2].T)
        rows.append(
            {
                "t_s": float(t),
                "level_m": _level(sea, t),
                "speed_m_per_s": _speed(sea, t),
                "status": pose.status,
                "displacement_m": moved.max(),
                "line_moved_m": {line.name: moved[line.nodes].max() for line in line_slices(scene)},
                "held_load_n": held,
                "anchor_utilisation": utilisations(scene.anchors, loads_of_anchors),
            }
        )
    return {"rows": rows, "slack": slack.positions, "slack_status": slack.status}


def _level(sea: Sea, t: float) -> float:
    """Level of the sea [m]."""
    if sea.level is None:
        return 0.0
    return float(sea.level.at(jnp.asarray(t)))


def _speed(sea: Sea, t: float) -> float:
    """Speed of the current at the surface [m/s], negative after the current has turned."""
    if sea.current is None:
        return 0.0
    surface = jnp.linalg.norm(sea.current.profile(jnp.zeros(1), sea.depth))
    return float(sea.current.scale(jnp.asarray(t))) * float(surface)


@style.plot_style()
def draw_tide(name: str, rows: Sequence[Table], path: str | Path) -> Path:
    """Current, level, excursion and force on the fixed points through a cycle."""
    figure = figures.new_figure(7.5, 6.2)
    water, moved, tension = figure.subplots(3, 1, sharex=True)
    hours = series(rows, "t_s") / 3600.0
    water.plot(hours, series(rows, "speed_m_per_s"), label="current [m/s]", **marks(0))
    water.plot(hours, series(rows, "level_m"), label="level [m]", **marks(1))
    moved.plot(hours, series(rows, "displacement_m"), **marks(0))
    moved.set_ylabel("moved [m]")
    loads = column(rows, "held_load_n")
    for i, point in enumerate(loads[0]):
        tension.plot(hours, np.linalg.norm([load[point] for load in loads], axis=1) / 1e3, label=point, **marks(i))
    tension.set(xlabel="time [h]", ylabel="force [kN]")
    for axes in (water, tension):
        figures.legend_above(axes, 4, fontsize=8, borderaxespad=0.2)
    figure.align_ylabels()
    return save_titled(figure, f"{name}: through the tide", path)
