"""Warnings of a scene about ends that start to move at once."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.scene import SceneData

#: Starting speed [m/s] that is taken for rest.
REST = 1e-6
#: Tension of a shock beside the friction of the whole line below which it does not matter what friction keeps of it.
NEGLIGIBLE = 0.01


def motion_warnings(scene: SceneData) -> tuple[str, ...]:
    """One line where an end starts at speed while friction on the bed may keep what that shock leaves, for good."""
    motion = scene.effects.get("end_motion")
    if motion is None or motion["ramp"] is not None or "seabed_friction" not in scene.effects:
        return ()
    speed = _first_speed(motion)
    if speed <= REST or not _matters(scene, speed, {motion["point"], *motion["also"]}):
        return ()
    return (
        f"effects.end_motion: {motion['point']} starts at {speed:.3g} m/s at once; friction on the bed may hold the "
        "tension of that shock for the whole run: give `ramp`",
    )


def _first_speed(motion: dict[str, object]) -> float:
    if motion["time"] is not None:
        time, rows = (np.asarray(motion[key], float) for key in ("time", "displacement"))
        return float(np.linalg.norm(rows[1] - rows[0]) / (time[1] - time[0]))
    phase = 0.0 if motion["phase"] is None else float(motion["phase"])
    return float(np.linalg.norm(motion["amplitude"]) * 2 * np.pi / float(motion["period"]) * abs(np.cos(phase)))


def _matters(scene: SceneData, speed: float, moved: set[str]) -> bool:
    """Whether the tension that a start at `speed` sends, speed times `sqrt(EA m)`, counts beside friction `mu w`."""
    friction = scene.effects["seabed_friction"]
    mu = friction["kinetic"] if friction["static"] is None else friction["static"]
    gravity = scene.effects.get("weight", {}).get("gravity", GRAVITY)
    for line in scene.lines:
        if line.start not in moved and line.end not in moved:
            continue
        if line.EA is None:
            return True  # rigid: the shock has no bound
        weight = float(np.sum(line.mass)) * gravity
        shock = speed * float(np.max(np.sqrt(line.EA * line.mass / line.length)))
        if shock > NEGLIGIBLE * float(np.max(mu)) * weight:
            return True
    return False
