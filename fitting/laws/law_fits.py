"""Fits of damping laws to the same windows, each by a simulator that has every coefficient of its family."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.modelling.build import build
from fitting.estimate.factors import eliminate_rows
from fitting.estimate.first_starts import first_starts
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.simulator import Simulator, choose_stepper
from fitting.estimate.solution import Solution
from fitting.laws.law_scenes import paths_of_law, scene_with_law
from fitting.laws.laws import JOINT_PARTS, LAW_PARTS, LAWS, part_of
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.parameter import given_effect, names_in_scene, with_zero_damping
from fitting.parameters.paths import resolve
from fitting.windows.prepared import STEPS_PER_PERIOD, Prepared


@dataclass(frozen=True)
class Family:
    """A simulator with every coefficient of some laws.

    Attributes:
        owner: the law's part that each parameter belongs to, or None.
        substeps: subdivisions of a step: laws with dry friction use a scheme of second order.
        rough: subdivisions of a step in a law's first fit, which decides whether it is worth finer ones.
        enough: cost above which it is not.
    """

    simulator: Simulator
    owner: tuple[str | None, ...]
    substeps: int
    rough: int
    enough: float = np.inf

    def free_mask(self, law: str) -> np.ndarray:
        """Which parameters are free in a law (k,) bool."""
        return np.array([part is None or part in LAWS[law] for part in self.owner])


def family_of(prepared: Prepared, others: list[str], dry: bool) -> Family:
    """A family with every coefficient of the laws with or without dry friction."""
    names = paths_of_law(dry)
    separate = []
    for part in JOINT_PARTS:
        listed = np.ndim(given_effect(prepared.scene, LAW_PARTS[part])) > 0
        if listed or any(name.startswith(LAW_PARTS[part] + ".") for name in prepared.names):
            separate.append(part)
    model, _ = build(scene_with_law(prepared.scene, dry, dict.fromkeys(JOINT_PARTS, 0.0), separate))
    release = prepared.simulator.release
    same = {p.name: p for p in prepared.parameters if p.name in others}
    known = names_in_scene(same.values())
    parameters = [same.get(p.name, p) for p in resolve(model, [*known, *names], release=release)]
    parameters += [p for name, p in same.items() if name not in known]
    owner = tuple(part_of(p.name) for p in parameters)
    # dense works for any model; other solvers may reject the joints of some law
    solver = "dense" if prepared.scene.run.solver == "dense" else "auto"
    simulator = Simulator(model, parameters, choose_stepper(model, solver=solver), release)
    substeps = substeps_of(prepared, simulator)
    return Family(simulator, owner, substeps, substeps)


def substeps_of(prepared: Prepared, simulator: Simulator) -> int:
    """Subdivisions of a step that make another simulator as accurate as the prepared one."""
    finer = STEPS_PER_PERIOD[simulator.stepper.integrator.order] / STEPS_PER_PERIOD[prepared.order]
    return max(1, int(np.ceil(finer * prepared.windows.substeps - 1e-9)))


#: Maximum evaluations of separate windows for a law.
LAW_ITERATIONS = 25


def fit_law(prepared: Prepared, family: Family, law: str, inner: list[Solution]) -> Solution:
    """A law fitted from the best law that it contains, or from typical coefficients; the better of both."""
    used = family.free_mask(law)
    parameters = family.simulator.parameters
    known = {p.name: p.value for p in prepared.parameters}
    initial = []
    for p, part in zip(parameters, family.owner, strict=True):
        size = p.value
        if part is not None:
            size = p.scale
        initial.append(known.get(p.name, size))
    windows = replace(prepared.windows, substeps=family.rough)
    problem = replace(
        prepared.problem(), simulator=family.simulator, windows=windows, parameters=parameters, frozen=~used
    )
    tries = [np.where(used, initial, 0.0)]
    best = min(inner, key=lambda one: one.cost, default=None)
    if best is None:
        starts = first_starts(family.simulator.model_at(tries[0]), prepared.traces, prepared.windows, prepared.sigma)
    else:
        starts = best.starts
        own = best.by_name
        tries.insert(0, np.where(used, [own.get(p.name, 0.0) for p in parameters], 0.0))
    fits: list[Solution] = []
    for values in tries:
        fit = fit_windows(problem, values, starts, iterations=LAW_ITERATIONS)
        if family.rough < family.substeps and fit.cost < family.enough:
            finer = replace(problem, windows=replace(windows, substeps=family.substeps))
            fit = fit_windows(finer, fit.values, fit.starts, iterations=LAW_ITERATIONS)
        fits.append(fit)
        # started from a law that it contains it cannot end worse; if it does, other starts are tried
        if fit.status == "ok" and (best is None or fit.cost <= best.cost * (1 + 1e-6)):
            break
    return better_fit(fits)


def better_fit(fits: Sequence[Solution]) -> Solution:
    """The fit of minimum cost, of those that converged if any did."""
    return min(fits, key=lambda fit: (fit.status != "ok", fit.cost))


def least_loss(full: Solution, family: Family, law: str) -> float:
    """Loss of log likelihood by the coefficients c (covariance C) that a law lacks of a larger one: c' C^-1 c/2."""
    free = ~full.problem.held_mask
    used = family.free_mask(law)
    lacks = np.flatnonzero(free & ~used)
    c = full.values[lacks]
    inverse = eliminate_rows(full.information, np.flatnonzero(free & used), lacks)
    return 0.5 * c @ inverse @ c / full.problem.memory


def with_law(prepared: Prepared, paths: Sequence[str], solution: Solution) -> Prepared:
    """The preparation with further parts of the law free, from the end of a fit without them."""
    scene = with_zero_damping(prepared.scene, paths)
    model, _ = build(scene)
    release = prepared.simulator.release
    resolved = {p.name: p for p in resolve(model, [*names_in_scene(prepared.parameters), *paths], release=release)}
    parameters = [replace(p, where=resolved.pop(p.name, p).where) for p in prepared.parameters]
    more = list(resolved.values())
    parameters += more
    stepper = choose_stepper(model, solver=scene.run.solver)
    simulator = Simulator(model, parameters, stepper, release, more=tested_parameters(model, parameters))
    windows = replace(prepared.windows, substeps=substeps_of(prepared, simulator))
    changed = replace(prepared, scene=scene, windows=windows, starts=solution.starts)
    return changed.with_parameters(parameters, np.append(solution.values, [p.value for p in more]), simulator)
