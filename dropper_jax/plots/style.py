"""Common style and units of all pictures, and writing them to disk."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from contextlib import ContextDecorator
from pathlib import Path
from typing import Any, Literal

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure, FigureBase
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Text
from numpy.typing import ArrayLike

from dropper_jax.base.files import atomic_write
from dropper_jax.plots.run import Run, readable
from dropper_jax.run.simulate import Solution

#: Maximum tension [N] above which a figure is in kN.
IN_KILONEWTON = 5e3


def force_unit(values: ArrayLike) -> tuple[str, float]:
    """Unit and its size [N] for all forces [N] of a figure."""
    size = np.abs(np.asarray(values, float))
    if np.max(size, initial=0.0, where=np.isfinite(size)) >= IN_KILONEWTON:
        return "kN", 1e3
    return "N", 1.0


#: Palette of Okabe and Ito, which colour-blind readers can distinguish.
CYCLE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#6B6B6B")
FIRST, SECOND = CYCLE[:2]
FAINT = "#9AA0A6"
#: Of grids and bands behind curves.
LIGHT = "#E3E5E8"
DARK = "#2B2F33"
ALERT = "#B00020"

RC = {
    "figure.facecolor": "white",
    "figure.dpi": 120,
    "savefig.dpi": 120,
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.labelsize": 10,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#5F6368",
    "axes.labelcolor": DARK,
    "text.color": DARK,
    "xtick.color": "#5F6368",
    "ytick.color": "#5F6368",
    "axes.grid": True,
    "grid.color": LIGHT,
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    # an offset or a power of ten next to an axis overlaps other labels
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 6),
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    # Runs of 10 000s of samples: Agg draws long paths in pieces.
    "agg.path.chunksize": 20000,
}


def plot_style() -> ContextDecorator:
    """Use this style within the context or, as a decorator, for each call."""
    return matplotlib.style.context(["default", RC])


def with_style(draw: Callable[..., Path]) -> Callable[..., Path]:
    """Give `draw` the readable part of a solution and this style; the caller's settings are restored afterwards."""

    @functools.wraps(draw)
    @plot_style()
    def wrapper(solution: Solution, *args: Any, **kwargs: Any) -> Path:
        return draw(readable(solution), *args, **kwargs)

    return wrapper


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """A separate figure [inch] outside pyplot."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: str | Path) -> Path:
    """Write the figure in the format of the path's suffix (PNG without one), atomically."""
    path = Path(path)
    kind = path.suffix.lstrip(".").lower() or "png"
    keep_dollars(figure)
    layout = figure.get_layout_engine()
    if layout is not None and figure.axes:  # once, here: `savefig` would draw the figure again for it
        layout.execute(figure)
        figure.set_layout_engine(None)
    atomic_write(path, lambda file: figure.savefig(file, format=kind))
    return path


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
    """The title of a picture."""
    figure.suptitle(text, fontsize=12, fontweight="bold", x=0.01, ha="left")


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


def finish(figure: Figure, run: Run, what: str, path: str | Path) -> Path:
    """Write the figure with its title, and integrator and step at the bottom."""
    text, colour = how(run)
    title(figure, f"{run.scene.name}: {what}")
    figure.text(0.99, 0.005, text, color=colour, fontsize=8, ha="right", va="bottom")
    layout = figure.get_layout_engine()
    if isinstance(layout, ConstrainedLayoutEngine):
        # one line of text at the bottom [inch], and space at the top
        foot, head = np.array([0.17, 0.03]) / figure.get_figheight()
        layout.set(rect=(0.0, foot, 1.0, 1.0 - foot - head))
    return save(figure, path)


def time_axis(axes: Axes, t: np.ndarray) -> None:
    """Label and limits of a time axis that spans the samples."""
    axes.set_xlabel("time [s]")
    if t[-1] > t[0]:
        axes.set_xlim(t[0], t[-1])


