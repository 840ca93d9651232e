"""Motion over time: of buoys, free points or nodes, and of bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.constants import DEGREE
from dropper_jax.plots import figures, scales, style
from dropper_jax.plots.movement import travel, travel_rounding
from dropper_jax.plots.run import Run, elevations
from dropper_jax.plots.style import CYCLE
from dropper_jax.plots.surroundings import SURFACE
from dropper_jax.plots.time_panels import Curve, Panel, history


@style.with_style
def motion_history(run: Run, path: str | Path) -> Path:
    """x, y and z [m] of buoys, else of free points or nodes, against time, and the surface over the first of them.

    Of several, those with the largest motion, each from its initial position. Directions without motion are left out. A
    long record is drawn as its envelope, with a zoom.
    """
    names = list(tracked_nodes(run))
    every = len(candidate_nodes(run))
    what = "motion"
    if len(names) == 1:
        what = f"motion of {names[0]}"
    if len(names) < every:
        what = f"motion of {len(names)} of {every} points (the largest)"
    return history(run, path, what, motion_panels(run))


def motion_panels(run: Run) -> list[Panel]:
    """The directions that move, and the surface."""
    nodes = tracked_nodes(run)
    names = list(nodes)
    positions = run.positions[:, list(nodes.values())]
    moved = positions
    labels = [""]
    what = "[m]"
    if len(names) > 1:
        moved = positions - positions[0]
        labels = names
        what = "from its start [m]"
    least = travel_rounding(run)
    found = []
    for axis, letter in enumerate("xyz"):
        curves = [Curve(name, run.t, values) for name, values in zip(labels, moved[..., axis].T, strict=True)]
        if any(np.ptp(curve.values) > least for curve in curves):
            found.append(Panel(f"{letter} {what}", curves))
    if not found:  # without motion the picture shows the position
        heights = zip(names, positions[..., 2].T, strict=True)
        found = [Panel("z [m]", [Curve(name, run.t, z) for name, z in heights], "nothing moves")]
    if run.scene.sea is not None:
        eta = elevations(run.scene, positions[:, :1].mean(axis=0), run.t)[:, 0]
        if np.ptp(eta) > 0:
            title = f"surface elevation above the mean position of {names[0]}"
            found.append(Panel("surface [m]", [Curve("", run.t, eta, colour=SURFACE)], title, zero=True))
    return found


#: Maximum number of points in one picture.
MAX_POINTS = 4


def tracked_nodes(run: Run) -> dict[str, int]:
    """Nodes to draw, by name: the candidates with the largest motion."""
    travelled = travel(run)
    return dict(sorted(candidate_nodes(run).items(), key=lambda item: -travelled[item[1]])[:MAX_POINTS])


def candidate_nodes(run: Run) -> dict[str, int]:
    """Nodes with a motion of interest, by name: buoys, else free points; of a single line also the node that moves
    most."""
    lively = int(np.argmax(travel(run)))
    nodes = {name: node for name, node in run.point_names.items() if node in run.joints}
    buoys = {buoy.node for buoy in run.buoys}
    wanted = {name: node for name, node in nodes.items() if node in buoys} or nodes
    if not wanted or (len(run.lines) == 1 and lively not in wanted.values()):
        wanted[f"node {lively}"] = lively
    return wanted


@style.with_style
def body_motion(run: Run, path: str | Path) -> Path:
    """Heave [m] and displacement [m], roll and pitch [deg] of each body against time.

    Returns:
        path of the picture; its suffix chooses the format.
    """
    bodies = run.bodies
    if bodies is None:
        raise ValueError(f"solution: scene {run.scene.name!r} has no [[body]]. Use a scene with bodies")
    figure = figures.new_figure(8.5, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    x, y, heave = np.moveaxis(bodies.position, -1, 0)
    away = np.hypot(x - x[0], y - y[0])
    roll, pitch, _ = np.moveaxis(DEGREE * bodies.attitude, -1, 0)
    for i, name in enumerate(bodies.names):
        look = {"color": CYCLE[i % len(CYCLE)], "lw": 1.0}
        panels[0].plot(run.t, away[:, i], label=name, **look)
        panels[1].plot(run.t, heave[:, i], **look)
        panels[2].plot(run.t, pitch[:, i], **look)
        if np.ptp(roll[:, i]) > 0.1:
            panels[2].plot(run.t, roll[:, i], ls="--", **look)
    for axes, label in zip(panels, ("displacement [m]", "heave [m]", "pitch, roll dashed [deg]"), strict=True):
        axes.set_ylabel(label)
    if len(bodies.names) > 1:
        figures.legend_above(panels[0], 4, "left", borderaxespad=0.2)
    scales.time_axis(panels[2], run.t)
    return figures.finish(figure, run, "motion of the bodies", path)
