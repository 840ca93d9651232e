"""A catalogue of hard cases, each with a measured numerical claim, compared with the thesis' schemes on the same
case."""

from __future__ import annotations

from typing import Any

from dropper_jax.study.stability import (
    breaking_cases,
    contact_cases,
    energy_cases,
    flow_cases,
    line_cases,
    moving_end_cases,
    rod_cases,
    rope_cases,
    sea_cases,
)
from dropper_jax.study.stability.case import Case, Outcome, baselines

PARTS = (
    energy_cases,
    *(contact_cases, rope_cases, moving_end_cases, breaking_cases, sea_cases, flow_cases, line_cases),
    rod_cases,
)


def all_cases() -> list[Case]:
    """The catalogue."""
    return [case for part in PARTS for case in part.CASES]


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


__all__ = ["Case", "Outcome", "all_cases", "evaluate"]
