"""Pictures of a scene at rest: its equilibrium, and the modes about it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dropper_jax import plots
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.plots import figures, style, view
from dropper_jax.run.samples import Samples
from dropper_jax.scene import line_slices
from dropper_jax.statics import Equilibrium
from dropper_jax.statics.modes import Modes
from dropper_jax.study.curves import save_titled


def pose(scene: Scene, found: Equilibrium, path: str | Path) -> Path:
    """The equilibrium, with links coloured by tension [N]."""
    once = np.zeros(1)
    solution = Samples(
        scene=scene,
        settings={"integrator": "static pose", "dt": 0.0},
        status=found.status,
        t=once,
        positions=found.positions[None],
        velocities=np.zeros((1, *np.shape(found.positions))),
        tension=found.tension[None],
        t_tension=once,
        kinetic=once,
        potential=once,
        work=np.zeros((1, 0)),
        work_names=(),
        step_status=once,
    )
    return plots.snapshot(solution, path)


#: Number of modes that are drawn.
DRAWN_MODES = 9
#: Ratio of height to length below which the modes are drawn below one another.
LOW_AND_LONG = 0.25
#: Maximum displacement as a fraction of the configuration's size.
SHAPE_SIZE = 0.12


@style.plot_style()
def mode_shapes(
    scene: Scene, model: Model, found: Equilibrium, modes: Modes, numbers: Sequence[int] | np.ndarray, path: str | Path
) -> Path:
    """The first modes with their numbers: the equilibrium, and both extremes of each motion where it shows most."""
    count = min(len(modes.period), DRAWN_MODES)
    extent = np.ptp(found.positions, axis=0)
    columns = min(count, 3)
    width, height = (3.6 * columns, 2.9)
    if extent[2] < LOW_AND_LONG * max(extent[:2]):
        columns = 1
        width, height = (7.4, 1.5)
    rows = -(-count // columns)
    figure = figures.new_figure(width + 0.6, height * rows + 0.8)
    for i, axes in enumerate(figures.panels(figure, count, columns)):
        _draw_mode(axes, scene, model, found, np.asarray(modes.shape[i]))
        axes.set_title(f"{numbers[i]}: {modes.period[i]:.3g} s", loc="left", fontsize=9)
    what = "modes"
    if len(modes.period) > count:
        what = f"the first {count} of {len(modes.period)} modes"
    return save_titled(figure, f"{scene.name}: {what} (dashed: equilibrium; displacements are enlarged)", path)


def _draw_mode(axes: Axes, scene: Scene, model: Model, found: Equilibrium, shape: np.ndarray) -> None:
    """The equilibrium, and both extremes of a mode with displacements of the free nodes in proportion to `shape`."""
    rest = found.positions
    r = np.asarray(found.state.r)
    largest = max(np.abs(shape).max(), np.finfo(float).tiny)
    moved = shape * SHAPE_SIZE * view.size(rest) / largest
    ends_of_lines = model.ends(found.state.t)
    extremes = [np.asarray(model.nodes(r + sign * moved, ends_of_lines)) for sign in (1.0, -1.0)]
    across, up = _plane(rest, extremes[0] - rest)
    for line in line_slices(scene):
        for nodes, colour in zip(extremes, (style.FIRST, style.SECOND), strict=True):
            axes.plot(*nodes[line.nodes][:, [across, up]].T, color=colour, lw=1.3)
        axes.plot(*rest[line.nodes][:, [across, up]].T, color=style.DARK, lw=0.9, ls=(0, (3, 3)))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")


def _plane(rest: np.ndarray, moved: np.ndarray) -> tuple[int, int]:
    """The two axes with the largest motion and extent: view from the side, the front, or above."""
    share = np.sum(moved**2, axis=0)
    extent = np.ptp(rest, axis=0)
    return max(((0, 2), (1, 2), (0, 1)), key=lambda pair: sum(share[list(pair)]) * np.hypot(*extent[list(pair)]))
