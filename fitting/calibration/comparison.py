"""Model selection of damping laws: every subset of a full set of coefficients, compared on the same windows.

Every law is a subset of one full set, with the other coefficients fixed at zero. All laws are therefore fitted by the
same simulator on the same windows, in units of the noise that the fullest law leaves. A law starts from the best of the
laws that it contains, so it never fits worse. Laws that give the same motion are merged (one link: linear drag and a
viscous joint). Laws are compared by cross-validation in blocks (`cross_validation`) and by tests of the coefficients in
which they differ (`decision`). Samples that the caller holds out are used by neither.

BIC = `N_eff log(chi2/N) + k log N_eff` (Schwarz 1978) is reported alongside. N_eff = N (1 - rho)/(1 + rho) accounts for
correlated samples; rho is that of the law that fits best, because its residuals are nearest to the noise.

Comparison with joined windows of laws that separate windows leave undecided.

Separate windows lose the information on how much energy a motion loses from one to the next; joined ones (`shooting`)
keep it. The weight of the gaps and the time step are those of the law with the most parts. At this one weight all
costs, gaps included, are likelihoods of the same model, so laws can be compared by them as with separate windows. A law
starts from the best of those that it contains, so it never costs more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, nearest, silent
from dropper_jax.base.read import ScenePath
from fitting.calibration.cross_validation import Scores, blocks, fair, last_third, other_runs, score
from fitting.calibration.decision import LACKS, chance, decide, decide_joined, deviation, unit_work, unseen
from fitting.calibration.law_fits import (
    LADDER,
    PARTS,
    Family,
    Law,
    contains,
    family_of,
    fit_again,
    fit_inside,
    fit_law,
    least_loss,
)
from fitting.calibration.preparation import Prepared
from fitting.estimate.factors import solve_spd
from fitting.estimate.least_squares import Objective, continue_windows, descend
from fitting.estimate.noise import lag_one
from fitting.estimate.residual_noise import fit_with_noise
from fitting.estimate.residuals import Solution
from fitting.estimate.shooting import SCHEDULE, fit_shooting
from fitting.estimate.step_size import finer_step, refine
from fitting.estimate.windows import Windows
from fitting.parameters.parameter import Parameter

if TYPE_CHECKING:
    from fitting.calibration.result import FitResult

#: Evaluations of separate windows in the widest law's family, and between a law and one that contains it.
ITERATIONS = 25
ONWARD = 15


def join_laws(
    prepared: Prepared, family: Family, laws: Mapping[str, Solution], progress: Progress = silent
) -> dict[str, Solution]:
    """Joined solutions of laws by name; empty if windows do not follow each other or a law does not converge.

    Args:
        family: contains the parts of all these laws.
        laws: solutions of separate windows.
    """
    if not prepared.windows.follows.any():
        return {}
    order = sorted(laws, key=lambda law: len(LADDER[law]))
    most = order[-1]
    progress(0.95, f"law {most}, joined")
    widest = fit_shooting(fit_law(prepared, family, most, [laws[most]], ITERATIONS), finer=finer_step)
    if widest.status != "ok" or not widest.gap_weight:
        return {}
    family = replace(family, substeps=widest.windows.substeps)
    schedule = [weight for weight in SCHEDULE if weight >= widest.gap_weight]
    found: dict[str, Solution] = {}
    for law in order:
        progress(0.95, f"law {law}, joined")
        inner = sorted((one for name, one in found.items() if contains(law, name)), key=lambda one: one.cost)
        tries = [widest] if law == most else []
        tries += [_onward(best, ~family.free_mask(law), widest.gap_weight) for best in inner[:1]]
        if not any(one.status == "ok" for one in tries):
            begin = fit_law(prepared, family, law, [laws[law]], ITERATIONS)
            tries.append(fit_shooting(begin, choose=False, schedule=schedule))
        found[law] = min(tries, key=lambda one: (one.status != "ok", one.cost))
    if all(one.status == "ok" for one in found.values()):
        return found
    return {}


def _onward(inner: Solution, frozen: np.ndarray, weight: float) -> Solution:
    """From a law's joined solution to a law that contains it, whose additional parts start at zero."""
    problem = replace(inner.problem, frozen=frozen)
    return descend(Objective(problem, weight, intermediate=True), replace(inner, problem=problem), ONWARD)


#: Maximum evaluations of a law started from the end of a larger one, which suffices in the same local minimum.
#: Maximum number of larger laws to start from, as each may have found a better local minimum.
NEAR = 8
TRIES = 3
#: Cost, in multiples of the fullest law's, above which a law does not justify finer steps; loss of log likelihood, by
#: the fullest law's covariance, above which no other local minimum can rescue a law.
FAR = 10.0
HOPELESS = 1000.0


def compare(
    result: FitResult, laws: Sequence[str] = tuple(LADDER), iterations: int = 25, progress: Progress | None = None
) -> list[Law]:
    """Which damping laws the traces of a fit leave possible; see `compare_laws`.

    Raises:
        SceneError: a law of unknown name, or a fit of a number that ties several values of the scene.
    """
    refuse_tied("compare_models", result.parameters)
    return compare_laws(result.prepared.noisy(result.solution.problem.noise), laws, iterations, progress)


