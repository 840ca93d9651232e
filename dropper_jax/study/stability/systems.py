"""Small systems of lines as plain tables: weights on ropes and threads, on the seabed and in the water."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene

G = GRAVITY
#: Depth of the seabed under weights on threads [m].
BED = 10.0
#: Of a thread: its length and diameter [m], whose product is twice the contact area of its end on the seabed.
THREAD, THICK = 30.0, 0.02
#: Diameter of a thread in the water [m], where others give it buoyancy.
THIN = 1e-4


def weight_on_rope(
    name: str,
    mass: float,
    stiffness: float,
    length: float,
    below: float,
    links: int = 1,
    effects: dict[str, Any] | None = None,
    **more: Any,
) -> Scene:
    """A weight [kg] released `below` [m] its suspension point, on a light rope with a stiffness [N/m] and a length
    [m]."""
    kind = {"name": "rope", "mass": 1e-6, "diameter": 0.01, "EA": stiffness * length}
    return load_scene(
        {
            "name": name,
            "run": {"dt": 0.01, "duration": 1.0},
            "line_type": [kind],
            "point": [
                {"name": "top", "position": [0.0, 0.0, 0.0]},
                {"name": "weight", "kind": "free", "position": [0.0, 0.0, -below], "mass": mass},
            ],
            "line": [{"name": "rope", "from": "top", "to": "weight", "type": "rope", "length": length, "links": links}],
            "effects": {"weight": {"gravity": G}, **(effects or {})},
            "start": {"kind": "points"},
            **more,
        }
    )


def weight_on_thread(
    name: str, body: dict[str, Any], position: list[float], effects: dict[str, Any], **more: Any
) -> Scene:
    """A body at a free point, connected by a slack weightless thread to a position above."""
    return load_scene(
        {
            "name": name,
            "run": {"dt": 0.01, "duration": 1.0},
            "line_type": [{"name": "thread", "mass": 1e-6, "diameter": THIN if "sea" in more else THICK, "EA": 1e3}],
            "point": [
                {"name": "tied", "position": [position[0], 0.0, 0.0]},
                {"name": "weight", "kind": "free", "position": position, **body},
            ],
            "line": [
                {"name": "thread", "from": "tied", "to": "weight", "type": "thread", "length": THREAD, "links": 1}
            ],
            "effects": {"weight": {"gravity": G}, **effects},
            "start": {"kind": "points"},
            **more,
        }
    )


def largest(x: np.ndarray) -> float:
    return float(np.max(np.abs(x)))
