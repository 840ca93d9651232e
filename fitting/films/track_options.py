"""Options of `track`: which are allowed, and the frames of the film that they select."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.films.video import Video


def check_options(
    nodes: int,
    start: Sequence[tuple[float, float]] | None,
    plane: str | Path | None,
    square: float | None,
    scale: float | None,
    distance: float | None,
) -> None:
    """Reject options of `track` that are out of range or exclude one another."""
    if nodes < 2:
        raise SceneError(f"--nodes: {nodes} is too few; allowed: at least 2, both ends of the chain included")
    if sum(x is not None for x in (plane, scale, distance)) > 1:
        raise SceneError("track: more than one of --plane, --scale, --distance; allowed: one of them")
    if plane is not None and square is None:
        raise SceneError("--square: missing; needed: the side of the board's squares in m, because --plane is given")
    if start is not None and np.shape(start) != (nodes, 2):
        raise SceneError(f"--start: {len(start)} positions; allowed: {nodes}, one x,y per node")


#: Ends of the chain at which its order may start.
ENDS = ("auto", "left", "right", "top")


def check_first(first: str) -> None:
    """Reject an unknown end of the chain."""
    if first not in ENDS:
        raise SceneError(f"--first: {first!r} is unknown; allowed: {', '.join(ENDS)}")


def check_positive(options: dict[str, float | None]) -> None:
    """Reject values of options that are given and not positive numbers."""
    for name, value in options.items():
        if value is not None and not 0.0 < value < np.inf:
            raise SceneError(f"--{name}: {value:g}; allowed: a number > 0")


def frame_span(film: Video, begin: float, end: float | None) -> tuple[int, int | None]:
    """The first frame, and the one after the last, None for all, of a film from `begin` to `end` [s]."""
    if not 0.0 <= begin < np.inf or (end is not None and not begin < end < np.inf):
        raise SceneError(f"--from, --until: {begin:g} to {end} s; allowed: 0 <= from < until")
    if film.announced and begin * film.fps >= film.announced:
        raise SceneError(f"--from: {begin:g} s is after the end; allowed: below {film.announced / film.fps:.3g} s")
    first = round(begin * film.fps)
    if end is None:
        return first, None
    last = round(end * film.fps)
    if last <= first:
        raise SceneError(
            f"--from, --until: no frame is between {begin:g} and {end:g} s; allowed: 1/{film.fps:g} s or more"
        )
    return first, last
