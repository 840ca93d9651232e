"""What the markers look like and which chain they form, from the first frames of a video."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.tracking.calibration import Lens
from fitting.tracking.detection import NONE, Look, detect, learn_look
from fitting.tracking.ordering import Chain, follow_unnamed, order
from fitting.tracking.video import Video

#: Frames in which the markers must show for the first time, and frames read at most to learn the chain.
SEARCHED, LEARNED = 100, 1200
#: Motion [radius] that tells the links apart, and frames followed once it is seen.
MOTION, AFTER_MOTION = 4.0, 45


def learn(
    film: Video,
    span: tuple[int, int | None],
    nodes: int,
    lens: Lens | None,
    radius: float | None,
    bright: bool | None,
    first: str,
    start: Sequence[tuple[float, float]] | None,
) -> tuple[Look, Chain, int]:
    """What markers look like, the chain in the first frame that shows it, and that frame's number after span[0].

    Args:
        span: first and last frame; the others are those of `track`.
    """
    look, frames, begin, most, moved = None, [], None, 0, None
    for i, image in enumerate(film.frames(*span)):
        if begin is None:
            look = learn_look(image, nodes, radius, bright)
        circles = detect(image, look) if look.answer > 0 else NONE
        frames.append(circles.centre if lens is None else lens.straighten(circles.centre))
        most = max(most, len(circles))
        if begin is None and len(circles) >= nodes:
            begin = i
        if begin is None and i + 1 >= SEARCHED:
            break
        if begin is not None and moved is None and _motion(frames[begin], frames[-1]) > MOTION * look.radius:
            moved = i
        if i + 1 >= LEARNED or (moved is not None and i >= moved + AFTER_MOTION):
            break
    if begin is None:
        raise SceneError(
            f"{film.path.name}: at most {most} circles in a frame, but {nodes} nodes; "
            "allowed: as many circles as nodes (--radius and --marker say what they look like)"
        )
    if start is not None:
        return look, _chain_from(start, frames[begin], lens, nodes, look), begin
    return look, order(follow_unnamed(frames, begin), nodes, look.radius, first), begin


def _motion(before: np.ndarray, now: np.ndarray) -> float:
    """How far the circles moved at least: median distance to the nearest one before, of the half that moved most."""
    if not len(now):
        return 0.0
    nearest = np.linalg.norm(now[:, None] - before[None], axis=-1).min(axis=1)
    return float(np.median(np.sort(nearest)[len(nearest) // 2 :]))


def _chain_from(
    start: Sequence[tuple[float, float]], circles: np.ndarray, lens: Lens | None, nodes: int, look: Look
) -> Chain:
    named = np.asarray(start, float)
    if named.shape != (nodes, 2):
        raise SceneError(f"--start: {len(named)} places; allowed: {nodes}, one x,y per node")
    named = named if lens is None else lens.straighten(named)
    apart = np.linalg.norm(named[:, None] - circles[None], axis=-1)
    which = apart.argmin(axis=1)
    far = int(np.argmax(apart.min(axis=1)))
    if apart[far].min() > 3 * look.radius or len(set(which)) < nodes:
        raise SceneError(
            f"--start: no circle of its own near node {far}; allowed: places within 3 radii of the circles"
        )
    places = circles[which]
    length = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return Chain(places, length, np.zeros_like(length))
