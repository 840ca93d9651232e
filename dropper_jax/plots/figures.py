"""Figures of all pictures: their panels, titles, legends and foot, and writing them to disk. Sizes are in inches."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Text

from dropper_jax.base.files import atomic_write
from dropper_jax.plots.run import Run
from dropper_jax.plots.style import ALERT, FAINT

#: Sizes of the title and of the foot of a figure [points].
TITLE_SIZE = 12
FOOT_SIZE = 8
#: Distance of the title from the left, and of the foot from the right and the bottom, as fractions of the figure.
SIDE = 0.01
BOTTOM = 0.005
#: Height of the foot, one line of text, and of the space above the panels [inch].
FOOT = 0.17
HEAD = 0.03


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """A separate figure [inch] outside pyplot."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: str | Path) -> Path:
    """Write the figure in the format of the path's suffix (PNG without one), atomically."""
    path = Path(path)
    kind = path.suffix.lstrip(".").lower() or "png"
    _arrange(figure)
    atomic_write(path, lambda file: figure.savefig(file, format=kind))
    return path


def _arrange(figure: Figure) -> None:
    """Arrange the panels, once: `savefig` would draw the figure again for it."""
    keep_dollars(figure)
    layout = figure.get_layout_engine()
    if layout is not None and figure.axes:
        layout.execute(figure)
        figure.set_layout_engine(None)


def keep_dollars(figure: Figure) -> None:
    """Draw names with dollars as they are: between two of them matplotlib reads mathematics."""
    for text in figure.findobj(Text):
        given = text.get_text()
        if "$" in given and r"\mathdefault" not in given:  # which powers of ten next to an axis have
            text.set_parse_math(False)


def how(run: Run) -> tuple[str, str]:
    """Integrator, step and, if the run failed, its status, and the colour of this text."""
    used = run.settings
    text = used["integrator"]
    if used.get("accuracy") is not None:
        text = f"{text}, accuracy {used['accuracy']:g}"
    elif used["dt"]:  # an equilibrium has no step
        text = f"{text}, dt = {used['dt']:g} s"
    if run.status == "ok":
        return text, FAINT
    return f"{text}, ended with {run.status}", ALERT


def title(figure: Figure, text: str) -> None:
    """The title of a picture, in smaller letters where it would be wider than the picture."""
    drawn = figure.suptitle(text, fontsize=TITLE_SIZE, fontweight="bold", x=SIDE, ha="left")
    drawn.set_parse_math("$" not in text)
    width = drawn.get_window_extent().width / figure.bbox.width
    drawn.set_fontsize(TITLE_SIZE * min(1.0, (1.0 - 4.0 * SIDE) / width))


def panels(figure: FigureBase, count: int, columns: int = 1, **options: Any) -> np.ndarray:
    """Panels in rows of `columns`, filled row by row."""
    axes = figure.subplots(-(-count // columns), columns, squeeze=False, **options).ravel()
    for spare in axes[count:]:
        spare.set_visible(False)
    return axes[:count]


def outer_labels(panels: np.ndarray, columns: int, x: str, y: str) -> None:
    """Labels of the axes of panels: `x` below the last ones of each column, `y` at the left of each row."""
    for axes in panels[-columns:]:
        axes.set_xlabel(x)
        axes.tick_params(labelbottom=True)
    for axes in panels[::columns]:
        axes.set_ylabel(y)


def legend_above(axes: Axes, columns: int = 1, end: Literal["left", "right"] = "right", **options: Any) -> None:
    """A legend above an end of a panel."""
    if end == "left":
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, **options)
    else:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, **options)


def legend_below(figure: Figure, axes: Axes, columns: int, **options: Any) -> None:
    """The legend of one panel, which holds for all, below them."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower left", ncols=columns, **options)


def finish(figure: Figure, run: Run, what: str, path: str | Path) -> Path:
    """Write the figure with its title, and integrator and step at the bottom."""
    text, colour = how(run)
    title(figure, f"{run.scene.name}: {what}")
    figure.text(1.0 - SIDE, BOTTOM, text, color=colour, fontsize=FOOT_SIZE, ha="right", va="bottom")
    layout = figure.get_layout_engine()
    if isinstance(layout, ConstrainedLayoutEngine):
        foot, head = np.array([FOOT, HEAD]) / figure.get_figheight()
        layout.set(rect=(0.0, foot, 1.0, 1.0 - foot - head))
        _arrange(figure)
        for legend in figure.legends:  # which the layout leaves at the edge of the picture, on the foot
            legend.set_bbox_to_anchor((0.0, foot, 1.0, 1.0 - foot))
    return save(figure, path)
