"""A picture of the node orders that a film allows, from which the user selects the right one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.files import atomic_write
from fitting.tracking.ordering import AmbiguousOrderError
from fitting.tracking.overlay import write_text
from fitting.tracking.video import Video, opencv

#: Colours (blue, green, red) of links and numbers; maximum number of alternatives shown; width of one picture [pixel].
LINK, NUMBER, SHOWN, WIDTH = (178, 114, 0), (0, 94, 213), 6, 560


def write_alternatives(error: AmbiguousOrderError, video: str | Path, path: str | Path) -> Path:
    """The frame once for each order, side by side in rows of three, as a `.png`."""
    cv2 = opencv()
    image = next(Video(video).frames(error.frame, error.frame + 1))
    tiles = [_tile(image, positions, i) for i, positions in enumerate(error.orders[:SHOWN])]
    columns = min(3, len(tiles))
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[i : i + columns], axis=1) for i in range(0, len(tiles), columns)]
    good, data = cv2.imencode(".png", np.concatenate(rows))
    if not good:
        raise OSError(f"{Path(path).name}: the picture cannot be encoded")
    return atomic_write(Path(path), data.tobytes())


def _tile(image: np.ndarray, positions: np.ndarray, number: int) -> np.ndarray:
    cv2 = opencv()
    scale = WIDTH / image.shape[1]
    picture = cv2.cvtColor(cv2.resize(image, None, fx=scale, fy=scale), cv2.COLOR_GRAY2BGR)
    points = [(round(scale * x), round(scale * y)) for x, y in positions.tolist()]
    for a, b in zip(points[:-1], points[1:], strict=True):
        cv2.line(picture, a, b, LINK, 2, cv2.LINE_AA)
    labels = [(str(k), (x + 8, y - 8), 0.6, NUMBER) for k, (x, y) in enumerate(points)]
    for text, position, size, colour in [*labels, (f"order {number + 1}", (12, 28), 0.8, (40, 40, 40))]:
        write_text(picture, text, position, size, colour)
    return np.pad(picture, ((4, 4), (4, 4), (0, 0)), constant_values=255)
