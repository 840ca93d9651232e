"""Nodes and links on the frames of a tracked video, as a contact sheet or a video."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from dropper_jax.base.files import atomic_write
from fitting.films.render import BRIDGED, LINK, TEXT, in_sixteenths
from fitting.films.track import Tracked
from fitting.films.video import Video, opencv, write_video

SUFFIXES = (".png", ".avi", ".mp4")


def write_overlay(tracked: Tracked, video: str | Path, path: str | Path) -> Path:
    """A contact sheet to a `.png`, the whole motion to an `.mp4` or `.avi`."""
    # columns of a sheet, and the width of one picture [pixel]
    per_row = 4
    picture_width = 420
    path = Path(path)
    film = Video(video)
    if path.suffix.lower() != ".png":
        return write_video(path, _draw_frames(tracked, film, 1.0, None), tracked.fps)
    box = _box(tracked, film.size)
    chosen = np.unique(np.linspace(0, len(tracked.detected) - 1, 12).astype(int))
    scale = picture_width / (box[2] - box[0])
    pictures = [picture[box[1] : box[3], box[0] : box[2]] for picture in _draw_frames(tracked, film, scale, chosen)]
    height = round((box[3] - box[1]) * scale)
    tiles = [opencv().resize(p, (picture_width, height), interpolation=opencv().INTER_CUBIC) for p in pictures]
    return write_sheet(tiles, per_row, path)


def write_sheet(tiles: list[np.ndarray], per_row: int, path: Path) -> Path:
    """Pictures of one size in rows, each with a white margin, as a `.png`."""
    tiles = tiles + [np.full_like(tiles[0], 255)] * (-len(tiles) % per_row)
    framed = [np.pad(tile, ((4, 4), (4, 4), (0, 0)), constant_values=255) for tile in tiles]
    rows = [np.concatenate(framed[i : i + per_row], axis=1) for i in range(0, len(framed), per_row)]
    good, data = opencv().imencode(".png", np.concatenate(rows))
    if not good:
        raise OSError(f"{path.name}: the picture cannot be encoded")
    return atomic_write(path, data.tobytes())


def _box(tracked: Tracked, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Left, top, right, bottom [pixel] around the whole motion, with a margin."""
    positions = tracked.pixels[tracked.detected]
    margin = 4 * tracked.appearance.radius + 0.03 * max(size)
    left, top = np.maximum(positions.min(axis=0) - margin, 0).astype(int)
    right, bottom = np.minimum(positions.max(axis=0) + margin, size).astype(int)
    return int(left), int(top), int(right), int(bottom)


def _draw_frames(tracked: Tracked, film: Video, scale: float, chosen: np.ndarray | None) -> Iterator[np.ndarray]:
    """Colour frames with the chain; lines and text keep their size when the picture is shown `scale` times as large."""
    first = tracked.first_frame
    wanted = None if chosen is None else set(chosen.tolist())
    for i, image in enumerate(film.frames(first, first + len(tracked.detected))):
        if wanted is None or i in wanted:
            yield _draw(image, tracked, i, max(1, round(1.6 / scale)), 0.45 / scale)


def _draw(image: np.ndarray, tracked: Tracked, i: int, thick: int, letters: float) -> np.ndarray:
    cv2 = opencv()
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    radius = tracked.appearance.radius
    positions = in_sixteenths(tracked.pixels[i])
    for a, b in pairwise(positions):
        cv2.line(picture, a, b, LINK, thick, cv2.LINE_AA, 4)
    for k, (x, y) in enumerate(tracked.pixels[i].tolist()):
        detected = tracked.detected[i, k]
        colour = (115, 158, 0) if detected else BRIDGED
        if detected:
            cv2.circle(picture, positions[k], round(16 * 1.3 * radius), colour, thick, cv2.LINE_AA, 4)
        else:
            cross = cv2.MARKER_TILTED_CROSS
            cv2.drawMarker(picture, (round(x), round(y)), colour, cross, round(3 * radius), thick + 1)
        write_text(picture, str(k), (round(x + 1.5 * radius), round(y - 1.2 * radius)), letters, colour)
    left, top, *_ = _box(tracked, image.shape[::-1])
    corner = (left + round(20 * letters), top + round(40 * letters))
    write_text(picture, f"t = {tracked.trace.t[i]:.2f} s", corner, 1.2 * letters, TEXT)
    return picture


def write_text(
    picture: np.ndarray, text: str, position: tuple[int, int], size: float, colour: tuple[int, int, int]
) -> None:
    """Letters with a white rim, from `position` [pixel] to the right, in place."""
    cv2 = opencv()
    # a rim of the same letters around: heavier ones are wider in OpenCV 5
    rim = [(dx, dy, (255, 255, 255)) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    for dx, dy, shade in [*rim, (0, 0, colour)]:
        there = (position[0] + dx, position[1] + dy)
        cv2.putText(picture, text, there, cv2.FONT_HERSHEY_SIMPLEX, size, shade, 1, cv2.LINE_AA)
