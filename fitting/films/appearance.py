"""Appearance of the markers, and the circles in all frames of a video."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import Progress, SceneError
from fitting.films.detection import Circles, MarkerAppearance, detect, learn_appearance, stands_out
from fitting.films.video import Video


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
    images = []
    stride = 1
    for i, image in enumerate(film.frames(*span)):
        if i % stride == 0:
            images.append(image)
        if len(images) > 16:  # spread over the film
            images = images[::2]
            stride = 2 * stride
    best = None
    most = 0
    for image in images:
        appearance = learn_appearance(image, nodes, radius, bright)
        if stands_out(image, appearance, nodes):
            count = len(detect(image, appearance))
        else:
            count = 0
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


def map_circles(circles: list[Circles], to: Callable[[np.ndarray], np.ndarray]) -> list[Circles]:
    """The circles with their centres mapped by `to`: points (m, 2) to points (m, 2)."""
    ends = np.cumsum([len(each) for each in circles])
    centres = np.split(to(np.concatenate([each.centre for each in circles])), ends[:-1])
    return [replace(each, centre=centre) for each, centre in zip(circles, centres, strict=True)]
