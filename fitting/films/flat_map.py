"""The map from pixels of a video to the plane of motion.

A camera without roll, panned by p and pitched by q, sees the point (x, y) of the plane at the ray R (x, y, 1); rays are
bent to r (1 + k1 |r|^2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fitting.films.calibration import Lens, Plane

#: Focal length of an ordinary camera [image widths].
USUAL_FOCUS = 1.25


@dataclass(frozen=True)
class Flat:
    """From pixels of the video to the plane of motion, in pixels of a camera square to it: right, down.

    Attributes:
        size: (width, height) [pixel].
        lens: calibrated, or None.
        plane: from a board, or None.
        parameters: pan, pitch, k1 and log(focus / usual) (4,) applied after these, or None; covariance: theirs.
    """

    size: tuple[int, int]
    lens: Lens | None = None
    plane: Plane | None = None
    parameters: np.ndarray | None = None
    covariance: np.ndarray | None = None

    @property
    def middle(self) -> np.ndarray:
        """Intersection of the camera's axis with the picture (2,) [pixel]."""
        if self.lens is None:
            return (np.array(self.size) - 1) / 2
        return self.lens.centre

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Flat pixels (..., 2) of pixels of the video (..., 2)."""
        shape = np.shape(points)
        points = np.reshape(points, (-1, 2)).astype(float)
        if self.lens is not None:
            points = self.lens.straighten(points)
        if self.plane is not None:
            there = self.plane.to_metres(np.concatenate([self.middle[None], points]))
            points = (there[1:] - there[0]) * [1.0, -1.0] / self.plane.metres_per_pixel(self.middle) + self.middle
        if self.parameters is not None:
            points = self._tilt_points(points, self.parameters)
        return points.reshape(shape)

    def back(self, flat: np.ndarray) -> np.ndarray:
        """The inverse (Newton iteration with differences; the map is nearly the identity up to a shift)."""
        flat = np.asarray(flat, float)
        guess = np.broadcast_to(self.middle, flat.shape).copy()
        limit = 0.5 * np.array(self.size)
        for _ in range(12):
            slopes = central_differences(self, guess, 0.5)
            move = np.linalg.solve(slopes, (flat - self(guess))[..., None])[..., 0]
            guess = np.clip(guess + np.clip(move, -limit, limit), -limit, 3 * limit)
        return guess

    @property
    def spread(self) -> np.ndarray:
        """Prior spread of the parameters (4,)."""
        plane = self.plane is not None
        lens = self.lens is not None
        # pan and pitch [rad], k1, log(focal length): known from the boards, or not
        return np.where([plane, plane, lens, lens], 0.01, [0.15, 0.15, 0.15, 0.3])

    def _tilt_points(self, points: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Points (k, 2) of a camera with this pan, pitch, bending and focal length, as one square to the plane sees
        them."""
        pan, pitch, bending, focus = parameters
        usual = USUAL_FOCUS * self.size[0] if self.lens is None else self.lens.focus
        size = usual * np.exp(focus)
        ray = bent = (points - self.middle) / size
        for _ in range(6):  # bent = ray (1 + k1 |ray|^2)
            ray = bent / (1 + bending * np.sum(ray**2, axis=-1, keepdims=True))
        turn = rotation(pan, pitch)
        ahead = ray @ turn[:2] + turn[2]  # the inverse rotation of (ray, 1)
        return self.middle + size * ahead[:, :2] / ahead[:, 2:]


def rotation(pan: float, pitch: float) -> np.ndarray:
    """(3, 3) from right, down, away of the plane to those of a camera without roll."""
    cp, ct = np.cos([pan, pitch])
    sp, st = np.sin([pan, pitch])
    around = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    return np.array([[1.0, 0.0, 0.0], [0.0, ct, st], [0.0, -st, ct]]) @ around


def central_differences(f: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: float) -> np.ndarray:
    """Derivatives (..., n) of f by the n entries of the last axis of its argument."""
    return np.stack([f(at + d) - f(at - d) for d in step * np.eye(np.shape(at)[-1])], axis=-1) / (2 * step)
