"""The lens from pictures of a chessboard, and metres from a board or a known distance.

A camera maps a point (X, Y, Z) to x = X/Z, y = Y/Z, bends it to x (1 + k1 r^2 + k2 r^4) plus tangential terms
(Brown 1966; Zhang 2000, as in OpenCV), and scales it by the matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]. "Straight"
pixels below are those of the same camera without bending.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.films.video import opencv, read_image

#: Minimum number of pictures with the board: fewer do not determine both focal length and distortion.
MIN_PICTURES = 4
#: Largest reprojection error [pixel] of a calibration that may be used; the thesis reached 0.15.
LARGEST_ERROR = 1.0
#: Focal length [image widths] above which the calibration has diverged.
LONGEST_FOCUS = 20.0


@dataclass(frozen=True)
class Lens:
    """A calibrated camera.

    Attributes:
        matrix: (3, 3) [pixel]; distortion: (5,) k1, k2, p1, p2, k3.
        error: RMS reprojection error [pixel]; pictures: number of pictures that show the board.
        size: (width, height) [pixel] of the pictures.
        others: the lens from all pictures but one, for each: its uncertainty (jackknife).
    """

    matrix: np.ndarray
    distortion: np.ndarray
    error: float
    pictures: int
    size: tuple[int, int]
    others: tuple[Lens, ...] = ()

    @property
    def focus(self) -> np.ndarray:
        """Focal lengths (2,) [pixel], across and down."""
        return np.diag(self.matrix)[:2]

    @property
    def centre(self) -> np.ndarray:
        """Intersection of the camera's axis with the picture (2,) [pixel]."""
        return self.matrix[:2, 2]

    def straighten(self, points: np.ndarray) -> np.ndarray:
        """Straight pixels (k, 2) of image pixels (k, 2)."""
        if not len(points):
            return np.zeros((0, 2))
        detected = np.asarray(points, float).reshape(-1, 1, 2)
        return opencv().undistortPoints(detected, self.matrix, self.distortion, P=self.matrix).reshape(-1, 2)

    def bend(self, points: np.ndarray) -> np.ndarray:
        """The inverse of `straighten`."""
        if not len(points):
            return np.zeros((0, 2))
        cv2 = opencv()
        rays = cv2.convertPointsToHomogeneous((np.asarray(points, float) - self.centre) / self.focus)
        none = np.zeros(3)
        return cv2.projectPoints(rays, none, none, self.matrix, self.distortion)[0].reshape(-1, 2)