def refuse_tied(option: str, parameters: Sequence[Parameter]) -> None:
    """Reject numbers of `[parameters]`, which move the model along a line, for what changes the model's effects."""
    tied = next((p.name for p in parameters if ScenePath(p.name).section == "parameters"), None)
    if tied is not None:
        raise SceneError(f"{option}: not with {tied!r} free. Omit it, or free paths of the scene such as b_l")


def compare_laws(
    prepared: Prepared, laws: Sequence[str] = tuple(LADDER), iterations: int = 25, progress: Progress | None = None
) -> list[Law]:
    """Fit laws to the same windows by `windows`, and report which of them the traces leave possible.

    Other free parameters of the fit (inertias, camera) are free in every law. Friction in joints is one number for all,
    or one for each if the scene or the fit specifies it so.

    Raises:
        SceneError: a law of unknown name.
    """
    for law in laws:
        if law not in LADDER:
            raise SceneError(f"laws: {law!r} is unknown; {nearest(law, LADDER)}")
    say = progress or silent
    laws = sorted(laws, key=lambda law: (len(LADDER[law]), list(LADDER).index(law)))
    others = [p.name for p in prepared.parameters if not p.name.startswith(tuple(PARTS.values()))]
    families = {dry: family_of(prepared, others, dry) for dry in {("dry" in LADDER[law]) for law in laws}}
    prepared, families, firsts = _first_fits(prepared, families, laws, iterations, say)
    first = firsts[laws[-1]]
    memory = first.problem.memory
    same = _same_parts(laws, prepared, first)
    found: dict[str, Solution] = {}
    for i, law in enumerate(laws):
        if set(same) & set(LADDER[law]):
            continue
        say(0.95, f"law {i + 1} of {len(laws)}: {law}")
        inner = [one for name, one in found.items() if contains(law, name)]
        inner += [firsts[law]] if law in firsts else []
        found[law] = fit_law(prepared, families["dry" in LADDER[law]], law, inner, iterations)
    near = [law for law in found if least_loss(first, families["dry" in LADDER[laws[-1]]], law) < HOPELESS]
    found, costs = _from_larger(found, near, families, iterations)
    folds = fair(blocks(prepared.windows.run), prepared.windows.released)
    scores = [score(one, folds) for one in found.values()]
    per_unit = {dry: unit_work(prepared, one.simulator, one.owner) for dry, one in families.items()}
    open_parts = lambda law, one, dry: unseen(one, families[dry].owner, per_unit[dry])  # noqa: E731
    rows = []
    for row, one in zip(_rows(prepared, families, found, costs, scores), found.values(), strict=True):
        rows.append(
            replace(
                row, equals=_equals(row.name, same, laws), unseen=open_parts(row.name, one, "dry" in LADDER[row.name])
            )
        )
    scores = [replace(one, log_score=one.log_score / memory) for one in scores]
    rows = _with_errors(decide(rows, scores), scores)
    left = {row.name: found[row.name] for row in rows if row.possible}
    if len(left) == 1:
        return rows
    dry = any("dry" in LADDER[law] for law in left)
    joined = join_laws(prepared, families[dry], left, say)
    costs = {law: one.cost / memory for law, one in joined.items()}
    return decide_joined(rows, costs, {law: open_parts(law, one, dry) for law, one in joined.items()})


def _first_fits(
    prepared: Prepared, families: dict[bool, Family], laws: Sequence[str], iterations: int, say: Progress
) -> tuple[Prepared, dict[bool, Family], dict[str, Solution]]:
    """The noise that the fullest law leaves, families with the step size that it requires, and their fullest laws."""
    families = dict(families)
    fullest = laws[-1]
    say(0.95, f"law {fullest}: noise")
    widest = "dry" in LADDER[fullest]
    first = fit_law(prepared, families[widest], fullest, [], iterations)
    noisy = partial(fit_with_noise, claimed=prepared.claimed_windows, floor=prepared.floor, traces=prepared.traces)
    first = refine(noisy(first, again=continue_windows))
    prepared = prepared.noisy(first.problem.noise)
    enough = FAR * first.cost
    families = {dry: replace(family, enough=enough) for dry, family in families.items()}
    families[widest] = replace(families[widest], substeps=first.windows.substeps)
    found = {fullest: first}
    for dry, family in families.items():
        # otherwise the step error would distinguish the schemes, and so the laws
        law = next(law for law in reversed(laws) if ("dry" in LADDER[law]) == dry)
        if law != fullest:
            found[law] = refine(fit_law(prepared, family, law, [first], iterations))
            families[dry] = replace(families[dry], substeps=found[law].windows.substeps)
    return prepared, families, found


