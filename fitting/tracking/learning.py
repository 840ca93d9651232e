"""Appearance of the markers, and the circles in all frames of a video."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress
from fitting.tracking.detection import NONE, Circles, MarkerAppearance, detect, learn_appearance, stands_out
from fitting.tracking.video import Video

#: Maximum number of frames, spread over the film, from which the appearance is learned.
LOOKED_AT = 16


def scan(
    film: Video, span: tuple[int, int | None], nodes: int, radius: float | None, bright: bool | None, say: Progress
) -> tuple[MarkerAppearance, list[Circles]]:
    """The markers' appearance, and the circles of all frames of the span [pixel of the video].

    Raises:
        SceneError: no frame with as many circles as nodes.
    """
    appearance = _learn_appearance(film, span, nodes, radius, bright)
    total = max(1, (span[1] or film.announced or 0) - span[0])
    found = []
    for i, image in enumerate(film.frames(*span)):
        found.append(detect(image, appearance))
        say(0.7 * min(1.0, (i + 1) / total), f"circles of frame {span[0] + i + 1}")
    return appearance, found


def _learn_appearance(
    film: Video, span: tuple[int, int | None], nodes: int, radius: float | None, bright: bool | None
) -> MarkerAppearance:
    """The appearance in the frame that shows the markers best, of a few spread over the film."""
    images, stride = [], 1
    for i, image in enumerate(film.frames(*span)):
        if i % stride == 0:
            images.append(image)
        if len(images) > LOOKED_AT:
            images, stride = images[::2], 2 * stride
    best, most = None, 0
    for image in images:
        appearance = learn_appearance(image, nodes, radius, bright)
        count = len(detect(image, appearance)) if stands_out(image, appearance, nodes) else 0
        if count >= nodes and (best is None or appearance.answer > best.answer):
            best = appearance
        most = max(most, count)
    if best is not None:
        return best
    for fewer in range(nodes - 1, most, -1):
        for image in images[::5]:
            appearance = learn_appearance(image, fewer, radius, bright)
            most = max(most, len(detect(image, appearance)) if stands_out(image, appearance, fewer) else 0)
    if most == 0:
        raise SceneError(
            f"{film.path.name}: no circles found in {len(images)} frames; needed: a circle on every node "
            "(use --radius and --marker to describe them)"
        )
    raise SceneError(
        f"{film.path.name}: at most {most} circles in a frame, but {nodes} nodes; "
        "needed: as many circles as nodes (use --radius and --marker to describe them)"
    )


def map_circles(circles: list[Circles], to: object) -> list[Circles]:
    """The circles with their centres mapped by `to`: points (m, 2) to points (m, 2)."""
    size = np.cumsum([0, *(len(each) for each in circles)])
    centre = to(np.concatenate([each.centre for each in circles])) if size[-1] else np.zeros((0, 2))
    parts = zip(circles, size[:-1], size[1:], strict=True)
    return [replace(each, centre=centre[a:b]) if len(each) else NONE for each, a, b in parts]
