"""The orders of the nodes that a frame allows, side by side, from which the user selects the right one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fitting.films.ordering import AmbiguousOrderError
from fitting.films.overlay import BRIDGED, TEXT, draw_links, write_sheet, write_text
from fitting.films.video import Video, opencv

#: Maximum number of orders that are drawn.
MAX_SHOWN = 6
#: Width of the picture of one order [pixel].
TILE_WIDTH = 560


def write_alternatives(error: AmbiguousOrderError, video: str | Path, path: str | Path) -> Path:
    """The frame once for each order, side by side in rows of three, as a `.png`."""
    image = next(Video(video).frames(error.frame, error.frame + 1))
    tiles = [_tile(image, positions, i) for i, positions in enumerate(error.orders[:MAX_SHOWN])]
    return write_sheet(tiles, min(3, len(tiles)), Path(path))


def _tile(image: np.ndarray, positions: np.ndarray, number: int) -> np.ndarray:
    """The frame with the nodes at `positions` (n, 2) [pixel of the video], numbered in this order."""
    scale = TILE_WIDTH / image.shape[1]  # pixels of one picture over those of the frame
    picture = draw_links(opencv().resize(image, None, fx=scale, fy=scale), scale * positions, 2)
    for k, position in enumerate(scale * positions):
        write_text(picture, str(k), position + [8, -8], 0.6, BRIDGED)
    write_text(picture, f"order {number + 1}", np.array([12, 28]), 0.8, TEXT)
    return picture
