"""Videos of simulated runs, as a laboratory camera would record them, and pictures of tracked ones to check by eye.

A pinhole camera with a bending lens looks at the plane of motion, perpendicular or slanting. Bars are grey; each node
carries a black sticker with a bright disc. The picture is averaged over the exposure, blurred, and noisy. A fixed post
and a moving plate are between the camera and the motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from dropper_jax.base.files import atomic_write
from fitting.traces.synthetic import Motion
from fitting.tracking.calibration import Lens
from fitting.tracking.flattening import central_differences, rotation
from fitting.tracking.ordering import AmbiguousOrderError
from fitting.tracking.track import Tracked
from fitting.tracking.video import Video, opencv, write_video

#: Grey levels of the plate and of a post before it.
PLATE, POST = 105.0, 60.0


@dataclass(frozen=True)
class Cover:
    """An upright plate whose middle moves from `start` at time `begin` [s] to `stop` at `end`.

    Before and after it is out of view. Positions are (x, z) [m] of the run, times count from its first frame; `size` is
    (width, height) [m].
    """

    begin: float
    end: float
    start: tuple[float, float]
    stop: tuple[float, float]
    size: tuple[float, float]

    def corners(self, t: float) -> np.ndarray | None:
        """Its corners (4, 2) [m] in order, or None if it is out of view."""
        share = (t - self.begin) / (self.end - self.begin)
        if not 0 <= share <= 1:
            return None
        middle = np.asarray(self.start) + share * (np.asarray(self.stop) - np.asarray(self.start))
        return middle + 0.5 * np.asarray(self.size) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]


@dataclass(frozen=True)
class View:
    """Camera setup of a run.

    Attributes:
        size: (width, height) [pixel].
        focus [pixel], bending (k1, k2), distance of the camera [m]: they determine the size of a pixel.
        centre: (x, z) [m] of the run that the camera looks at.
        radius: of the discs [m].
        exposure: of a frame [s]; its middle is the frame's time.
        blur [pixel], noise [grey]: standard deviations.
        hidden: (node, first frame, last frame): a disc is covered in these frames.
        post: (x, width) [m] of an upright post before the plate, or None.
        slant: (pan, pitch) [rad] of the camera, which moves around `centre` at `distance`: positive from the right and
            from above. It has no roll: its rows are level.
        cover: a plate that moves before the motion, or None.
    """

    size: tuple[int, int] = (640, 480)
    focus: float = 800.0
    bending: tuple[float, float] = (0.0, 0.0)
    distance: float = 1.0
    centre: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.008
    exposure: float = 1 / 640
    blur: float = 0.7
    noise: float = 4.0
    hidden: tuple[tuple[int, int, int], ...] = ()
    post: tuple[float, float] | None = None
    slant: tuple[float, float] = (0.0, 0.0)
    cover: Cover | None = None

    @property
    def lens(self) -> Lens:
        """The camera as a perfect calibration would describe it."""
        width, height = self.size
        matrix = np.array([[self.focus, 0, (width - 1) / 2], [0, self.focus, (height - 1) / 2], [0, 0, 1.0]])
        return Lens(matrix, np.array([*self.bending, 0.0, 0.0, 0.0]), 0.0, 0, self.size)

    @property
    def pixels_per_metre(self) -> float:
        return self.focus / self.distance

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) from right, down, away of the plane of motion to right, down, ahead of the camera."""
        return rotation(*self.slant)

    def to_pixels(self, positions: np.ndarray) -> np.ndarray:
        """Pixels (k, 2) of points (k, 2) (x, z) [m] in the plane."""
        flat = (positions - np.asarray(self.centre)) * [1.0, -1.0]
        ahead = flat @ self.rotation[:, :2].T + [0.0, 0.0, self.distance]
        straight = self.focus * ahead[:, :2] / ahead[:, 2:] + self.lens.matrix[:2, 2]
        return self.lens.bend(straight)

    def stretch(self, positions: np.ndarray) -> np.ndarray:
        """Derivatives (k, 2, 2) [pixel/m] of the pixels by the positions (k, 2) [m]."""
        return central_differences(self.to_pixels, positions, 1e-4)


