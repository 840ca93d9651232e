"""Style of all pictures: colours, fonts, grids."""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import ContextDecorator
from pathlib import Path
from typing import Any

import matplotlib.style

from dropper_jax.plots.run import readable
from dropper_jax.run.simulate import Solution

#: Palette of Okabe and Ito, which colour-blind readers can distinguish.
CYCLE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#6B6B6B")
FIRST, SECOND = CYCLE[:2]
FAINT = "#9AA0A6"
#: Of grids and bands behind curves.
LIGHT = "#E3E5E8"
DARK = "#2B2F33"
ALERT = "#B00020"

#: Settings of matplotlib that differ from its defaults: sizes of text in points, resolution in dots per inch.
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
