"""The orders of the nodes that a frame allows, side by side, from which the user selects the right one."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from fitting.films.ordering import AmbiguousOrderError
from fitting.films.overlay import write_sheet, write_text
from fitting.films.render import BRIDGED, LINK, TEXT
from fitting.films.video import Video, opencv

#: Maximum number of orders that are drawn.
SHOWN = 6


def write_alternatives(error: AmbiguousOrderError, video: str | Path, path: str | Path) -> Path:
    """The frame once for each order, side by side in rows of three, as a `.png`."""
    image = next(Video(video).frames(error.frame, error.frame + 1))
    tiles = [_tile(image, positions, i) for i, positions in enumerate(error.orders[:SHOWN])]
    return write_sheet(tiles, min(3, len(tiles)), Path(path))


def _tile(image: np.ndarray, positions: np.ndarray, number: int) -> np.ndarray:
    cv2 = opencv()
    scale = 560 / image.shape[1]  # pixels of one picture over those of the frame
    picture = cv2.cvtColor(cv2.resize(image, None, fx=scale, fy=scale), cv2.COLOR_GRAY2BGR)
    points = [(round(scale * x), round(scale * y)) for x, y in positions.tolist()]
    for a, b in pairwise(points):
        cv2.line(picture, a, b, LINK, 2, cv2.LINE_AA)
    labels = [(str(k), (x + 8, y - 8), 0.6, BRIDGED) for k, (x, y) in enumerate(points)]
    for text, position, size, colour in [*labels, (f"order {number + 1}", (12, 28), 0.8, TEXT)]:
        write_text(picture, text, position, size, colour)
    return picture