def widen(values: np.ndarray, limits: Callable[[float, float], object]) -> None:
    """Give constant values a readable axis (`limits` sets it) instead of one that magnifies rounding errors."""
    known = values[np.isfinite(values)]
    if known.size and np.ptp(known) < 1e-6 * np.abs(known).max(initial=1.0):
        middle = 0.5 * (known.min() + known.max())
        half = 0.05 * max(1.0, abs(middle))
        limits(middle - half, middle + half)


#: Panels share a scale if none has a range smaller than the largest by this factor.
SIMILAR = 4.0


#: Height of the limits that contain all panels over that of the widest, above which each panel keeps its own middle.
APART = 2.0


def share_scales(panels: Iterable[Axes]) -> None:
    """The same vertical scale for panels of similar ranges, so that curves in different panels can be compared.

    Their limits are the same too, unless they are so far apart that curves would be flat, as the coordinates of a
    float far from the origin.
    """
    limits = [(np.ptp(axes.get_ylim()), axes) for axes in panels]
    left = sorted(limits, key=lambda item: -item[0])
    while left:
        widest = left[0][0]
        group = [axes for height, axes in left if height * SIMILAR >= widest]
        ends = [axes.get_ylim() for axes in group]
        low = np.min(ends)
        high = np.max(ends)
        for axes in group:
            if high - low > APART * widest:
                middle = np.mean(axes.get_ylim())
                axes.set_ylim(middle - 0.5 * widest, middle + 0.5 * widest)
            else:
                axes.set_ylim(low, high)
        left = left[len(group) :]


def marker(t: np.ndarray) -> str | None:
    """Draw runs of a few samples with points, since a line of one point is invisible."""
    return "o" if len(t) < 5 else None


def dot(run: Run) -> float:
    """Size of a node's mark [points]: smaller where there are many."""
    nodes = run.positions.shape[1]
    if nodes <= 40 or len(run.lines) == 1:
        return 4.0
    if nodes <= 200:
        return 2.0
    return 0.0


def bold(run: Run) -> float:
    """Fraction of the usual width of links, smaller for many lines."""
    if len(run.lines) == 1:
        return 1.0
    if len(run.lines) <= 12:
        return 0.75
    return 0.4


@functools.cache
def tension_map() -> Colormap:
    """Plasma without its pale end, which vanishes on white."""
    plasma = matplotlib.colormaps["plasma"]
    return LinearSegmentedColormap.from_list("tension", plasma(np.linspace(0.0, 0.87, 64)), bad=FAINT)


def tension_bar(figure: Figure, links: ScalarMappable, tension: np.ndarray, **where: Any) -> None:
    """Colour bar of tensions (...) [N] in N or kN: pointed if they exceed `tension_norm`, the maximum in its label."""
    known = tension[np.isfinite(tension)]
    lowest, highest = tension_limits(known)
    below = np.any(known < lowest)
    above = np.any(known > highest)
    extend = "neither"
    if below and above:
        extend = "both"
    elif below:
        extend = "min"
    elif above:
        extend = "max"
    unit, size = force_unit(known)
    label = f"tension [{unit}]"
    if above:
        label = f"{label}, maximum {known.max() / size:.4g}"
    figure.colorbar(links, extend=extend, label=label, format=lambda value, _: f"{value / size:g}", **where)


#: Number of tensions from which 1 % may be outside the colour range.
MANY_TENSIONS = 1000


def tension_norm(tension: np.ndarray) -> Normalize:
    """Colours of tensions [N] within `tension_limits`."""
    return Normalize(*tension_limits(tension), clip=True)


def tension_limits(tension: np.ndarray) -> tuple[float, float]:
    """Colour range of tensions [N]: from the 1st to the 99th percentile, so that one snap load does not hide the rest.

    For fewer values than `MANY_TENSIONS`, as in one configuration, the full range: a percentile would only cut the
    maximum.
    """
    known = tension[np.isfinite(tension)]
    if known.size == 0:
        return 0.0, 1.0
    low = known.min()
    high = known.max()
    if known.size >= MANY_TENSIONS:
        low, high = np.percentile(known, (1, 99))
    size = max(abs(low), abs(high))
    if high - low <= 1e-9 * size:
        pad = 0.05 * size or 1.0
        return low - pad, high + pad
    return low, high
