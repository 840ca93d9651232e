"""Chains whose order motion does not tell: named by the user, or lying on a line."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.tracking.detection import Circles
from fitting.tracking.flattening import Flat
from fitting.tracking.ordering import Chain, changes, follow_unnamed, on_a_line

#: Distance of a named place from its circle [radius], and time within which a missing circle may come [s].
NEAR, SOON = 3.0, 0.5
#: Change of a length up to which a row of markers is one line of links [pixel].
STIFF = 1.0


def chain_in_line(circles: list[Circles], nodes: int) -> Chain | None:
    """The chain of markers in a row, where as many circles as nodes lie on a line all the time."""
    counts = np.array([len(each) for each in circles])
    if not (counts == nodes).any():
        return None
    at = int(np.argmax(counts == nodes))
    tracks = follow_unnamed([each.centre for each in circles[at:]], 0)
    line = on_a_line(tracks)
    if line is None:
        return None
    change, mean = changes(tracks)
    if (change[line[:-1], line[1:]] > STIFF).any():
        return None
    return Chain(tracks[0, line], mean[line[:-1], line[1:]], change[line[:-1], line[1:]], at)


def named_chain(
    mapped: list[Circles], circles: list[Circles], named: np.ndarray, flat: Flat, radius: float, fps: float
) -> Chain:
    """The chain named by the user (n, 2) [pixel of the video] in the first frame.

    A name without a circle is that of a marker that does not show there: where all circles of the frame are named, or
    one comes there soon.

    Raises:
        SceneError: a name that is neither.
    """
    nodes, first = len(named), circles[0].centre
    places, error = flat(named), np.zeros(nodes)
    apart = np.linalg.norm(named[:, None] - first[None], axis=-1)
    own = np.full(nodes, -1)
    for _ in range(min(apart.shape)):  # the nearest pairs first, no circle twice
        k, j = np.unravel_index(np.argmin(apart), apart.shape)
        if apart[k, j] > NEAR * radius:
            break
        own[k], places[k] = j, mapped[0].centre[j]
        apart[k], apart[:, j] = np.inf, np.inf
    spare = len(first) - int((own >= 0).sum())
    soon = circles[1 : max(2, round(SOON * fps))]
    for k in np.flatnonzero(own < 0):
        comes = any(
            np.linalg.norm(each.centre - named[k], axis=1).min(initial=np.inf) <= NEAR * radius for each in soon
        )
        if spare and not comes:
            raise SceneError(
                f"--start: no circle of its own near node {k}; allowed: places within 3 radii of the circles"
            )
        error[k] = NEAR * radius
    length = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return Chain(places, length, np.hypot(error[1:], error[:-1]), 0)
