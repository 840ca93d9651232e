"""What a hard case is, and the list of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dropper_jax.scene import Scene


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


def all_cases() -> list[Case]:
    """The catalogue."""
    from dropper_jax.study.stability import accuracy_cases, damping_cases, energy_cases, gradient_cases

    parts = (energy_cases, damping_cases, accuracy_cases, gradient_cases)
    return [case for part in parts for case in part.CASES]


def evaluate(case: Case, short: bool = False, compare: bool = True) -> dict[str, Any]:
    """The row of a case: {name, claim, measured, limit, unit, ok, status, baseline_thesis}."""
    from dropper_jax.study.stability.runner import baselines

    found = case.measure(short)
    ok = found.status == case.expected and found.measured <= case.limit
    baseline = baselines(*found.compare) if compare and found.compare else None
    return {
        "name": case.name,
        "claim": case.claim,
        "measured": found.measured,
        "limit": case.limit,
        "unit": case.unit,
        "ok": bool(ok),
        "status": found.status,
        "baseline_thesis": baseline,
    }
