"""`dropper view`: a run as one interactive HTML page that works offline.

Colours are those of the pictures (see `report.page_data` for what the page shows).
"""

from __future__ import annotations

import html
import json
import re
from importlib import resources
from pathlib import Path

import numpy as np

from dropper_jax.base.files import atomic_write
from dropper_jax.plots import tension_colours
from dropper_jax.plots.run import readable
from dropper_jax.report.page_data import page_data
from dropper_jax.run.simulate import Solution

__all__ = ["pair_page", "view_page", "write_view"]

#: Files of the program of a page, in the order of their dependencies.
PROGRAM = ("run.js", "pick.js", "solid.js", "pair.js", "view.js")


def write_view(solution: Solution, path: str | Path, other: Solution | None = None) -> Path:
    """Write the page of a solution, or of two side by side, atomically."""
    page = view_page(solution) if other is None else pair_page(solution, other)
    return atomic_write(path, page)


def pair_page(first: Solution, second: Solution) -> str:
    """Two runs side by side as one page: the same colours for the same tension, one clock and one camera."""
    limits = [tension_colours.tension_limits(readable(solution).tension) for solution in (first, second)]
    shared = (np.min(limits), np.max(limits))
    pages = [html.escape(view_page(solution, shared)) for solution in (first, second)]
    title = html.escape(" and ".join(dict.fromkeys([first.scene.name, second.scene.name])))
    return _fill_page("two.html", TITLE=title, FIRST=pages[0], SECOND=pages[1])


def view_page(solution: Solution, limits: tuple[float, float] | None = None) -> str:
    """The page as text: lines of nodes and links coloured by tension, their fixed ends, and water if the scene has any.

    Times [s], positions [m] and tensions [N] are float32, which is sufficient for display, but not for calculations.

    Args:
        limits: tensions [N] at the ends of the colours; None: the range of the run.
    """
    run = readable(solution)
    # `<` would let a scene's name end the script element
    data = json.dumps(page_data(run, limits or tension_colours.tension_limits(run.tension)), allow_nan=False)
    data = data.replace("<", "\\u003c")
    script = "\n".join(map(_asset, PROGRAM))
    return _fill_page(
        "view.html", TITLE=html.escape(run.scene.name), STYLE=_asset("view.css"), DATA=data, SCRIPT=script
    )


def _fill_page(name: str, **parts: str) -> str:
    """A page of the assets with each mark `/*NAME*/` replaced by the part of that name.

    All are replaced in one pass, because an inserted text may contain such marks itself.
    """
    return re.sub(r"/\*([A-Z]+)\*/", lambda mark: parts[mark[1]], _asset(name))


def _asset(name: str) -> str:
    """A file of the page."""
    return (resources.files("dropper_jax.report") / "assets" / name).read_text(encoding="utf-8")
