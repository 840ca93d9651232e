"""The list of all hard cases, and the row of each."""

from __future__ import annotations

from typing import Any

from dropper_jax.study.stability import accuracy_cases, damping_cases, energy_cases, gradient_cases
from dropper_jax.study.stability.case import Case
from dropper_jax.study.stability.runner import baselines


def all_cases() -> list[Case]:
    """The catalogue."""
    parts = (energy_cases, damping_cases, accuracy_cases, gradient_cases)
    return [case for part in parts for case in part.CASES]


def evaluate(case: Case, short: bool = False, compare: bool = True) -> dict[str, Any]:
    """The row of a case: {name, claim, measured, limit, unit, ok, status, baseline_thesis}."""
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
