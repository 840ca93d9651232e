"""Model selection of damping laws: every subset of a full set of coefficients, compared on the same windows.

Every law is a subset of one full set, with the other coefficients fixed at zero. All laws are therefore fitted by the
same simulator on the same windows, in units of the noise that the fullest law leaves. A law starts from the best of the
laws that it contains, so it never fits worse. Laws that give the same motion are merged (one link: linear drag and a
viscous joint). Laws are compared by cross-validation in blocks (`cross_validation`) and by tests of the coefficients in
which they differ (`decision`). Samples that the caller holds out are used by neither.

BIC = `N_eff log(chi2/N) + k log N_eff` (Schwarz 1978) is reported alongside. N_eff = N (1 - rho)/(1 + rho) accounts for
correlated samples; rho is that of the law that fits best, because its residuals are nearest to the noise.

Laws that separate windows leave undecided are compared with joined windows. Separate windows lose the information on
how much energy a motion loses from one to the next; joined ones (`shooting`) keep it. The weight of the gaps and the
time step are those of the law with the most parts. At this one weight all costs, gaps included, are likelihoods of the
same model, so laws can be compared by them as with separate windows. A law starts from the best of those that it
contains, so it never costs more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, compress
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, nearest, silent
from dropper_jax.base.read import ScenePath
from fitting.calibration.cross_validation import (
    Fold,
    Scores,
    blocks,
    last_third,
    other_runs,
    score,
    with_released_fitted,
)
from fitting.calibration.decision import REFUTED_PROBABILITY, chance, decide, decide_joined, deviation
from fitting.calibration.law_fits import LAW_ITERATIONS, Family, better_fit, family_of, fit_law, least_loss
from fitting.calibration.laws import LAW_PARTS, LAWS, Law, contains, part_of
from fitting.calibration.method import with_residual_noise
from fitting.calibration.prepared import Prepared
from fitting.calibration.undetected_parts import dissipated_per_unit, undetected_parts
from fitting.estimate.factors import solve_spd
from fitting.estimate.least_squares import Objective, descend, fit_windows
from fitting.estimate.noise import lag_one
from fitting.estimate.residuals import Solution
from fitting.estimate.shooting import GAP_WEIGHTS, fit_shooting
from fitting.estimate.step_size import refine, with_finer_step
from fitting.estimate.windows import Windows
from fitting.parameters.parameter import Parameter

if TYPE_CHECKING:
    from fitting.calibration.result import FitResult

#: Evaluations of joined windows between a law and one that contains it.
JOINED_ITERATIONS = 15
#: Maximum evaluations of a law started from the end of a larger one, which suffices in the same local minimum.
RESTART_ITERATIONS = 8
#: Maximum number of larger laws to start from, as each may have found a better local minimum.
MOST_RESTARTS = 3
#: Cost, in multiples of the fullest law's, above which a law does not justify finer steps.
FINE_STEP_COST_RATIO = 10.0
#: Loss of log likelihood, by the fullest law's covariance, above which no other local minimum can rescue a law.
HOPELESS_LOSS = 1000.0


def compare(result: FitResult, laws: Sequence[str] = tuple(LAWS), progress: Progress = silent) -> list[Law]:
    """Which damping laws the traces of a fit leave possible; see `compare_laws`.

    Raises:
        SceneError: a law of unknown name, or a fit of a number that ties several values of the scene.
    """
    refuse_tied("compare_models", result.parameters)
    return compare_laws(result.prepared.noisy(result.solution.problem.noise), laws, progress)


def refuse_tied(option: str, parameters: Sequence[Parameter]) -> None:
    """Reject numbers of `[parameters]`, which move the model along a line, for what changes the model's effects."""
    tied = next((p.name for p in parameters if ScenePath(p.name).section == "parameters"), None)
    if tied is not None:
        raise SceneError(f"{option}: not with {tied!r} free. Omit it, or free paths of the scene such as b_l")


