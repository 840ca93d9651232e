"""`dropper stability`: hard cases, each with a measured claim, compared with the thesis' schemes on the same case."""

from __future__ import annotations

from dataclasses import dataclass

from dropper_jax.base.read import Table
from dropper_jax.stability.case import Case, Outcome, all_cases
from dropper_jax.stability.march import baselines
from dropper_jax.stability.measures import measure


@dataclass(frozen=True)
class CaseResult:
    """A case as it was measured; its fields are the keys of the JSON object (see `Case`).

    Attributes:
        ok: whether the case holds.
        baseline_thesis: the thesis' schemes on the case, by label; None if they were not run.
    """

    name: str
    claim: str
    measured: float
    limit: float
    unit: str
    ok: bool
    status: str
    baseline_thesis: Table | None


def evaluate(case: Case, short: bool = False, compare: bool = True) -> CaseResult:
    """Run and measure a case.

    Args:
        short: whether to run the shortened case.
        compare: whether to run the thesis' schemes as well.
    """
    outcome = measure(case, short)
    as_expected = outcome.status == case.expected
    thesis = baselines(case) if compare else None
    return CaseResult(
        name=case.name,
        claim=case.claim,
        measured=outcome.measured,
        limit=case.limit,
        unit=case.unit,
        ok=bool(as_expected and outcome.measured <= case.limit),
        status=outcome.status,
        baseline_thesis=thesis,
    )


__all__ = ["Case", "CaseResult", "Outcome", "all_cases", "evaluate"]
