"""Appearance of the markers, and the circles in all frames of a video."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress
from fitting.films.detection import Circles, MarkerAppearance, detect, learn_appearance, stands_out
from fitting.films.video import Video

#: Maximum number of frames from which the appearance is learned.
MAX_IMAGES = 16


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
        if len(images) > MAX_IMAGES:
            images = images[::2]
            stride = 2 * stride
    if not images:
        raise SceneError(f"{film.path.name}: no frame from number {span[0]} on can be read; allowed: an earlier --from")

    def learn(image: np.ndarray, count: int) -> tuple[int, MarkerAppearance]:
        """The number of circles that look like the `count` strongest spots, 0 if these do not stand out."""
        appearance = learn_appearance(image, count, radius, bright)
        if not stands_out(image, appearance, count):
            return 0, appearance
        return len(detect(image, appearance)), appearance

    learned = [learn(image, nodes) for image in images]
    complete = [appearance for count, appearance in learned if count >= nodes]
    if complete:
        return max(complete, key=lambda appearance: appearance.answer)
    # for the error alone: how many circles the frames show at most
    most = max(count for count, _ in learned)
    for fewer in range(nodes - 1, most, -1):
        for image in images[::5]:
            most = max(most, learn(image, fewer)[0])
    if most == 0:
        raise SceneError(
            f"{film.path.name}: no circles found in {len(images)} frames; needed: a circle on every node "
            "(use --radius and --marker to describe them)"
        )
    raise SceneError(
        f"{film.path.name}: at most {most} circles in a frame, but {nodes} nodes; "
        "needed: as many circles as nodes (use --radius and --marker to describe them)"
    )
