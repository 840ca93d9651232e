"""Rigid bodies of the page: circles whose hull is a cylinder or a sphere, in each body's axes, and where these are."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from dropper_jax.plots.shapes import Bodies
from dropper_jax.scene.body import rotation


def body_data(bodies: Bodies | None, kept: np.ndarray) -> dict[str, Any] | None:
    """Plain values of the bodies at the frames that are kept; None without any.

    `poses` has for each frame and body its reference point [m] and its axes, row by row: 12 numbers, float32.
    """
    if bodies is None or not bodies.shapes:
        return None
    count = len(bodies.names)
    poses = np.empty((len(kept), count, 12), "<f4")
    poses[..., :3] = bodies.position[kept]
    for k, frame in enumerate(kept):
        for i in range(count):
            poses[k, i, 3:] = rotation(bodies.attitude[frame, i]).ravel()
    rings = [np.round(shape.rings(), 5) for shape in bodies.shapes]
    return {
        "names": list(bodies.names),
        "poses": base64.b64encode(np.ascontiguousarray(poses).tobytes()).decode(),
        "shapes": [
            {"body": shape.body, "rings": ring.tolist()} for shape, ring in zip(bodies.shapes, rings, strict=True)
        ],
    }
