"""Warnings about ends that start to move abruptly."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.scene import SceneData

#: Starting speed [m/s] that counts as rest.
REST = 1e-6
#: Tension of a shock relative to the friction of the full line below which the tension retained by friction is
#: negligible.
NEGLIGIBLE = 0.01


def motion_warnings(scene: SceneData) -> tuple[str, ...]:
    """A warning if an end starts with a velocity jump, whose tension seabed friction may retain permanently."""
    motion = scene.effects.get("end_motion")
    if motion is None or motion["ramp"] is not None or "seabed_friction" not in scene.effects:
        return ()
    speed = _first_speed(motion)
    if speed <= REST or not _matters(scene, speed, {motion["point"], *motion["also"]}):
        return ()
    return (
        f"effects.end_motion: {motion['point']} starts abruptly at {speed:.3g} m/s; friction on the seabed may retain "
        "the tension of that shock for the whole run. Use `ramp`",
    )


def _first_speed(motion: dict[str, object]) -> float:
    if motion["time"] is not None:
        time, rows = (np.asarray(motion[key], float) for key in ("time", "displacement"))
        return float(np.linalg.norm(rows[1] - rows[0]) / (time[1] - time[0]))
    phase = 0.0 if motion["phase"] is None else float(motion["phase"])
    return float(np.linalg.norm(motion["amplitude"]) * 2 * np.pi / float(motion["period"]) * abs(np.cos(phase)))


def _matters(scene: SceneData, speed: float, moved: set[str]) -> bool:
    """Whether the tension caused by a start at `speed`, speed times `sqrt(EA m)`, is significant compared with
    `mu w`."""
    friction = scene.effects["seabed_friction"]
    mu = friction["kinetic"] if friction["static"] is None else friction["static"]
    gravity = scene.effects.get("weight", {}).get("gravity", GRAVITY)
    for line in scene.lines:
        if line.start not in moved and line.end not in moved:
            continue
        if line.EA is None:
            return True  # rigid: the shock is unbounded
        weight = float(np.sum(line.mass)) * gravity
        shock = speed * float(np.max(np.sqrt(line.EA * line.mass / line.length)))
        if shock > NEGLIGIBLE * float(np.max(mu)) * weight:
            return True
    return False
