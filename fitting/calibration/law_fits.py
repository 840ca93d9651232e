"""Damping laws, subsets of one full set of coefficients, and their fits to the same windows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from dropper_jax.base.json_values import Json, jsonable
from dropper_jax.base.read import ScenePath
from dropper_jax.load.scene import Scene
from dropper_jax.run.build import build
from fitting.calibration.prepared import STEPS_PER_PERIOD, Prepared
from fitting.estimate.factors import eliminate_rows
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.residuals import Solution
from fitting.estimate.simulator import Simulator, choose_stepper
from fitting.estimate.windows import first_starts
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.parameter import given_effect, names_in_scene, with_zero_damping
from fitting.parameters.paths import resolve


@dataclass(frozen=True)
class Law:
    """One rung of the ladder: a damping law, its number of coefficients (one per joint or link where separate), scores.

    Attributes:
        held_out: RMS angle error [rad] of windows predicted from others, with the standard error of its difference to
            that of the best law.
        free: fitted parameters, including those outside damping laws.
        bic: lower is better.
        cost: minus the log likelihood of the fitted windows, in units of independent samples.
        unreached: remaining gain in log likelihood predicted by the fit's own model; large if dry joints make the cost
            non-smooth, so that steps do not achieve the predicted decrease.
        joined: the cost with windows joined, of laws that separate windows leave undecided; otherwise NaN.
        score, score_error: log score of windows predicted from others, minus that of the best law, and its standard
            error.
        extrapolated: RMS angle error [rad] of the last third of every run, predicted from the first two.
        other_run: RMS angle error of every run predicted from the others; NaN if there is only one.
        share: weight of the law among all, by its log scores.
        equals: laws that give the same motion, left out.
        unseen: parts that may dissipate 10 % of the energy as far as the traces show, significant or not.
        refuted: the reason why the law was rejected, or "".
        chosen: the simplest law that is not refuted; it is the only one if the traces decide.
    """

    name: str
    coefficients: int
    rms: float
    held_out: float
    held_out_error: float
    status: str
    values: dict[str, float]
    free: int
    bic: float = np.nan
    cost: float = np.nan
    unreached: float = 0.0
    joined: float = np.nan
    score: float = np.nan
    score_error: float = np.nan
    extrapolated: float = np.nan
    other_run: float = np.nan
    share: float = np.nan
    equals: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    refuted: str = ""
    chosen: bool = False

    @property
    def possible(self) -> bool:
        """Whether the law is not refuted."""
        return not self.refuted

    def to_json(self) -> Json:
        """Plain values."""
        found = {**vars(self), "possible": self.possible}
        del found["free"]
        return jsonable(found)


#: The coefficients of linear and of quadratic drag.
DRAG = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
#: Every damping coefficient that a law may use.
PARTS = {
    "linear": DRAG[0],
    "quadratic": DRAG[1],
    "joint viscous": "effects.joint_friction.viscous",
    "dry": "effects.joint_friction.dry",
}
#: Coefficients of friction in the joints, each a list if joints have separate values.
OF_JOINTS = ("joint viscous", "dry")
#: Every law: name and parts, the simplest first, each after all laws that it contains.
LADDER = {" + ".join(parts) or "none": parts for size in range(len(PARTS) + 1) for parts in combinations(PARTS, size)}


def part_of(name: str) -> str | None:
    """The part of a damping law that a parameter of this name belongs to."""
    return next((part for part, path in PARTS.items() if name.startswith(path)), None)


def contains(law: str, other: str) -> bool:
    """Whether `law` has all parts of `other`, and more."""
    return set(LADDER[law]) > set(LADDER[other])


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
        return np.array([part is None or part in LADDER[law] for part in self.owner])


def family_of(prepared: Prepared, others: list[str], dry: bool) -> Family:
    """A family with every coefficient of the laws with or without dry friction."""
    names = _paths_of_law(dry)
    separate = []
    for part in OF_JOINTS:
        listed = np.ndim(given_effect(prepared.scene, PARTS[part])) > 0
        if listed or any(name.startswith(PARTS[part] + ".") for name in prepared.names):
            separate.append(part)
    model, _ = build(scene_with_law(prepared.scene, dry, dict.fromkeys(OF_JOINTS, 0.0), separate))
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


def scene_with_law(scene: Scene, dry: bool, friction: Mapping[str, float], separate: Sequence[str]) -> Scene:
    """The scene with every part of a damping law, with or without dry friction; missing parts are 0.

    Args:
        friction: values of parts of the joints; the others keep those of the scene.
        separate: parts of which every joint has a coefficient of its own.
    """
    table = scene.to_dict()
    fields = table["effects"].setdefault("joint_friction", {})
    joints = len(scene.lines[0].length) + 1
    for part in OF_JOINTS:
        field = ScenePath(PARTS[part]).key
        value = friction.get(part)
        if value is None:
            value = fields.get(field) or 0.0
        if part in separate and not isinstance(value, list):
            value = [value] * joints
        fields[field] = value
    fields.setdefault("axis", [0.0, 1.0, 0.0])
    if not dry:
        fields.pop("dry", None)
    return with_zero_damping(Scene.from_dict(table), _paths_of_law(dry))


def _paths_of_law(dry: bool) -> list[str]:
    """Paths of all parts of a damping law, with or without dry friction."""
    return [path for part, path in PARTS.items() if dry or part != "dry"]


def without_unused_parts(scene: Scene, given: Scene, free: Sequence[str]) -> Scene:
    """The scene without parts of a damping law that are neither `given` nor free: they are 0."""
    coefficients = {ScenePath(path).key for path in PARTS.values()}
    table = scene.to_dict()
    for path in PARTS.values():
        _, effect, field = path.split(".")
        fields = table["effects"].get(effect, {})
        if given_effect(given, path) is None and not any(name.startswith(path) for name in free):
            fields.pop(field, None)
        if effect not in given.effects and not fields.keys() & coefficients:  # an axis alone does not define friction
            table["effects"].pop(effect, None)
    return Scene.from_dict(table)


#: Maximum evaluations of separate windows for a law.
ITERATIONS = 25


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
        fit = fit_windows(problem, values, starts, iterations=ITERATIONS)
        if family.rough < family.substeps and fit.cost < family.enough:
            finer = replace(problem, windows=replace(windows, substeps=family.substeps))
            fit = fit_windows(finer, fit.values, fit.starts, iterations=ITERATIONS)
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
    return 0.5 * float(c @ inverse @ c) / full.problem.memory


def with_law(prepared: Prepared, paths: Sequence[str], solution: Solution) -> Prepared:
    """The preparation with further parts of the law free, from the end of a fit without them."""
    scene = with_zero_damping(prepared.scene, paths)
    model, _ = build(scene)
    old = {p.name: p for p in prepared.parameters}
    release = prepared.simulator.release
    resolved = {p.name: p for p in resolve(model, [*names_in_scene(prepared.parameters), *paths], release=release)}
    parameters = []
    for name, p in old.items():
        if name in resolved:
            p = replace(p, where=resolved[name].where)
        parameters.append(p)
    parameters += [p for name, p in resolved.items() if name not in old]
    stepper = choose_stepper(model, solver=scene.run.solver)
    simulator = Simulator(model, parameters, stepper, release, more=tested_parameters(model, parameters))
    windows = replace(prepared.windows, substeps=substeps_of(prepared, simulator))
    own = [p.value for p in parameters if p.name not in old]
    changed = replace(prepared, scene=scene, windows=windows, starts=solution.starts)
    return changed.with_parameters(parameters, np.append(solution.values, own), simulator)
