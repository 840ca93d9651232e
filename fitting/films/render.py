"""Videos of simulated runs, as a laboratory camera would record them.

A pinhole camera with a bending lens looks at the plane of motion, perpendicular or slanting. Bars are grey; each node
carries a black sticker with a bright disc. The picture is averaged over the exposure, blurred, and noisy. A post may
stand between the camera and the motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.interpolate import CubicSpline

from dropper_jax.base.errors import SceneError
from fitting.films.calibration import Lens, Plane
from fitting.films.flat_map import central_differences, rotation
from fitting.films.video import opencv
from fitting.traces.synthetic import Motion

#: Grey levels of the plate, of a post before it, of bars, stickers and discs, and of a board's squares.
PLATE = 105.0
POST = 60.0
BAR = 150.0
STICKER = 22.0
DISC = 235.0
BLACK = 25.0
WHITE = 225.0
#: Thickness of a bar and radius of a sticker [radius of a disc].
BAR_WIDTH = 1.6
STICKER_RADIUS = 1.7
#: Inner corners of a chessboard, columns and rows, and the side of its squares [m].
BOARD = (9, 6)
SQUARE = 0.03
#: Minimum number of pictures averaged over an exposure. They are at most 1 pixel apart: a moving disc becomes a streak,
#: not a row of discs.
MIN_PICTURES = 5


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

    @property
    def lens(self) -> Lens:
        """The camera as a perfect calibration would describe it."""
        width, height = self.size
        matrix = np.array([[self.focus, 0, (width - 1) / 2], [0, self.focus, (height - 1) / 2], [0, 0, 1.0]])
        return Lens(matrix, np.array([*self.bending, 0.0, 0.0, 0.0]), 0.0, 0, self.size)

    @property
    def pixels_per_metre(self) -> float:
        """Pixels of a metre in the middle of the plane of motion."""
        return self.focus / self.distance

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) from right, down, away of the plane of motion to right, down, ahead of the camera."""
        return rotation(*self.slant)

    def to_pixels(self, positions: np.ndarray) -> np.ndarray:
        """Pixels (k, 2) of points (k, 2) (x, z) [m] in the plane.

        Raises:
            SceneError: a point that is not in front of the camera.
        """
        flat = (positions - np.asarray(self.centre)) * [1.0, -1.0]
        ahead = flat @ self.rotation[:, :2].T + [0.0, 0.0, self.distance]
        depth = ahead[:, 2:]
        if not (depth > 0).all():
            raise SceneError(
                f"view: a point is {-depth.min():.3g} m behind the camera; needed: all points in front of it "
                "(use a larger distance or less slant)"
            )
        straight = self.focus * ahead[:, :2] / depth + self.lens.centre
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
        streak = view.exposure * np.linalg.norm(at(now, 1), axis=1).max() * view.pixels_per_metre
        count = max(MIN_PICTURES, int(np.ceil(streak)))
        parts = np.linspace(-0.5, 0.5, 2 * count + 1)[1::2] * view.exposure
        shots = [_shot(view, at(now + part), hidden) for part in parts]
        yield _develop(np.mean(shots, axis=0), view, rng)


def chessboards(view: View, count: int) -> Iterator[np.ndarray]:
    """Pictures of a chessboard of `BOARD` inner corners: the first in the plane of motion, the others slanting."""
    rng = np.random.default_rng(0)
    turn = view.rotation
    away = np.array([0.0, 0.0, view.distance])
    for i in range(count):
        if i:
            turn = opencv().Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
            far = view.distance * rng.uniform(0.75, 1.1)
            # alternately to the sides, where a lens bends most; only complete boards are found
            side = 0.22 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]][i % 4])
            away = np.array([*side * view.size / view.focus * far, far])
        yield _develop(_board(view, turn, away), view, rng)


def _shot(view: View, positions: np.ndarray, hidden: list[int]) -> np.ndarray:
    """The picture of an instant: nodes at `positions` (n, 2) [m]."""
    width, height = view.size
    image = np.full((height, width), PLATE, np.float32)
    nodes = view.to_pixels(positions)
    stretch = view.stretch(positions)
    cv2 = opencv()
    thick = max(1, round(BAR_WIDTH * view.radius * view.pixels_per_metre))
    cv2.polylines(image, [in_sixteenths(nodes)], False, BAR, thick, cv2.LINE_AA, 4)
    for k, position in enumerate(nodes):
        _disc(image, position, STICKER_RADIUS * view.radius, stretch[k], STICKER)
        if k not in hidden:
            _disc(image, position, view.radius, stretch[k], DISC)
    if view.post is not None:
        x, wide = view.post
        edges = view.to_pixels(np.array([[x - wide / 2, view.centre[1]], [x + wide / 2, view.centre[1]]]))[:, 0]
        left, right = np.maximum(np.rint(edges).astype(int), 0)
        image[:, left:right] = POST
    return image


def in_sixteenths(points: np.ndarray) -> np.ndarray:
    """Coordinates with 4 binary digits behind the point, as OpenCV draws them."""
    return np.rint(16 * points).astype(np.int32)


def _disc(image: np.ndarray, centre: np.ndarray, radius: float, stretch: np.ndarray, grey: float) -> None:
    """Draw a disc of `radius` [m], an ellipse for a slanting camera, with a rim that is smooth over one pixel."""
    scale = np.sqrt(abs(np.linalg.det(stretch)))
    reach = 1.5 * radius * scale
    low = np.maximum(np.floor(centre - reach - 2), 0).astype(int)
    high = np.minimum(np.ceil(centre + reach + 3), image.shape[::-1]).astype(int)
    if (low >= high).any():
        return
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    flat = (np.stack([x, y], axis=-1) - centre) @ np.linalg.inv(stretch).T
    cover = np.clip(0.5 + scale * (radius - np.linalg.norm(flat, axis=-1)), 0.0, 1.0)
    patch = image[low[1] : high[1], low[0] : high[0]]
    patch += cover * (grey - patch)


def _develop(image: np.ndarray, view: View, rng: np.random.Generator) -> np.ndarray:
    """The picture of bytes that the camera gives: blurred and noisy."""
    if view.blur > 0:
        image = opencv().GaussianBlur(image.astype(np.float32), (0, 0), view.blur)
    noisy = image + view.noise * rng.standard_normal(image.shape, dtype=np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def _board(view: View, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """A board with a white margin, its middle at `shift` from the camera, rotated by `turn` (3, 3), along every ray."""
    fine = 3  # samples per pixel and axis, averaged; the lens is uniform within a pixel
    width, height = view.size
    to_board = Plane(np.linalg.inv(view.lens.matrix @ np.column_stack([turn[:, :2], shift])))
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    straight = view.lens.straighten(pixels.reshape(-1, 2)).reshape(height, width, 2)
    step = (np.arange(fine) + 0.5) / fine - 0.5
    greys = [_squares(to_board.to_metres(straight + shifted) / SQUARE) for shifted in product(step, step)]
    return np.mean(greys, axis=0).astype(np.float32)


def _squares(positions: np.ndarray) -> np.ndarray:
    """Grey of the board at positions (height, width, 2) from its middle [side of a square]."""
    size = np.array(BOARD) + 1
    entry = positions + size / 2
    inside = ((entry >= 0) & (entry < size)).all(axis=-1)
    margin = ((entry > -1) & (entry < size + 1)).all(axis=-1)
    black = inside & (np.floor(entry).sum(axis=-1) % 2 == 0)
    return np.where(black, BLACK, np.where(margin, WHITE, PLATE))
