"""The table of figures of the paper and the thesis, and the scenes of their runs.

Rows of `source_figures.toml`; a figure with several scenes or damping coefficients has a case for each.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.load.packaged import find_scene
from dropper_jax.load.scene import Scene
from dropper_jax.run.simulate import Solution

TABLE = Path(__file__).with_name("source_figures.toml")
#: Kinds of figures that need no run, and interval of their samples of time [s].
WITHOUT_RUN = ("profile", "elevation", "steps")
SAMPLE_INTERVAL = 0.05


PAIR = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")


@dataclasses.dataclass(frozen=True)
class SourceFigure:
    """A figure of one of the sources, a row of the table, which describes the fields.

    Attributes:
        name: name on request, such as `paper-6`.
        caption: its description.
    """

    name: str
    caption: str
    kind: str
    scenes: tuple[str, ...]
    pairs: tuple[tuple[float, float], ...] = ()
    panels: tuple[str, ...] = ()
    links: tuple[int, ...] = ()
    angles: tuple[str, ...] = ("polar",)
    zero: str = "horizontal"
    span: tuple[float, float] | None = None
    duration: float | None = None
    at: float | None = None
    surface: bool = False
    from_hz: tuple[float, ...] = (0.0,)
    note: str = ""


class Case(NamedTuple):
    """One run of a figure: its distinguishing values, and its key among all runs."""

    label: str
    key: tuple[str, tuple[float, ...], float | None]


class Run(NamedTuple):
    """A completed case."""

    label: str
    solution: Solution


@cache
def figures() -> dict[str, SourceFigure]:
    """All figures by name, in the order of the table."""
    rows = tomllib.loads(TABLE.read_text(encoding="utf-8"))["figure"]
    found = [SourceFigure(**{key: _tuples(value) for key, value in row.items()}) for row in rows]
    return {figure.name: figure for figure in found}


def _tuples(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_tuples, value))
    return value


def figure_of(name: str) -> SourceFigure:
    """The figure of a name.

    Raises:
        SceneError: unknown figure.
    """
    if name not in figures():
        raise SceneError(f"figure: {name!r} is unknown; {nearest(name, list(figures()))}")
    return figures()[name]


def cases_of(figure: SourceFigure) -> list[Case]:
    """The runs of a figure; empty for one without runs."""
    if figure.kind in WITHOUT_RUN:
        return []
    cases = [(scene, pair) for scene in figure.scenes for pair in figure.pairs or ((),)]
    several = [len(figure.scenes) > 1, len(figure.pairs) > 1]
    words = lambda scene, pair: [scene, ", ".join(f"{k} = {x:g}" for k, x in zip(("b_l", "b_q"), pair, strict=False))]  # noqa: E731
    return [
        Case("; ".join(w for w, varies in zip(words(*case), several, strict=True) if varies), (*case, figure.duration))
        for case in cases
    ]


def scene_of(name: str, pair: Sequence[float] = (), duration: float | None = None) -> Scene:
    """The scene of a case, by its key."""
    scene = Scene.from_dict(*find_scene(name))
    values = dict(zip(PAIR, pair, strict=False)) | ({"run.duration": duration} if duration else {})
    if values:
        return scene.with_values(values)
    return scene