def compare_laws(prepared: Prepared, laws: Sequence[str] = tuple(LAWS), progress: Progress = silent) -> list[Law]:
    """Fit laws to the same windows by `windows`, and report which of them the traces leave possible.

    Other free parameters of the fit (inertias, camera) are free in every law. Friction in joints is one number for all,
    or one for each if the scene or the fit specifies it so.

    Raises:
        SceneError: no law, or one of unknown name.
    """
    if not laws:
        raise SceneError("laws: none given. Use two or more of them")
    for law in laws:
        if law not in LAWS:
            raise SceneError(f"laws: {law!r} is unknown; {nearest(law, LAWS)}")
    ordered = sorted(laws, key=lambda law: (len(LAWS[law]), list(LAWS).index(law)))
    fits = LawFits(prepared, ordered, progress)
    fullest = fits.fit_fullest()
    memory = fullest.problem.memory
    same = _same_parts(ordered, prepared, fullest)
    fits.fit_others(fullest, same)
    folds = with_released_fitted(blocks(fits.prepared.windows.run), fits.prepared.windows.released)
    scores = [score(solution, folds) for solution in fits.solutions.values()]
    acting_parts = {}
    for law in ordered:
        acting_parts[law] = {same.get(part, part) for part in LAWS[law]}
    rows = []
    for row in fits.rows(scores):
        alike = tuple(law for law in ordered if law != row.name and acting_parts[law] == set(LAWS[row.name]))
        unseen = fits.undetected(fits.solutions[row.name], "dry" in LAWS[row.name])
        rows.append(replace(row, equals=alike, unseen=unseen))
    rows = decide(rows, [replace(scored, log_score=scored.log_score / memory) for scored in scores])
    possible = {row.name: fits.solutions[row.name] for row in rows if row.possible}
    if len(possible) == 1:
        return rows
    dry = any("dry" in LAWS[law] for law in possible)
    joined = fits.join(possible, fits.families[dry])
    costs = {law: solution.cost / memory for law, solution in joined.items()}
    return decide_joined(rows, costs, {law: fits.undetected(solution, dry) for law, solution in joined.items()})


