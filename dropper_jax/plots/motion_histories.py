"""Motion over time: buoys, bodies and free points, or the nodes of a single line, under the surface above them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.load.checks_water import surface_over
from dropper_jax.plots import moving, style, system, view
from dropper_jax.plots.run import Run
from dropper_jax.plots.series import Curve, Panel, history

#: Maximum number of points in one picture.
MOST = 4


@style.with_style
def motion_history(run: Run, path: str | Path) -> Path:
    """x, y and z [m] of buoys, else of free points or nodes, against time, and the surface over the first of them.

    Of several, those with the largest motion, each from its initial position. Directions without motion are left out. A
    long record is drawn as its envelope, with a zoom.
    """
    names = list(tracked_nodes(run))
    return history(run, path, f"motion of {names[0]}" if len(names) == 1 else "motion", motion_panels(run))


def motion_panels(run: Run) -> list[Panel]:
    """The directions that move, and the surface."""
    tracked = tracked_nodes(run)
    paths = {name: run.positions[:, node] for name, node in tracked.items()}
    alone = len(paths) == 1
    least = moving.TRAVEL * max(view.size(run.positions[:1]), 1e-300)
    panels = []
    for axis, letter in enumerate("xyz"):
        curves = [
            Curve("" if alone else name, run.t, path[:, axis] - (0.0 if alone else path[0, axis]))
            for name, path in paths.items()
        ]
        if any(np.ptp(curve.values) > least for curve in curves):
            panels.append(Panel(f"{letter} [m]" if alone else f"{letter} from its start [m]", curves))
    if not panels:  # without motion the picture shows the position
        panels = [Panel("z [m]", [Curve(name, run.t, path[:, 2]) for name, path in paths.items()], "nothing moves")]
    surface = _surface(run, next(iter(paths.values())), next(iter(paths)))
    return [*panels, *([surface] if surface else [])]


def tracked_nodes(run: Run) -> dict[str, int]:
    """Nodes to draw, by name: the buoys with the largest motion, else free points; of a single line its end and the
    node that moves most."""
    way = moving.travel(run)
    if run.scene is None:
        last, lively = run.positions.shape[1] - 1, int(np.argmax(way))
        found = {f"node {lively}": lively}
        if way[last] > 0.0 and last != lively:
            found["free end"] = last
        return found
    nodes = {name: node for name, node in run.point_names.items() if node in run.joints}
    buoys = {buoy.node for buoy in run.buoys}
    wanted = {name: node for name, node in nodes.items() if node in buoys} or nodes
    if not wanted:
        node = int(np.argmax(way))
        return {f"node {node}": node}
    names = sorted(wanted, key=lambda name: -way[wanted[name]])[:MOST]
    return {name: wanted[name] for name in names}


def _surface(run: Run, path: np.ndarray, name: str) -> Panel | None:
    """Elevation [m] over the mean position of a path (k, 3); None without waves."""
    position = path.mean(axis=0)
    title = f"surface elevation above the mean position of {name}"
    if run.scene is None:
        if run.surface is None:
            return None
        eta = run.surface(position[None], run.t)[:, 0]
    elif run.scene.sea is None or run.scene.sea.waves is None:
        return None
    else:
        eta = surface_over(run.scene, np.broadcast_to(position, (len(run.t), 1, 3)), run.t)[:, 0]
    if np.ptp(eta) == 0:
        return None
    return Panel("surface [m]", [Curve("", run.t, eta, colour=system.SURFACE)], title, zero=True)
