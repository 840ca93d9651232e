"""What a hard case is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dropper_jax.load.scene import Scene


@dataclass(frozen=True)
class Outcome:
    """What was measured, the status it ended with, and (scene, dt, duration) for the baselines, if these apply."""

    measured: float
    status: str
    compare: tuple[Scene, float, float] | None = None


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