class LawFits:
    """Fits of laws to the same windows.

    Args:
        laws: from the simplest one on.

    Attributes:
        families: with (True) and without dry friction.
        per_unit: energy that a unit of each coefficient of a family dissipates in the measured motion.
        fullest_fits: fits of the fullest law of each family, by name.
        solutions: the laws' fits, by name.
        costs: minus their log likelihoods, in units of independent samples.
    """

    def __init__(self, prepared: Prepared, laws: Sequence[str], progress: Progress) -> None:
        self.prepared = prepared
        self.laws = laws
        self.progress = progress
        others = [name for name in prepared.names if part_of(name) is None]
        self.families: dict[bool, Family] = {}
        self.per_unit: dict[bool, np.ndarray] = {}
        for dry in sorted({"dry" in LAWS[law] for law in laws}):
            family = family_of(prepared, others, dry)
            self.families[dry] = family
            self.per_unit[dry] = dissipated_per_unit(prepared, family.simulator, family.owner)
        self.fullest_fits: dict[str, Solution] = {}
        self.solutions: dict[str, Solution] = {}
        self.costs: dict[str, float] = {}

    def family(self, law: str) -> Family:
        """The family of a law."""
        return self.families["dry" in LAWS[law]]

    def fit(self, law: str, inner: list[Solution]) -> Solution:
        """A law fitted from the best of those that it contains."""
        return fit_law(self.prepared, self.family(law), law, inner)

    def undetected(self, solution: Solution, dry: bool) -> tuple[str, ...]:
        """Parts of a law, fitted by a family, that the traces could not have shown."""
        return undetected_parts(solution, self.families[dry].owner, self.per_unit[dry])

    def fit_fullest(self) -> Solution:
        """The fullest law, whose noise all laws have, and the step size that each family requires."""
        name = self.laws[-1]
        self.progress(0.95, f"law {name}: noise")
        fullest = refine(with_residual_noise(self.prepared, self.fit(name, [])))
        self.prepared = self.prepared.noisy(fullest.problem.noise)
        self.fullest_fits = {name: fullest}
        for dry, family in self.families.items():
            self.families[dry] = replace(family, enough=FINE_STEP_COST_RATIO * fullest.cost)
            law = next(law for law in reversed(self.laws) if ("dry" in LAWS[law]) == dry)
            if law != name:  # otherwise the step error would distinguish the schemes, and so the laws
                self.fullest_fits[law] = refine(self.fit(law, [fullest]))
            substeps = self.fullest_fits[law].windows.substeps
            self.families[dry] = replace(self.families[dry], substeps=substeps)
        return fullest

    def fit_others(self, fullest: Solution, same: Mapping[str, str]) -> None:
        """All laws, each from those that it contains; those that a larger one would refute also from that one.

        The cost of windows is non-smooth, most of all for joints that stick and for chaotic chains: the larger law may
        have found the better local minimum. Its scheme may also have a different step error, which may fit the noise
        better by chance. The cost of a law is therefore the minimum of those by its own scheme and by that of the
        larger law.

        Args:
            fullest: the fullest law.
            same: parts that act like others, whose laws are left out.
        """
        for i, law in enumerate(self.laws):
            if set(same) & set(LAWS[law]):
                continue
            self.progress(0.95, f"law {i + 1} of {len(self.laws)}: {law}")
            inner = [solution for name, solution in self.solutions.items() if contains(law, name)]
            if law in self.fullest_fits:
                inner.append(self.fullest_fits[law])
            self.solutions[law] = self.fit(law, inner)
        widest = self.family(self.laws[-1])
        near = [law for law in self.solutions if least_loss(fullest, widest, law) < HOPELESS_LOSS]
        self.costs = {law: solution.cost / solution.problem.memory for law, solution in self.solutions.items()}
        for law in reversed(near):
            larger_laws = [name for name in self.solutions if contains(name, law)]
            for _ in range(MOST_RESTARTS):
                probability = {}
                for name in larger_laws:
                    parts = len(LAWS[name]) - len(LAWS[law])
                    probability[name] = chance(self.costs[law] - self.costs[name], parts)
                if min(probability.values(), default=1.0) >= REFUTED_PROBABILITY:
                    break
                larger = min(probability, key=probability.__getitem__)
                larger_laws.remove(larger)
                self.fit_from_larger(law, larger)

    def fit_from_larger(self, law: str, larger: str) -> None:
        """A law fitted again from the end of a larger one, without the other parts of that one."""
        own = self.solutions[law]
        start = self.solutions[larger]
        used = self.family(larger).free_mask(law)
        problem = replace(start.problem, frozen=~used)
        inside = fit_windows(problem, np.where(used, start.values, 0.0), start.starts, iterations=RESTART_ITERATIONS)
        if not inside.cost < own.cost:
            return
        values = np.array([inside.by_name[p.name] for p in own.problem.parameters])  # the larger one may have more
        again = fit_windows(own.problem, values, inside.starts, iterations=LAW_ITERATIONS)
        self.solutions[law] = better_fit([own, again])
        for fit in (inside, self.solutions[law]):
            self.costs[law] = min(self.costs[law], fit.cost / fit.problem.memory)

    def join(self, laws: Mapping[str, Solution], family: Family) -> dict[str, Solution]:
        """Joined solutions of laws by name; empty if windows do not follow each other or a law does not converge.

        Args:
            laws: solutions of separate windows.
            family: contains the parts of all these laws.
        """
        if not self.prepared.windows.follows.any():
            return {}
        order = sorted(laws, key=lambda law: len(LAWS[law]))
        most = order[-1]
        self.progress(0.95, f"law {most}, joined")
        begin = fit_law(self.prepared, family, most, [laws[most]])
        widest = fit_shooting(begin, finer=with_finer_step)
        if widest.status != "ok" or not widest.gap_weight:
            return {}
        family = replace(family, substeps=widest.windows.substeps)
        schedule = [weight for weight in GAP_WEIGHTS if weight >= widest.gap_weight]
        joined: dict[str, Solution] = {}
        for law in order:
            self.progress(0.95, f"law {law}, joined")
            inner = [solution for name, solution in joined.items() if contains(law, name)]
            tries = []
            if law == most:
                tries.append(widest)
            if inner:  # the additional parts start at zero
                best = min(inner, key=lambda solution: solution.cost)
                problem = replace(best.problem, frozen=~family.free_mask(law))
                objective = Objective(problem, widest.gap_weight, intermediate=True)
                tries.append(descend(objective, replace(best, problem=problem), JOINED_ITERATIONS))
            if not any(solution.status == "ok" for solution in tries):
                begin = fit_law(self.prepared, family, law, [laws[law]])
                tries.append(fit_shooting(begin, choose=False, schedule=schedule))
            joined[law] = better_fit(tries)
            if joined[law].status != "ok":
                return {}
        return joined

    def rows(self, scores: Sequence[Scores]) -> list[Law]:
        """The laws' rows before any decision."""
        rows: list[Law] = []
        windows = self.prepared.windows
        ahead = with_released_fitted(last_third(windows.begin, windows.run), windows.released)
        elsewhere = with_released_fitted(other_runs(windows.run), windows.released)
        errors = errors_to_best(scores)
        for (law, solution), scored, error in zip(self.solutions.items(), scores, errors, strict=True):
            family = self.family(law)
            used = family.free_mask(law)
            owned = np.array([part is not None for part in family.owner])
            # a law contains itself with further parts at zero, so its cost is at most theirs for any error of its
            # scheme's step
            least = min([self.costs[law], *(row.cost for row in rows if contains(law, row.name))])
            row = Law(
                name=law,
                coefficients=int((used & owned).sum()),
                rms=solution.rms,
                held_out=scored.rms,
                held_out_error=float(error),
                status=solution.status,
                values=dict(compress(solution.by_name.items(), used)),
                free=int(used.sum()),
                cost=least,
                unreached=remaining_decrease(solution) / solution.problem.memory,
                extrapolated=_predicted_rms(solution, ahead),
                other_run=_predicted_rms(solution, elsewhere),
            )
            rows.append(row)
        return with_bic(rows, [solution.evaluation.residual for solution in self.solutions.values()], windows)


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


