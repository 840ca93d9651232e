"""Definition of a hard case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dropper_jax.load.scene import Scene


@dataclass(frozen=True)
class Watched:
    """A scene with a claim on the motion of one point, so that other simulators can be measured as well.

    Attributes:
        scene, dt, duration: what is run, at which step [s] and how long [s].
        point: name of the point.
        measure: the quantity limited by the claim, from times (k,) [s] and positions (k, 3) [m].
        drive: displacement (3,) [m] over time of the prescribed points that `end_motion` moves.
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