def _from_larger(
    found: dict[str, Solution], near: Sequence[str], families: dict[bool, Family], iterations: int
) -> tuple[dict[str, Solution], dict[str, float]]:
    """The laws and their costs; those `near` that a larger one would refute are refitted from the end of that one.

    The cost of windows is non-smooth, most of all for joints that stick and for chaotic chains: the larger law may have
    found the better local minimum. Its scheme may also have a different step error, which may fit the noise better by
    chance. The cost of a law is therefore the minimum of those by its own scheme and by that of the larger law.
    """
    found, costs = dict(found), {law: one.cost / one.problem.memory for law, one in found.items()}
    for law in reversed(near):
        more = [name for name in found if contains(name, law)]
        for _ in range(TRIES):
            against = [(chance(costs[law] - costs[name], len(LADDER[name]) - len(LADDER[law])), name) for name in more]
            p, larger = min(against, key=lambda pair: pair[0], default=(1.0, ""))
            if p >= LACKS:
                break
            more.remove(larger)
            one = found[law]
            inside = fit_inside(found[larger], families["dry" in LADDER[larger]], law, NEAR)
            if inside.cost < one.cost:
                again = fit_again(one, inside, iterations)
                found[law] = min(one, again, key=lambda fit: (fit.status != "ok", fit.cost))
                costs[law] = min(costs[law], *(fit.cost / fit.problem.memory for fit in (inside, found[law])))
    return found, costs


def _rows(
    prepared: Prepared,
    families: dict[bool, Family],
    found: dict[str, Solution],
    costs: dict[str, float],
    scores: Sequence[Scores],
) -> list[Law]:
    """The laws' rows before any decision; costs are in units of independent samples."""
    rows: list[Law] = []
    windows = prepared.windows
    kinds = (last_third(windows.begin, windows.run), other_runs(windows.run))
    folds = [fair(each, windows.released) for each in kinds]
    for (law, one), scored in zip(found.items(), scores, strict=True):
        family = families["dry" in LADDER[law]]
        used = family.free_mask(law)
        ahead, beside = (score(one, each).rms if each else np.nan for each in folds)
        row = Law(
            name=law,
            coefficients=sum(on and part is not None for on, part in zip(used.tolist(), family.owner, strict=True)),
            rms=one.rms,
            held_out=scored.rms,
            held_out_error=0.0,
            status=one.status,
            values={name: value for (name, value), on in zip(one.by_name.items(), used, strict=True) if on},
            free=int(used.sum()),
            cost=costs[law],
            unreached=remaining_decrease(one) / one.problem.memory,
            extrapolated=ahead,
            other_run=beside,
        )
        rows.append(row)
    # a law contains itself with further parts at zero, so its cost is at most theirs for any error of its scheme's step
    inner = [[one.cost for one in rows if contains(row.name, one.name)] for row in rows]
    rows = [replace(row, cost=min([row.cost, *less])) for row, less in zip(rows, inner, strict=True)]
    return with_bic(rows, [one.evaluation.residual for one in found.values()], windows)


def _with_errors(rows: list[Law], scores: list[Scores]) -> list[Law]:
    """The laws with standard errors of the differences between their RMS errors and the minimum, window by window."""
    mean = np.array([s.square / np.maximum(s.count, 1) for s in scores])
    best = int(np.argmin([row.held_out for row in rows]))
    known = scores[best].count > 0
    apart = (mean - mean[best])[:, known]
    error = deviation(apart) / np.sqrt(max(known.sum(), 1))
    scale = max(2 * rows[best].held_out, 1e-300)
    return [replace(row, held_out_error=float(e) / scale) for row, e in zip(rows, error, strict=True)]


def _same_parts(laws: Sequence[str], prepared: Prepared, first: Solution) -> dict[str, str]:
    """Parts of one coefficient that act like another, which replaces them; a part that the fit already has stays."""
    names = [p.name for p in first.problem.parameters]
    owner = []
    for name in names:
        owner.append(next((part for part, path in PARTS.items() if name.startswith(path)), None))
    wanted = {part for law in laws for part in LADDER[law] if owner.count(part) == 1}
    asked = {part for part in wanted if any(p.name.startswith(PARTS[part]) for p in prepared.parameters)}
    columns = first.evaluation.jacobian[..., first.problem.freedoms :].reshape(-1, len(owner))
    unit = columns / np.maximum(np.sqrt(np.sum(columns**2, axis=0)), 1e-300)
    found: dict[str, str] = {}
    parts = sorted(wanted, key=lambda part: (part not in asked, list(PARTS).index(part)))
    for kept, other in combinations(parts, 2):
        # cosine of two coefficients' derivatives above which they count as one; drag is weighted within a step, joints
        # not
        if kept not in found and abs(unit[:, owner.index(kept)] @ unit[:, owner.index(other)]) >= (1 - 1e-4):
            found[other] = kept
    return found


def _equals(law: str, same: dict[str, str], laws: Sequence[str]) -> tuple[str, ...]:
    """Laws that are the same as this one under other names."""
    means = lambda name: {same.get(part, part) for part in LADDER[name]}  # noqa: E731
    return tuple(other for other in laws if other != law and means(other) == set(LADDER[law]))


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
