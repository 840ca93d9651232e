"""The first chain of a film: where it is clearest, of markers in a row, or from given positions."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.films.flat_map import Flat
from fitting.films.ordering import (
    Chain,
    changes,
    distances,
    follow_unnamed,
    on_a_line,
)

#: Change of a length [pixel] up to which a row of markers is one line of links.
LINE_CHANGE = 1.0
#: Maximum distance of a given position from its circle [radius].
NEAR_CIRCLE = 3.0


def chain_in_line(centres: list[np.ndarray], nodes: int) -> Chain:
    """The chain of markers in a row, if as many circles as nodes always lie on a line.

    Raises:
        SceneError: otherwise.
    """
    counts = list(map(len, centres))
    if nodes in counts:
        at = counts.index(nodes)
        tracks = follow_unnamed(centres, at)
        line = on_a_line(tracks)
        if line is not None:
            change, mean = changes(tracks)
            pairs = (line[:-1], line[1:])
            if (change[pairs] <= LINE_CHANGE).all():
                return Chain(tracks[0, line], mean[pairs], change[pairs], at)
    raise SceneError(
        f"track: no chain of {nodes} moving markers found among {max(counts)} circles; "
        "use --start with the nodes' positions in the first frame"
    )


def named_chain(
    mapped: list[np.ndarray], centres: list[np.ndarray], named: np.ndarray, flat: Flat, radius: float, fps: float
) -> Chain:
    """The chain given by the user (n, 2) [pixel of the video] in the first frame.

    A position without a circle is that of a hidden marker, if all circles of the frame have a position, or if one
    appears there soon.

    Raises:
        SceneError: a position that is neither.
    """
    near_circle = NEAR_CIRCLE * radius
    positions = flat(named)
    apart = distances(named, centres[0])
    error = np.full(len(named), near_circle)
    for _ in range(min(apart.shape)):  # the nearest pairs first, no circle twice
        k, j = np.unravel_index(np.argmin(apart), apart.shape)
        if apart[k, j] > near_circle:
            break
        positions[k] = mapped[0][j]
        error[k] = 0.0
        apart[k] = np.inf
        apart[:, j] = np.inf
    missing = np.flatnonzero(error)
    # a missing circle may appear within half a second
    soon = np.concatenate([centres[0][:0], *centres[1 : max(2, round(0.5 * fps))]])
    away = distances(named, soon).min(axis=1, initial=np.inf)
    for k in missing[away[missing] > near_circle]:
        if len(centres[0]) > len(named) - len(missing):
            raise SceneError(
                f"--start: no separate circle found near node {k}; allowed: positions within 3 radii of the circles"
            )
    length = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return Chain(positions, length, np.hypot(error[1:], error[:-1]), 0)
