"""What a damping law may lack: the candidates of its score tests (`law_score_tests`).

A candidate is a force that the scene lacks or does not free, or a coefficient of drag that changes with time or
amplitude. The latter stands for every law outside the list: its derivative in a window is that of the coefficient,
multiplied by the window's mean time or RMS rate, in units of their spread over the windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.residuals import Residuals
from fitting.estimate.solution import Solution
from fitting.laws.laws import DRAG_PATHS, LAW_PARTS
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.parameter import Parameter, given_effect
from fitting.parameters.targets import CAMERA
from fitting.windows.prepared import Prepared

QUADRATIC = "quadratic drag"
#: Names of the forces and the paths that free them, by their kind in `missing_forces`.
FORCES = {
    "linear": ("linear drag", LAW_PARTS["linear"]),
    "quadratic": (QUADRATIC, LAW_PARTS["quadratic"]),
    "viscous": ("viscous friction in the joints", LAW_PARTS["joint viscous"]),
    "dry": ("dry friction in the joints", LAW_PARTS["dry"]),
    "springs": ("springs in the joints", "effects.bending.EI"),
    "added_mass": ("added mass, or another gravity or clock", "clock.rate"),
}
#: What the coefficients of drag are tested to change with.
CHANGES_WITH = ("time", "amplitude")


@dataclass(frozen=True)
class LawCandidate:
    """A force that a scene may lack, or a coefficient that may change.

    Attributes:
        name: in words.
        free: paths that free it; empty if no number of a scene does.
        parameter: its size.
        only_grows: whether it can only grow from zero.
        coefficient: of a change, the number of the coefficient among the parameters of the fit; None for a force.
        changes_with: of a change, one of `CHANGES_WITH`.
    """

    name: str
    free: tuple[str, ...]
    parameter: Parameter
    only_grows: bool = False
    coefficient: int | None = None
    changes_with: str = ""


def law_candidates(prepared: Prepared, problem: Residuals) -> list[LawCandidate]:
    """Forces that are not free, then changes of the free coefficients of drag."""
    free = list(compress(problem.names, ~problem.held_mask))
    candidates = []
    for p in tested_parameters(prepared.simulator.model, problem.parameters):
        name, path = FORCES.get(p.where.field, ("a roll of the camera", CAMERA))
        if any(free_name.startswith(path) for free_name in free):
            continue
        lacks = path.startswith("effects.") and not np.any(given_effect(prepared.scene, path))
        candidates.append(LawCandidate(name, (path,), p, only_grows=lacks))
    for i, p in enumerate(problem.parameters):
        if p.name in DRAG_PATHS and p.name in free:
            short = p.name.rsplit(".", 1)[1]
            for cause in CHANGES_WITH:
                name = f"a {short} that changes with {cause}"
                candidates.append(LawCandidate(name, (), p, coefficient=i, changes_with=cause))
    return candidates


def with_coefficient_changes(solution: Solution, evaluation: Evaluation, changes: Sequence[LawCandidate]) -> Evaluation:
    """The evaluation with a column of derivatives for each change of a coefficient."""
    windows = solution.windows
    m2 = solution.problem.freedoms
    causes = {"time": 0.5 * (windows.begin + windows.ends), "amplitude": window_rates(solution)}
    for candidate in changes:
        cause = causes[candidate.changes_with]
        factor = (cause - cause.mean()) / max(np.std(cause), 1e-300)
        for field in ("jacobian", "start_jacobian", "end_jacobian"):
            slopes = getattr(evaluation, field)
            by_window = factor.reshape(-1, *[1] * (slopes.ndim - 2))
            column = slopes[..., m2 + candidate.coefficient] * by_window
            extended = np.concatenate([slopes, column[..., None]], axis=-1)
            evaluation = evaluation._replace(**{field: extended})
    return evaluation


def window_rates(solution: Solution) -> np.ndarray:
    """RMS rate of the links in every window (K,) [rad/s], by the rates at both its ends."""
    ends = np.stack([solution.evaluation.start, solution.evaluation.end], axis=1)
    links = ends.shape[-1] // 2
    rates = ends[..., links:]
    return np.sqrt(np.mean(rates**2, axis=(1, 2)))