@dataclass(frozen=True)
class Plane:
    """The plane of motion: metres (right, up) of straight pixels, by a homography (3, 3).

    Its third row is positive at pixels of the plane. Beyond the plane's horizon it is negative: a ray there meets the
    plane behind the camera.
    """

    homography: np.ndarray

    def to_metres(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) [m] of straight pixels (..., 2); NaN beyond the horizon."""
        mapped = points @ self.homography[:, :2].T + self.homography[:, 2]
        scale = mapped[..., 2:]
        return mapped[..., :2] / np.where(scale > 0, scale, np.nan)

    def metres_per_pixel(self, middle: np.ndarray) -> float:
        """Scale [m] at `middle` (2,): the side of a square as large as the pixel there."""
        half = 0.5 * np.eye(2)
        right, down = self.to_metres(middle + half) - self.to_metres(middle - half)
        return float(np.sqrt(abs(right[0] * down[1] - right[1] * down[0])))


def corners(image: np.ndarray, board: tuple[int, int]) -> np.ndarray | None:
    """Inner corners of the chessboard (columns x rows, 2) [pixel], or None if it is not found."""
    cv2 = opencv()
    found, where = cv2.findChessboardCornersSB(image, board, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if found:
        return where.reshape(-1, 2).astype(np.float32)
    return None


def board_points(board: tuple[int, int], square: float) -> np.ndarray:
    """The same corners on the board, (columns x rows, 3) [m]."""
    column, row = np.meshgrid(np.arange(board[0]), np.arange(board[1]))
    points = np.stack([column.ravel(), row.ravel(), np.zeros(column.size)], axis=1)
    return points.astype(np.float32) * np.float32(square)


def calibrate(pictures: Sequence[str | Path], board: tuple[int, int] = (9, 6)) -> Lens:
    """The lens from pictures of a chessboard at different positions and slants.

    Args:
        board: inner corners, columns and rows; their distance does not matter here.

    Raises:
        SceneError: too few pictures with a board, sizes that differ, an error above one pixel, no convergence.
    """
    images = list(map(read_image, pictures))
    sizes = {image.shape for image in images}
    if len(sizes) > 1:
        raise SceneError(f"calibration: pictures of different sizes, {sorted(sizes)}; allowed: one size, the video's")
    found = [there for image in images if (there := corners(image, board)) is not None]
    if len(found) < MIN_PICTURES:
        raise SceneError(
            f"calibration: a board of {board[0]} x {board[1]} inner corners found in {len(found)} of {len(images)} "
            f"pictures, fewer than {MIN_PICTURES}. Use more pictures, or --board with the number of corners"
        )
    size = images[0].shape[::-1]
    lens = _lens(found, board, size)
    if lens is None:
        raise SceneError("calibration: did not converge. Use pictures at several slants and positions")
    if lens.error > LARGEST_ERROR:
        raise SceneError(
            f"calibration: reprojection error {lens.error:.3g} pixel; allowed: at most {LARGEST_ERROR:g} "
            "(use a flat board, sharp pictures, several slants)"
        )
    others = [_lens(found[:i] + found[i + 1 :], board, size) for i in range(len(found))]
    return replace(lens, others=tuple(filter(None, others)))


def _lens(found: list[np.ndarray], board: tuple[int, int], size: tuple[int, int]) -> Lens | None:
    """The lens from boards with corners `found`, or None if the calibration diverges."""
    cv2 = opencv()
    points = [board_points(board, 1.0)] * len(found)
    flags = cv2.CALIB_FIX_K3  # a third radial term is not determined by ordinary lenses
    try:
        error, matrix, bending, *_ = cv2.calibrateCamera(points, found, size, None, None, flags=flags)
    except cv2.error:
        return None
    lens = Lens(matrix, np.ravel(bending)[:5], float(error), len(found), size)
    sensible = ((lens.focus > 0) & (lens.focus < LONGEST_FOCUS * size[0])).all()
    if sensible and np.isfinite(error) and np.isfinite(bending).all():
        return lens
    return None


def plane_from_board(
    picture: str | Path, size: tuple[int, int], lens: Lens | None, board: tuple[int, int], square: float
) -> Plane:
    """The plane of motion from one picture of the board lying in it; the camera's rows are level.

    Args:
        size: (width, height) [pixel] of the video, and of the pictures that show the lens.
        square: side of the board's squares [m].

    Raises:
        SceneError: no board in the picture, or a picture of another size.
    """
    image = read_image(picture)
    if image.shape[::-1] != size:
        raise SceneError(f"{Path(picture).name}: {image.shape[::-1]} pixels; allowed: {size}, those of the video")
    found = corners(image, board)
    if found is None:
        raise SceneError(
            f"{Path(picture).name}: no board of {board[0]} x {board[1]} inner corners found; "
            "use a sharp picture of the whole board"
        )
    straight = found.astype(float)
    middle = (np.array(size) - 1) / 2
    if lens is not None:
        straight = lens.straighten(found)
        middle = lens.centre
    homography, _ = opencv().findHomography(straight, board_points(board, square)[:, :2].astype(float))
    # OpenCV's sign is that of the picture's first pixel, which may lie beyond the horizon
    homography *= np.sign(homography[2] @ [*straight[0], 1.0])
    return Plane(_level_homography(homography, middle))


def _level_homography(homography: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """The homography rotated (and mirrored) so that at `middle`, on the camera's axis, image up is +y and right is +x.

    If a camera without roll looks slantwise at a vertical plane, the plane's horizontal lines converge in the picture.
    Its vertical lines converge as well, except for the one through the camera's axis, which is a column of pixels.
    (Rows elsewhere are off by slant times angle from the axis: 8 mrad for a slant of 7 degrees.)
    """
    plane = Plane(homography)
    right, down = (plane.to_metres(middle + 0.5 * d) - plane.to_metres(middle - 0.5 * d) for d in np.eye(2))
    c, s = -down / np.hypot(*down)
    turn = np.array([[s, -c, 0.0], [c, s, 0.0], [0.0, 0.0, 1.0]])
    if (turn[:2, :2] @ right)[0] < 0:
        turn = np.diag([-1.0, 1.0, 1.0]) @ turn
    return turn @ homography
