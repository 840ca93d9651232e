"""`dropper stability`: hard cases, each with a measured claim, compared with the thesis' schemes on the same case."""

from __future__ import annotations

from typing import Any

from dropper_jax.stability.case import Case, Outcome, all_cases
from dropper_jax.stability.march import baselines
from dropper_jax.stability.measures import MEASURES


def evaluate(case: Case, short: bool = False, compare: bool = True) -> dict[str, Any]:
    """The row of a case: {name, claim, measured, limit, unit, ok, status, baseline_thesis}."""
    found = MEASURES[case.measure](case, short)
    holds = found.status == case.expected and found.measured <= case.limit
    baseline_thesis = None
    if compare:
        baseline_thesis = baselines(case)
    return {
        "name": case.name,
        "claim": case.claim,
        "measured": found.measured,
        "limit": case.limit,
        "unit": case.unit,
        "ok": bool(holds),
        "status": found.status,
        "baseline_thesis": baseline_thesis,
    }


__all__ = ["Case", "Outcome", "all_cases", "evaluate"]
