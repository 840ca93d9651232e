"""Warnings about lines and bodies of a scene: an end that starts with a shock, attachments away from their body."""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter

import numpy as np

from dropper_jax.base.read import Values
from dropper_jax.scene import SceneData

#: Starting speed [m/s] that counts as rest.
RESTING_SPEED = 1e-6


def motion_warnings(scene: SceneData) -> Iterator[str]:
    """A warning if an end starts with a velocity jump, whose tension seabed friction may retain permanently."""
    motion = scene.effects.get("end_motion")
    if motion is None or motion["ramp"] is not None or "seabed_friction" not in scene.effects:
        return
    speed = _first_speed(motion)
    if speed > RESTING_SPEED and _matters(scene, speed, {motion["point"], *motion["also"]}):
        yield (
            f"effects.end_motion: {motion['point']} starts abruptly at {speed:.3g} m/s; friction on the seabed may "
            "retain the tension of that shock for the whole run. Use `ramp`"
        )


def _first_speed(motion: Values) -> float:
    if motion["time"] is not None:
        return np.linalg.norm(np.diff(motion["displacement"], axis=0)[0]) / np.diff(motion["time"])[0]
    turn = 2 * np.pi / motion["period"] * abs(np.cos(motion["phase"] or 0.0))
    return np.linalg.norm(motion["amplitude"]) * turn


#: Tension of a shock relative to the friction of the full line below which the tension retained by friction is
#: negligible; that of a rigid line is unbounded.
NEGLIGIBLE_SHOCK = 0.01


def _matters(scene: SceneData, speed: float, moved: set[str]) -> bool:
    """Whether the tension caused by a start at `speed`, speed times `sqrt(EA m)`, is significant compared with
    `mu w`."""
    friction = scene.effects["seabed_friction"]
    mu = friction["static"]
    if mu is None:
        mu = friction["kinetic"]
    for line in scene.lines:
        if not {line.start, line.end} & moved:
            continue
        negligible = NEGLIGIBLE_SHOCK * np.max(mu) * scene.gravity * np.sum(line.mass)
        if line.EA is None or speed * np.max(np.sqrt(line.EA * line.mass / line.length)) > negligible:
            return True
    return False


def body_warnings(scene: SceneData) -> Iterator[str]:
    """A warning for each body with attachments away from its shapes: they may be arms of a platform, or a mistake."""
    for body in scene.bodies:
        away = body.outside()
        if away:
            name, distance = max(away.items(), key=itemgetter(1))
            yield (
                f"body {body.name!r}: {len(away)} attachments are outside its cylinders and spheres, "
                f"{name!r} by {distance:.3g} m; they move with it as if on massless arms"
            )
