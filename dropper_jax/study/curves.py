"""Parts of the pictures of studies: columns and groups of rows, looks of curves, and writing with a title."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.plots import figures, style


def series(rows: Sequence[Table], key: str) -> np.ndarray:
    """The values of a key in all rows (k,)."""
    return np.array(column(rows, key), float)


def grouped(rows: Iterable[Table], key: Callable[[Table], Any]) -> dict[Any, list[Table]]:
    """Rows by a key, in their order."""
    found: dict[Any, list[Table]] = {}
    for row in rows:
        found.setdefault(key(row), []).append(row)
    return found


MARKERS = "osD^v<>PX*hp"


def marks(index: int) -> Table:
    """Colour, marker and dash of a series by number, all different."""
    colours = style.CYCLE
    dash = ("-", "--", ":")[index // len(colours) % 3]
    return {"color": colours[index % len(colours)], "marker": MARKERS[index % len(MARKERS)], "ls": dash, "ms": 4}


def save_titled(figure: Figure, text: str, path: str | Path) -> Path:
    """Write a figure to a file, with a title."""
    figures.title(figure, text)
    return figures.save(figure, path)