def film(motion: Motion, view: View, fps: float, seed: int = 0) -> Iterator[np.ndarray]:
    """Grey frames (height, width) of a run, one per 1/fps of its time; the same seed gives the same noise."""
    rng = np.random.default_rng(seed)
    at = CubicSpline(motion.t, motion.nodes[..., [0, 2]])
    for i in range(int((motion.t[-1] - motion.t[0]) * fps + 1e-6) + 1):
        hidden = [node for node, first, last in view.hidden if first <= i <= last]
        now = motion.t[0] + i / fps
        way = view.exposure * np.linalg.norm(at(now, 1), axis=1).max() * view.pixels_per_metre
        # pictures averaged over an exposure, at most 1 pixel apart: a moving disc becomes a streak, not a row of discs
        count = max(5, int(np.ceil(way / 1.0)))
        parts = np.linspace(-0.5, 0.5, 2 * count + 1)[1::2] * view.exposure
        shots = [_shot(view, at(now + part), hidden, i / fps + part) for part in parts]
        yield _develop(np.mean(shots, axis=0), view, rng)


def chessboards(
    view: View, board: tuple[int, int] = (9, 6), square: float = 0.03, count: int = 10, seed: int = 0
) -> Iterator[np.ndarray]:
    """Pictures of a chessboard of `board` inner corners: the first in the plane of motion, the others slanting."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        turn = opencv().Rodrigues(view.rotation)[0].ravel() if i == 0 else rng.uniform(-0.5, 0.5, 3)
        far = view.distance * (1.0 if i == 0 else rng.uniform(0.75, 1.1))
        # alternately to the sides, where a lens bends most; only complete boards are found
        side = 0.22 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]][i % 4]) if i else np.zeros(2)
        shift = side * np.array(view.size) / view.focus * far
        yield _develop(_board(view, board, square, turn, np.array([*shift, far])), view, rng)


def _shot(view: View, positions: np.ndarray, hidden: list[int], t: float) -> np.ndarray:
    """The picture of an instant: nodes at `positions` (n, 2) [m], `t` [s] after the first frame."""
    width, height = view.size
    image = np.full((height, width), PLATE, np.float32)
    nodes, stretch = view.to_pixels(positions), view.stretch(positions)
    cv2 = opencv()
    thick = max(1, round(1.6 * view.radius * view.pixels_per_metre))
    for a, b in zip(nodes[:-1], nodes[1:], strict=True):
        cv2.line(image, *_sixteenths([a, b]), 150.0, thick, cv2.LINE_AA, 4)
    for k, position in enumerate(nodes):
        _disc(image, position, 1.7 * view.radius, stretch[k], 22.0)
        if k not in hidden:
            _disc(image, position, view.radius, stretch[k], 235.0)
    if view.post is not None:
        x, wide = view.post
        edges = view.to_pixels(np.array([[x - wide / 2, view.centre[1]], [x + wide / 2, view.centre[1]]]))[:, 0]
        image[:, max(0, round(edges[0])) : max(0, round(edges[1]))] = POST
    if view.cover is not None and (corners := view.cover.corners(t)) is not None:
        cv2.fillPoly(image, [np.array(_sixteenths(view.to_pixels(corners)))], POST, cv2.LINE_AA, 4)
    return image


def _sixteenths(points: np.ndarray | list[np.ndarray]) -> list[tuple[int, int]]:
    """Coordinates with 4 binary digits behind the point, as OpenCV draws them."""
    return [(round(16 * float(x)), round(16 * float(y))) for x, y in points]


def _disc(image: np.ndarray, centre: np.ndarray, radius: float, stretch: np.ndarray, grey: float) -> None:
    """Draw a disc of `radius` [m], an ellipse for a slanting camera, with a rim that is smooth over one pixel."""
    scale = np.sqrt(abs(np.linalg.det(stretch)))
    reach = 1.5 * radius * scale
    low = np.maximum(np.floor(centre - reach - 2), 0).astype(int)
    high = np.minimum(np.ceil(centre + reach + 3), image.shape[::-1]).astype(int)
    if (low >= high).any():
        return
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    flat = np.stack([x - centre[0], y - centre[1]], axis=-1) @ np.linalg.inv(stretch).T
    cover = np.clip(0.5 + scale * (radius - np.hypot(flat[..., 0], flat[..., 1])), 0.0, 1.0)
    patch = image[low[1] : high[1], low[0] : high[0]]
    patch += cover * (grey - patch)


def _develop(image: np.ndarray, view: View, rng: np.random.Generator) -> np.ndarray:
    if view.blur > 0:
        image = opencv().GaussianBlur(image.astype(np.float32), (0, 0), view.blur)
    noisy = image + view.noise * rng.standard_normal(image.shape, dtype=np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def _board(view: View, board: tuple[int, int], square: float, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """A board with a white margin, its middle at `shift` from the camera, computed along every pixel's ray."""
    fine = 3  # samples per pixel and axis, averaged; the lens is uniform within a pixel
    width, height = view.size
    lens = view.lens
    rotation = opencv().Rodrigues(turn)[0]
    to_board = np.linalg.inv(lens.matrix @ np.stack([rotation[:, 0], rotation[:, 1], shift], axis=1))
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    straight = lens.straighten(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(height, width, 2)
    total = np.zeros((height, width))
    step = (np.arange(fine) + 0.5) / fine - 0.5
    for du, dv in product(step, step):
        total += _squares(to_board, straight + (du, dv), board, square)
    return (total / fine**2).astype(np.float32)


def _squares(to_board: np.ndarray, straight: np.ndarray, board: tuple[int, int], square: float) -> np.ndarray:
    """Grey of the board at straight pixels (height, width, 2)."""
    x, y, w = (straight[..., 0] * row[0] + straight[..., 1] * row[1] + row[2] for row in to_board)
    column, row = (a / w / square + (b + 1) / 2 for a, b in zip((x, y), board, strict=True))
    wide, high = board[0] + 1, board[1] + 1
    inside = (column >= 0) & (column < wide) & (row >= 0) & (row < high)
    margin = (column > -1) & (column < wide + 1) & (row > -1) & (row < high + 1)
    black = inside & ((np.floor(column) + np.floor(row)) % 2 == 0)
    return np.where(black, 25.0, np.where(margin, 225.0, PLATE))


# --- nodes and links on the frames of a tracked video, as a contact sheet or a video ---
#
# Detected nodes are circles with their number, bridged ones crosses.

#: Blue, green, red: links, bridged nodes, text.
LINK, BRIDGED, TEXT = (178, 114, 0), (0, 94, 213), (40, 40, 40)
SUFFIXES = (".png", ".avi", ".mp4")


def write_overlay(tracked: Tracked, video: str | Path, path: str | Path) -> Path:
    """A contact sheet to a `.png`, the whole motion to an `.mp4` or `.avi`."""
    # columns of a sheet, and the width of one picture [pixel]
    per_row, picture_width = 4, 420
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
    return _write_sheet(tiles, per_row, path)


def _write_sheet(tiles: list[np.ndarray], per_row: int, path: Path) -> Path:
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
    positions = _sixteenths(tracked.pixels[i])
    for a, b in zip(positions[:-1], positions[1:], strict=True):
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


# A picture of the node orders that a film allows, from which the user selects the right one


#: Maximum number of orders that are drawn.
SHOWN = 6


def write_alternatives(error: AmbiguousOrderError, video: str | Path, path: str | Path) -> Path:
    """The frame once for each order, side by side in rows of three, as a `.png`."""
    image = next(Video(video).frames(error.frame, error.frame + 1))
    tiles = [_tile(image, positions, i) for i, positions in enumerate(error.orders[:SHOWN])]
    return _write_sheet(tiles, min(3, len(tiles)), Path(path))


def _tile(image: np.ndarray, positions: np.ndarray, number: int) -> np.ndarray:
    cv2 = opencv()
    scale = 560 / image.shape[1]  # pixels of one picture over those of the frame
    picture = cv2.cvtColor(cv2.resize(image, None, fx=scale, fy=scale), cv2.COLOR_GRAY2BGR)
    points = [(round(scale * x), round(scale * y)) for x, y in positions.tolist()]
    for a, b in zip(points[:-1], points[1:], strict=True):
        cv2.line(picture, a, b, LINK, 2, cv2.LINE_AA)
    labels = [(str(k), (x + 8, y - 8), 0.6, BRIDGED) for k, (x, y) in enumerate(points)]
    for text, position, size, colour in [*labels, (f"order {number + 1}", (12, 28), 0.8, TEXT)]:
        write_text(picture, text, position, size, colour)
    return picture