#: Cosine of two coefficients' derivatives above which they count as one; drag is weighted within a step, joints not.
SAME_COSINE = 1 - 1e-4


def _same_parts(laws: Sequence[str], prepared: Prepared, first: Solution) -> dict[str, str]:
    """Parts of one coefficient that act like another, which replaces them; a part that the fit already has stays."""
    owner = [part_of(name) for name in first.problem.names]
    single = {part for law in laws for part in LAWS[law] if owner.count(part) == 1}
    asked = {part_of(name) for name in prepared.names}
    columns = first.evaluation.jacobian[..., first.problem.freedoms :].reshape(-1, len(owner))
    unit = columns / np.maximum(np.sqrt(np.sum(columns**2, axis=0)), 1e-300)
    same: dict[str, str] = {}
    parts = sorted(single, key=lambda part: (part not in asked, list(LAW_PARTS).index(part)))
    for part, other in combinations(parts, 2):
        cosine = abs(unit[:, owner.index(part)] @ unit[:, owner.index(other)])
        if part not in same and cosine >= SAME_COSINE:
            same[other] = part
    return same


def remaining_decrease(solution: Solution) -> float:
    """Decrease of the cost by a Gauss-Newton step of the movable parameters: g' S^-1 g / 2."""
    g = solution.gradient
    low, high = solution.problem.bounds(solution.values)
    free = ~solution.problem.held_mask
    free &= ~((solution.values <= low) & (g > 0)) & ~((solution.values >= high) & (g < 0))
    if free.any():
        return 0.5 * float(g[free] @ solve_spd(solution.information[np.ix_(free, free)], g[free]))
    return 0.0


#: Maximum correlation of neighbours that is used [-]: above it a trace would count as almost no sample at all.
LARGEST_CORRELATION = 0.999


def with_bic(rows: list[Law], residuals: list[np.ndarray], windows: Windows) -> list[Law]:
    """The laws with their BIC, all by the effective number of samples of the law with the smallest chi-square."""
    chi2 = np.array([np.sum(r**2) for r in residuals])
    samples = windows.samples
    rho = lag_one(residuals[int(np.argmin(chi2))], windows.weight > 0)[0]
    rho = np.clip(rho, 0.0, LARGEST_CORRELATION)
    effective = samples * (1 - rho) / (1 + rho)
    scores = effective * np.log(chi2 / samples) + np.array([row.free for row in rows]) * np.log(effective)
    return [replace(row, bic=float(score)) for row, score in zip(rows, scores, strict=True)]
