"""Periods that a scene states, and the steps and intervals that follow from them."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from dropper_jax.integrators import INTEGRATORS
from dropper_jax.residual import Implicit
from dropper_jax.scene import SceneData

AnyScene = TypeVar("AnyScene", bound=SceneData)

#: Saved states per period of the waves, or of the shortest link's swing without waves.
ROWS_PER_PERIOD = 20
#: Bounds of the number of saved states of a run.
MIN_ROWS = 100
MAX_ROWS = 10_000


def periods(scene: SceneData) -> dict[str, float]:
    """Periods [s] that a step has to resolve, without solving the equilibrium.

    Returns:
        swing: of the shortest link under its own weight, `2 pi sqrt(l/g)`, the fastest motion across a line; infinite
            without gravity.
        axial: of the stiffest link, `2 pi/omega`, `omega^2 = 4 EA/(L m)`; absent if no link stretches.
        waves: the period of waves, or of the highest component; absent without waves.
    """
    line = scene.line
    found = {"swing": np.inf}
    if scene.gravity > 0.0:
        found["swing"] = 2.0 * np.pi * np.sqrt(np.min(line.length) / scene.gravity)
    if line.EA is not None:
        found["axial"] = np.pi * np.sqrt(np.min(line.length * line.mass / line.EA))
    if scene.sea is None or scene.sea.waves is None:
        return found
    waves = scene.sea.waves
    if waves.tp is not None:
        found["waves"] = float(waves.tp)
    elif waves.period is not None:
        period, height = np.broadcast_arrays(waves.period, waves.size)
        found["waves"] = period.flat[np.argmax(height)]
    return found


def suggest_step(scene: SceneData) -> float:
    """A time step [s], two digits: 100 per swing of the shortest link and per wave.

    Explicit schemes also need 6 steps per axial period. A first guess: the companion run measures the error.
    """
    # steps per period of the shortest link's swing and of the waves in a suggested step: the midpoint rule then has the
    # period to 0.03 %. The packaged scenes take 45 to 200. The check of a run asks whipping droppers for 600 to 1400
    found = periods(scene)
    steps = {"swing": 100, "waves": 100}
    if not issubclass(INTEGRATORS[scene.run.integrator], Implicit):
        steps["axial"] = 6  # explicit schemes are unstable below pi steps per axial period of the stiffest link
    step = min(scene.run.duration, *(found[name] / steps[name] for name in found.keys() & steps))
    return _round_down(step, 2)


def suggest_interval(scene: SceneData) -> float:
    """A time between saved states [s], one digit; extremes are kept over all steps anyway."""
    found = periods(scene)
    duration = scene.run.duration
    interval = found.get("waves", found["swing"]) / ROWS_PER_PERIOD
    interval = np.clip(interval, duration / MAX_ROWS, duration / MIN_ROWS)
    return _round_down(interval, 1)


def _round_down(value: float, digits: int) -> float:
    """A positive number with this many digits, not above itself but for rounding."""
    unit = 10.0 ** (np.floor(np.log10(value)) + 1.0 - digits)
    return float(f"{np.floor(value / unit * (1.0 + 1e-9)) * unit:.{digits}g}")


def with_suggestions(scene: AnyScene) -> AnyScene:
    """The scene with a step and an interval between saved states where its `[run]` has none."""
    run = scene.run
    if run.accuracy is None:
        return scene
    if run.save_interval is None:
        run = replace(run, suggested_interval=suggest_interval(scene))
    if run.source_dt is None:
        run = replace(run, suggested_step=suggest_step(scene))
    return replace(scene, run=run)
