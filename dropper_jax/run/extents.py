"""Extents of what a run saves: least, mean, largest and last values."""

from __future__ import annotations

import numpy as np

from dropper_jax.run.rows import BLOCK, let_go

#: Of a body: its reference point [m] and its attitude [rad].
MOTIONS = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")


def extent(values: np.ndarray) -> dict[str, float]:
    """min, mean and max of values (k, n), and the mean of the last row."""
    found = {"min": np.min(values), "mean": np.mean(values), "max": np.max(values), "final": np.mean(values[-1])}
    return {key: float(value) for key, value in found.items()}


def body_extents(position: np.ndarray, attitude: np.ndarray) -> dict[str, dict[str, float]]:
    """The same of each of a body's `MOTIONS`, by places (k, 3) [m] and roll, pitch and yaw (k, 3) [rad]."""
    values = np.concatenate([position, attitude], axis=1)
    return {key: extent(values[:, i : i + 1]) for i, key in enumerate(MOTIONS)}


def largest_size(vectors: np.ndarray) -> float:
    """Largest length of vectors (k, n, 3), which may be mapped from a file; a run that failed may hold anything."""
    with np.errstate(over="ignore", invalid="ignore"):
        found = []
        for first in range(0, len(vectors), BLOCK):
            found.append(np.max(np.linalg.norm(vectors[first : first + BLOCK], axis=-1)))
            let_go([vectors])
        return float(np.max(found))
