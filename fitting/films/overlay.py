"""Nodes and links on the frames of a tracked video, as a contact sheet or a video."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dropper_jax.base.files import atomic_write
from fitting.films.render import in_sixteenths
from fitting.films.tracked import Tracked
from fitting.films.video import Video, opencv, spread_out, write_video

#: Blue, green, red: links, detected and bridged nodes, text.
LINK = (178, 114, 0)
DETECTED = (115, 158, 0)
BRIDGED = (0, 94, 213)
TEXT = (40, 40, 40)
#: Maximum number of pictures of a sheet, those of a row, and the width of one [pixel].
MAX_PICTURES = 12
PER_ROW = 4
PICTURE_WIDTH = 420


def write_overlay(tracked: Tracked, video: str | Path, path: str | Path) -> Path:
    """Write a contact sheet as a `.png`, or the whole motion as an `.mp4` or `.avi`."""
    path = Path(path)
    cv2 = opencv()
    film = Video(video, tracked.fps)
    frames = np.arange(len(tracked.detected))
    if path.suffix.lower() != ".png":
        return write_video(path, _draw_frames(tracked, film, 1.0, frames), tracked.fps)
    left, top, right, bottom = _box(tracked, film.size)
    scale = PICTURE_WIDTH / (right - left)
    size = (PICTURE_WIDTH, round((bottom - top) * scale))
    tiles = []
    for picture in _draw_frames(tracked, film, scale, spread_out(len(frames), MAX_PICTURES)):
        tiles.append(cv2.resize(picture[top:bottom, left:right], size, interpolation=cv2.INTER_CUBIC))
    return write_sheet(tiles, PER_ROW, path)


def write_sheet(tiles: list[np.ndarray], per_row: int, path: Path) -> Path:
    """Pictures of one size in rows, each with a white margin, as a `.png`."""
    framed = np.pad(tiles, ((0, -len(tiles) % per_row), (4, 4), (4, 4), (0, 0)), constant_values=255)
    rows = np.split(framed, len(framed) // per_row)
    good, data = opencv().imencode(".png", np.concatenate([np.concatenate(row, axis=1) for row in rows]))
    if not good:
        raise OSError(f"{path.name}: the picture cannot be encoded")
    return atomic_write(path, data.tobytes())


def _box(tracked: Tracked, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Left, top, right, bottom [pixel] around the whole motion, with a margin."""
    positions = tracked.pixels[tracked.detected]
    margin = 4 * tracked.appearance.radius + 0.03 * max(size)
    low = np.maximum(positions.min(axis=0) - margin, 0).astype(int)
    high = np.minimum(positions.max(axis=0) + margin, size).astype(int)
    return (*low.tolist(), *high.tolist())


def _draw_frames(tracked: Tracked, film: Video, scale: float, chosen: np.ndarray) -> Iterator[np.ndarray]:
    """Colour frames with the chain; lines and text keep their size when the picture is shown `scale` times as large."""
    first = tracked.first_frame
    for i, image in enumerate(film.frames(first, first + len(tracked.detected))):
        if i in chosen:
            yield _draw(image, tracked, i, max(1, round(1.6 / scale)), 0.45 / scale)


def draw_links(image: np.ndarray, positions: np.ndarray, thick: int) -> np.ndarray:
    """A grey frame in colour, with lines between the nodes at `positions` (n, 2) [pixel]."""
    cv2 = opencv()
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return cv2.polylines(picture, [in_sixteenths(positions)], False, LINK, thick, cv2.LINE_AA, 4)


def _draw(image: np.ndarray, tracked: Tracked, i: int, thick: int, letters: float) -> np.ndarray:
    """Frame i in colour: the chain, a circle around each detected node and a cross on each bridged one, the time."""
    cv2 = opencv()
    radius = tracked.appearance.radius
    picture = draw_links(image, tracked.pixels[i], thick)
    for k, position in enumerate(tracked.pixels[i]):
        colour = BRIDGED
        if tracked.detected[i, k]:
            colour = DETECTED
            centre = in_sixteenths(position).tolist()
            cv2.circle(picture, centre, round(16 * 1.3 * radius), colour, thick, cv2.LINE_AA, 4)
        else:
            cross = cv2.MARKER_TILTED_CROSS
            cv2.drawMarker(picture, np.rint(position).astype(int).tolist(), colour, cross, round(3 * radius), thick + 1)
        write_text(picture, str(k), position + [1.5 * radius, -1.2 * radius], letters, colour)
    corner = _box(tracked, image.shape[::-1])[:2] + np.rint([20 * letters, 40 * letters])
    write_text(picture, f"t = {tracked.trace.t[i]:.2f} s", corner, 1.2 * letters, TEXT)
    return picture


def write_text(picture: np.ndarray, text: str, position: np.ndarray, size: float, colour: tuple[int, int, int]) -> None:
    """Letters with a white rim, from `position` (2,) [pixel] to the right, in place."""
    cv2 = opencv()
    # a rim of the same letters around: heavier ones are wider in OpenCV 5
    rim = [(dx, dy, (255, 255, 255)) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    for dx, dy, shade in [*rim, (0, 0, colour)]:
        there = np.rint(position + [dx, dy]).astype(int).tolist()
        cv2.putText(picture, text, there, cv2.FONT_HERSHEY_SIMPLEX, size, shade, 1, cv2.LINE_AA)
