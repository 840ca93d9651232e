"""What a hard case is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dropper_jax.load.scene import Scene


@dataclass(frozen=True)
class Watched:
    """A scene whose claim is about where one point goes, so that other simulators can be measured by it too.

    Attributes:
        scene, dt, duration: what is run, at which step [s] and how long [s].
        point: name of the point.
        measure: what the claim limits, from times (k,) [s] and places (k, 3) [m].
        drive: displacement (3,) [m] over time of the held points that `end_motion` moves.
    """

    scene: Scene
    dt: float
    duration: float
    point: str
    measure: Callable[[np.ndarray, np.ndarray], float]
    drive: Callable[[float], np.ndarray] | None = None


@dataclass(frozen=True)
class Outcome:
    """What was measured, the status it ended with, and what others run: (scene, dt, duration) for the thesis' schemes,
    what is watched for MoorDyn, where these apply."""

    measured: float
    status: str
    compare: tuple[Scene, float, float] | None = None
    watched: Watched | None = None


@dataclass(frozen=True)
class Case:
    """A hard case: a claim in words, its limit, and how it is measured (`measure(short)`: shortened for the tests).

    It holds where the measured number is at most the limit and the status is `expected`.
    """

    name: str
    claim: str
    limit: float
    unit: str
    measure: Callable[[bool], Outcome]
    expected: str = "ok"
