"""Model selection of damping laws: every subset of a full set of coefficients, compared on the same windows.

Every law is a subset of one full set, with the other coefficients fixed at zero. All laws are therefore fitted by the
same simulator on the same windows, in units of the noise that the fullest law leaves. A law starts from the best of the
laws that it contains, so it never fits worse (`compared_laws`). Laws that give the same motion are merged (one link:
linear drag and a viscous joint). Laws are compared by cross-validation in blocks (`cross_validation`) and by tests of
the coefficients in which they differ (`decision`). Samples that the caller holds out are used by neither. The BIC is
reported alongside (`law_bic`). Laws that separate windows leave undecided are compared with joined windows
(`joined_laws`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.read import ScenePath
from fitting.estimate.factors import solve_spd
from fitting.estimate.solution import Solution
from fitting.laws.compared_laws import ComparedLaws, fit_fullest, fit_laws, prepare_laws, restart_from_larger
from fitting.laws.cross_validation import (
    Fold,
    Scores,
    blocks,
    last_third,
    other_runs,
    score,
    with_released_fitted,
)
from fitting.laws.decision import decide, decide_joined, deviation
from fitting.laws.equivalent_laws import equivalent_laws
from fitting.laws.joined_laws import join_laws
from fitting.laws.law_bic import with_bic
from fitting.laws.laws import LAWS, Law, contains, has_dry_friction
from fitting.parameters.parameter import Parameter
from fitting.windows.prepared import Prepared

if TYPE_CHECKING:
    from fitting.calibration.result import FitResult


def compare(result: FitResult, laws: Sequence[str] = tuple(LAWS), progress: Progress = silent) -> list[Law]:
    """Which damping laws the traces of a fit leave possible; see `compare_laws`.

    Raises:
        SceneError: a law of unknown name, or a fit of a number that ties several values of the scene.
    """
    refuse_tied("compare_models", result.parameters)
    return compare_laws(result.prepared.with_noise_of(result.solution.problem), laws, progress)


def refuse_tied(option: str, parameters: Sequence[Parameter]) -> None:
    """Reject numbers of `[parameters]`, which move the model along a line, for what changes the model's effects."""
    tied = next((p.name for p in parameters if ScenePath(p.name).section == "parameters"), None)
    if tied is not None:
        raise SceneError(f"{option}: not with {tied!r} free. Omit it, or free paths of the scene such as b_l")


def compare_laws(prepared: Prepared, laws: Sequence[str] = tuple(LAWS), progress: Progress = silent) -> list[Law]:
    """Fit laws to the same windows, and report which of them the traces leave possible.

    Other free parameters of the fit (inertias, camera) are free in every law. Friction in joints is one number for all,
    or one for each if the scene or the fit specifies it so.

    Raises:
        SceneError: no law, or one of unknown name.
    """
    if not laws:
        raise SceneError("laws: none given; allowed: at least one")
    for law in laws:
        if law not in LAWS:
            raise SceneError(f"laws: {law!r} is unknown; {nearest(law, LAWS)}")
    names = sorted(laws, key=list(LAWS).index)
    compared, fullest_fits = fit_fullest(prepare_laws(prepared, names, progress))
    fullest = fullest_fits[names[-1]]
    memory = fullest.problem.memory
    equivalents = equivalent_laws(names, prepared, fullest)
    solutions, costs = restart_from_larger(compared, fit_laws(compared, fullest_fits, equivalents), fullest)
    windows = compared.prepared.windows
    folds = with_released_fitted(blocks(windows.run), windows.released)
    scores = [score(solution, folds) for solution in solutions.values()]
    rows = _law_rows(compared, solutions, costs, scores, equivalents)
    rows = decide(rows, [replace(scored, log_score=scored.log_score / memory) for scored in scores])
    possible = {row.name: solutions[row.name] for row in rows if row.possible}
    if len(possible) == 1:
        return rows
    dry_friction = any(map(has_dry_friction, possible))
    joined = join_laws(compared, possible, dry_friction)
    joined_costs = {law: solution.cost / memory for law, solution in joined.items()}
    undetected = {law: compared.undetected(solution, dry_friction) for law, solution in joined.items()}
    return decide_joined(rows, joined_costs, undetected)


def _law_rows(
    laws: ComparedLaws,
    solutions: Mapping[str, Solution],
    costs: Mapping[str, float],
    scores: Sequence[Scores],
    equivalents: Mapping[str, str],
) -> list[Law]:
    """The laws' rows before any decision.

    Args:
        solutions, costs: of `restart_from_larger`; scores: of the solutions.
        equivalents: of `equivalent_laws`.
    """
    rows: list[Law] = []
    windows = laws.prepared.windows
    last_third_folds = with_released_fitted(last_third(windows.begin, windows.run), windows.released)
    other_run_folds = with_released_fitted(other_runs(windows.run), windows.released)
    errors = errors_to_best(scores)
    for (law, solution), scored, error in zip(solutions.items(), scores, errors, strict=True):
        family = laws.family(law)
        used = family.free_mask(law)
        owned = np.array([part is not None for part in family.owner])
        # a law contains itself with further parts at zero, so its cost is at most theirs for any error of its scheme's
        # step
        min_cost = min([costs[law], *(row.cost for row in rows if contains(law, row.name))])
        row = Law(
            name=law,
            coefficients=int((used & owned).sum()),
            rms=solution.rms,
            held_out=scored.rms,
            held_out_error=error,
            status=solution.status,
            values=dict(compress(solution.by_name.items(), used)),
            free=int(used.sum()),
            cost=min_cost,
            unreached=remaining_decrease(solution) / solution.problem.memory,
            extrapolated=_predicted_rms(solution, last_third_folds),
            other_run=_predicted_rms(solution, other_run_folds),
            equals=tuple(other for other, same in equivalents.items() if same == law),
            unseen=laws.undetected(solution, has_dry_friction(law)),
        )
        rows.append(row)
    return with_bic(rows, [solution.evaluation.residual for solution in solutions.values()], windows)


def _predicted_rms(solution: Solution, folds: list[Fold]) -> float:
    """RMS angle error [rad] of the windows that folds score; NaN without folds."""
    if not folds:
        return np.nan
    return score(solution, folds).rms


def errors_to_best(scores: Sequence[Scores]) -> np.ndarray:
    """Standard errors of the differences between RMS errors and the smallest one [rad], window by window."""
    mean = np.array([s.square / np.maximum(s.count, 1) for s in scores])
    rms = [s.rms for s in scores]
    best = int(np.argmin(rms))
    known = scores[best].count > 0
    error = deviation((mean - mean[best])[:, known]) / np.sqrt(max(known.sum(), 1))
    return error / max(2 * rms[best], 1e-300)


def remaining_decrease(solution: Solution) -> float:
    """Decrease of the cost by a Gauss-Newton step of the movable parameters: g' S^-1 g / 2."""
    g = solution.gradient
    low, high = solution.problem.bounds(solution.values)
    free = ~solution.problem.held_mask
    free &= ~((solution.values <= low) & (g > 0)) & ~((solution.values >= high) & (g < 0))
    if free.any():
        return 0.5 * g[free] @ solve_spd(solution.information[np.ix_(free, free)], g[free])
    return 0.0
