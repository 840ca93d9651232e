"""Fits of damping laws to the same separate windows, in stages: each one returns what the next one needs.

1. `fit_fullest` fits the law with the most parts. Its noise and steps are then those of all laws.
2. `fit_laws` fits every law, started from the best of those that it contains.
3. `restart_from_larger` fits laws that a larger one would refute again, from the end of that one.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.progress import Progress
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.solution import Solution
from fitting.estimate.step_size import refine
from fitting.laws.decision import REFUTED_PROBABILITY, chance
from fitting.laws.law_fits import LAW_ITERATIONS, Family, better_fit, family_of, fit_law, least_loss
from fitting.laws.laws import LAWS, contains, has_dry_friction, part_of
from fitting.laws.undetected_parts import dissipated_per_unit, undetected_parts
from fitting.windows.method import with_residual_noise
from fitting.windows.prepared import Prepared

#: Maximum evaluations of a law started from the end of a larger one, which suffices in the same local minimum.
RESTART_ITERATIONS = 8
#: Maximum number of larger laws to start from, as each may have found a better local minimum.
MAX_RESTARTS = 3
#: Cost, in multiples of the fullest law's, above which a law does not justify finer steps.
FINE_STEP_COST_RATIO = 10.0
#: Loss of log likelihood, by the fullest law's covariance, above which no other local minimum can rescue a law.
HOPELESS_LOSS = 1000.0


@dataclass(frozen=True)
class ComparedLaws:
    """Laws that are compared on the same windows, and the simulators that fit them.

    Attributes:
        names: from the simplest one on.
        families: with (True) and without dry friction.
        per_unit: energy that a unit of each coefficient of a family dissipates in the measured motion [J per unit].
    """

    prepared: Prepared
    names: Sequence[str]
    families: Mapping[bool, Family]
    per_unit: Mapping[bool, np.ndarray]
    progress: Progress

    def family(self, law: str) -> Family:
        """The family of a law."""
        return self.families[has_dry_friction(law)]

    def fit(self, law: str, inner: list[Solution]) -> Solution:
        """A law fitted from the best of those that it contains."""
        return fit_law(self.prepared, self.family(law), law, inner)

    def undetected(self, solution: Solution, dry_friction: bool) -> tuple[str, ...]:
        """Parts of a law, fitted by a family, that the traces could not have shown."""
        return undetected_parts(solution, self.families[dry_friction].owner, self.per_unit[dry_friction])


def prepare_laws(prepared: Prepared, names: Sequence[str], progress: Progress) -> ComparedLaws:
    """Laws, from the simplest one on, with the simulators of their families."""
    others = [name for name in prepared.names if part_of(name) is None]
    families = {}
    per_unit = {}
    for dry_friction in sorted(set(map(has_dry_friction, names))):
        family = family_of(prepared, others, dry_friction)
        families[dry_friction] = family
        per_unit[dry_friction] = dissipated_per_unit(prepared, family.simulator, family.owner)
    return ComparedLaws(prepared, names, families, per_unit, progress)


def fit_fullest(laws: ComparedLaws) -> tuple[ComparedLaws, dict[str, Solution]]:
    """The laws with the fullest one's noise and with the step sizes that each family requires; fits of the fullest law
    of each family, by name."""
    name = laws.names[-1]
    laws.progress(0.95, f"law {name}: noise")
    fullest = refine(with_residual_noise(laws.prepared, laws.fit(name, [])))
    enough = FINE_STEP_COST_RATIO * fullest.cost
    families = {key: replace(family, enough=enough) for key, family in laws.families.items()}
    laws = replace(laws, prepared=laws.prepared.with_noise_of(fullest.problem), families=families)
    fits = {name: fullest}
    finer = {}
    for dry_friction, family in families.items():
        law = next(law for law in reversed(laws.names) if has_dry_friction(law) == dry_friction)
        if law != name:  # otherwise the step error would distinguish the schemes, and so the laws
            fits[law] = refine(laws.fit(law, [fullest]))
        finer[dry_friction] = replace(family, substeps=fits[law].windows.substeps)
    return replace(laws, families=finer), fits


def fit_laws(
    laws: ComparedLaws, fullest_fits: Mapping[str, Solution], left_out: Collection[str]
) -> dict[str, Solution]:
    """Solutions of all laws by name, each started from those that it contains.

    Args:
        fullest_fits: fits of the fullest law of each family.
        left_out: laws that are not fitted.
    """
    solutions: dict[str, Solution] = {}
    for i, law in enumerate(laws.names):
        if law in left_out:
            continue
        laws.progress(0.95, f"law {i + 1} of {len(laws.names)}: {law}")
        inner = [solution for name, solution in solutions.items() if contains(law, name)]
        if law in fullest_fits:
            inner.append(fullest_fits[law])
        solutions[law] = laws.fit(law, inner)
    return solutions


def restart_from_larger(
    laws: ComparedLaws, solutions: Mapping[str, Solution], fullest: Solution
) -> tuple[dict[str, Solution], dict[str, float]]:
    """Solutions and costs of laws by name, those that a larger one would refute also fitted from that one.

    The cost of windows is non-smooth, most of all for joints that stick and for chaotic chains: the larger law may
    have found the better local minimum. Its scheme may also have a different step error, which may fit the noise
    better by chance. The cost of a law is therefore the minimum of those by its own scheme and by that of the larger
    law.

    Args:
        solutions: of `fit_laws`.
        fullest: the fullest law.
    """
    solutions = dict(solutions)
    costs = {law: cost_of(solution) for law, solution in solutions.items()}
    widest = laws.family(laws.names[-1])
    near = [law for law in solutions if least_loss(fullest, widest, law) < HOPELESS_LOSS]
    for law in reversed(near):
        larger_laws = [name for name in solutions if contains(name, law)]
        for _ in range(MAX_RESTARTS):
            probability = {}
            for name in larger_laws:
                probability[name] = chance(costs[law] - costs[name], len(LAWS[name]) - len(LAWS[law]))
            if min(probability.values(), default=1.0) >= REFUTED_PROBABILITY:
                break
            larger = min(probability, key=probability.__getitem__)
            larger_laws.remove(larger)
            used = laws.family(larger).free_mask(law)
            solutions[law], cost = _fit_from_larger(solutions[law], solutions[larger], used)
            costs[law] = min(costs[law], cost)
    return solutions, costs


def cost_of(solution: Solution) -> float:
    """Minus the log likelihood of a solution, in units of independent samples."""
    return solution.cost / solution.problem.memory


def _fit_from_larger(own: Solution, larger: Solution, used: np.ndarray) -> tuple[Solution, float]:
    """A law fitted again from the end of a larger one, if that is better, and its minimum cost by either scheme.

    Args:
        own: the law's own fit.
        used: which parameters of the larger law the law has (k,) bool.
    """
    problem = replace(larger.problem, frozen=~used)
    inside = fit_windows(problem, np.where(used, larger.values, 0.0), larger.starts, iterations=RESTART_ITERATIONS)
    if not inside.cost < own.cost:
        return own, cost_of(own)
    values = np.array([inside.by_name[p.name] for p in own.problem.parameters])  # the larger one may have more
    again = fit_windows(own.problem, values, inside.starts, iterations=LAW_ITERATIONS)
    best = better_fit([own, again])
    return best, min(cost_of(inside), cost_of(best))
