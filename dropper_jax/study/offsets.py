"""Restoring force and tension of a mooring over the offset of points.

    F_restoring(d, a) = -e(a) . F,    e(a) = (cos a, sin a, 0)

F is the force of the lines on the moved points, all displaced by the distance d along e(a); all other nodes are in
equilibrium. This is the curve of MoorPy's and of other quasi-static programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.read import Table
from dropper_jax.base.records import names_of, rows_where
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import build_model
from dropper_jax.plots import figures, style
from dropper_jax.quantities.end_forces import end_force_vectors
from dropper_jax.scene import line_slices
from dropper_jax.statics import Equilibrium
from dropper_jax.statics.loads import release_loads
from dropper_jax.statics.rest_problem import check_point_names
from dropper_jax.statics.search import search
from dropper_jax.study.curves import grouped, marks, save_titled, series


def offset_curves(
    scene: Scene,
    points: Sequence[str],
    directions: Sequence[float] | np.ndarray,
    distances: Sequence[float] | np.ndarray,
    progress: Progress = silent,
) -> list[Table]:
    """Equilibria with points displaced together: a row per direction and distance.

    In systems of lines the search for an equilibrium starts from that of the previous distance, at the first distance
    of a direction from the first one of all; all searches are one compiled program. A single line has its own guess.

    Args:
        points: names of fixed points.
        directions: horizontal directions [deg], 0 along x, 90 along y.
        distances: displacements (k,) [m], in rising order.

    Returns:
        {direction_deg, distance_m, status, force_n, restoring_n, transverse_n, end_tension_n, max_tension_n, max_line}
        per row: force of the lines on the moved points together (x, y, z) [N], its components against the displacement
        and 90 degrees to the left of it, maximum tension at an end of a line on a moved point, maximum tension of all
        links and the line that has it; status `ok` or `not_converged`, then without numbers.

    Raises:
        SceneError: unknown points, free points, points at which no line ends, or the same point twice.
    """
    _check_points(scene, points)
    model = build_model(scene)
    loads = release_loads(model, scene.start)
    rows: list[Table] = []
    first: State | None = None
    for i, direction in enumerate(directions):
        progress(i / len(directions), f"direction {direction:g} deg")
        angle = np.radians(direction)
        along = np.array([np.cos(angle), np.sin(angle), 0.0])
        previous = first
        for distance in distances:
            displaced = _displace_points(model, points, distance * along)
            pose = search(displaced, loads, t=0.0, near=previous)
            row = {"direction_deg": float(direction), "distance_m": float(distance), "status": pose.status}
            if pose.status == "ok":
                previous = pose.state
                if first is None:
                    first = previous
                row |= _loads(scene, points, pose, along)
            rows.append(row)
    progress(1.0, "")
    return rows


def _check_points(scene: Scene, names: Sequence[str]) -> None:
    """Check that the names are those of different fixed points at which lines end."""
    check_point_names(names, names_of(scene.points))
    at_ends = {end for line in scene.lines for end in (line.start, line.end)}
    for name in names:
        if name not in scene.fixed_points:
            fixed = ", ".join(scene.fixed_points)
            raise SceneError(f"points: {name!r} is free and finds its own position; allowed: fixed points: {fixed}")
        if name not in at_ends:
            raise SceneError(f"points: no line ends at {name!r}; allowed: ends of lines")


def _displace_points(model: Model, names: Sequence[str], displacement: np.ndarray) -> Model:
    """The model with points displaced by a vector (3,) [m]."""
    points = []
    for point in model.points:
        if point.name in names:
            point = replace(point, position=point.position + displacement)
        points.append(point)
    return replace(model, points=tuple(points))


def _loads(scene: Scene, moved: Sequence[str], pose: Equilibrium, along: np.ndarray) -> Table:
    """The loads of a row: forces of the lines on the moved points, whose displacement has the direction `along` (3,),
    and the maximum tension."""
    lines = line_slices(scene)
    tension = pose.tension
    vectors = end_force_vectors(scene, pose.positions[None], tension[None], lines)
    ends = []
    for line in scene.lines:
        for i, point in enumerate((line.start, line.end)):
            if point in moved:
                ends.append(vectors[line.name][0, i])
    force = np.sum(ends, axis=0)
    link = int(np.argmax(tension))
    return {
        "force_n": force,
        "restoring_n": -force @ along,
        "transverse_n": along[0] * force[1] - along[1] * force[0],
        "end_tension_n": np.max(np.linalg.norm(ends, axis=1)),
        "max_tension_n": tension[link],
        "max_line": next(line.name for line in lines if line.links.start <= link < line.links.stop),
    }


@style.plot_style()
def draw_offsets(name: str, rows: Sequence[Table], path: str | Path) -> Path:
    """Restoring force and maximum tension over the offset, a curve for each direction."""
    figure = figures.new_figure(9.5, 4.4)
    restoring, tension = figure.subplots(1, 2, sharex=True)
    for i, (direction, own) in enumerate(grouped(rows, itemgetter("direction_deg")).items()):
        shown = rows_where(own, "status", "ok")
        for axes, key in ((restoring, "restoring_n"), (tension, "max_tension_n")):
            axes.plot(series(shown, "distance_m"), series(shown, key) / 1e3, label=f"{direction:g}", **marks(i))
    restoring.set(xlabel="offset [m]", ylabel="restoring force [kN]")
    tension.set(xlabel="offset [m]", ylabel="maximum tension [kN]")
    figure.legend(*restoring.get_legend_handles_labels(), title="direction [deg]", loc="outside right upper")
    return save_titled(figure, f"{name}: restoring force and tension over the offset", path)
