"""Warnings of scenes that are valid but can hardly be meant, before anything is solved.

Each rule compares two values of the scene: positions with the seabed, lengths with distances, masses with sizes, floats
with the weight that they carry, currents with those of the sea. A limit is far from any scene that works.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.load.system_warnings import body_warnings, motion_warnings
from dropper_jax.plausibility.line_weights import floating_warnings
from dropper_jax.plausibility.plausible_lines import check_lengths, check_masses, check_spans
from dropper_jax.plausibility.plausible_points import check_fixed_points, check_lift

#: Speed [m/s] that no current at a farm reaches: the fastest tidal streams of the world have 8 to 10 m/s, in narrows.
FASTEST_CURRENT = 5.0


def scene_warnings(scene: Scene, at_rest: bool = False) -> tuple[str, ...]:
    """Warnings that follow from the scene alone; those of its waves are `sea_warnings`.

    Args:
        at_rest: its equilibrium is known, and `pose_remarks` report how far lines are stretched.
    """
    return (
        *scene.notes,
        *motion_warnings(scene),
        *body_warnings(scene),
        *(scene.written.warnings() if scene.written else ()),
        *floating_warnings(scene),
        *plausibility_warnings(scene, at_rest),
    )


def plausibility_warnings(scene: Scene, at_rest: bool = False) -> tuple[str, ...]:
    """A warning for each cause that makes the scene impossible or doubtful; `at_rest` as in `scene_warnings`."""
    return (
        *_check_current(scene),
        *check_fixed_points(scene),
        *check_lengths(scene),
        *check_spans(scene, at_rest),
        *check_masses(scene),
        *check_lift(scene),
    )


def with_cause(error: SceneError, scene: Scene) -> SceneError:
    """The error of a start, after the doubtful value that most likely caused it, if there is one."""
    causes = plausibility_warnings(scene)
    if causes:
        return SceneError(f"{causes[0]}; {error}")
    return error


def fastest_current(scene: Scene) -> float:
    """Speed [m/s] that the current does not exceed at any depth and time; 0 without one."""
    if scene.sea is None or scene.sea.current is None:
        return 0.0
    current = scene.sea.current
    heights = np.zeros(1)  # of the other kinds of profile the surface has the highest speed
    if current.kind == "table":
        heights = np.asarray(current.heights)
    speeds = np.linalg.norm(current.profile(heights, scene.sea.depth), axis=1)
    factor = 1.0
    if current.amplitude is not None:
        factor = np.sum(np.abs(current.amplitude))
    elif current.factor is not None:
        factor = np.max(np.abs(current.factor))
    return float(factor * np.max(speeds))


def _check_current(scene: Scene) -> Iterator[str]:
    speed = fastest_current(scene)
    if speed > FASTEST_CURRENT:
        yield f"sea.current: {speed:.4g} m/s, more than {FASTEST_CURRENT:g} m/s; check its unit, m/s"
