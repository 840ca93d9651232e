"""Is the damping law right? Score tests of the forces that a fit leaves out, on the joined windows of its end.

A wrong law leaves residuals that look like noise: the starts of the windows absorb it, and the gaps between windows
take what is left. Let g_b be the gradient of the cost on block b of windows and S_b its information, by the free
parameters f and one candidate c at zero, with the starts of the windows eliminated and the gaps included. With
S = sum S_b, the candidate and the free parameters would move, to first order, by

    d = -S^-1 g,    cov = (B - 1)/B sum_b (e_b - mean e)(e_b - mean e)',    e_b = (S - S_b)^-1 (g_b + S_b d)

(Rao 1948; jackknife over B blocks as in `uncertainty`). The covariance is at least that of the noise. The ratio
`t = d_c/sqrt(cov_cc)` has Student's law with B minus the number of parameters degrees of freedom. A coefficient that
the scene lacks can only grow: its test is one-sided. Holm's correction (1979) accounts for the number of candidates.

For laws outside the list, the coefficients of drag must not change with time or amplitude: a candidate whose derivative
in each window is that of the coefficient, multiplied by the window's mean time or RMS rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import compress
from typing import Any

import numpy as np
from scipy.special import stdtr

from dropper_jax.run.build import build
from fitting.calibration.candidate import holm
from fitting.calibration.law_fits import substeps_of
from fitting.calibration.preparation import Prepared
from fitting.estimate.blocks import Pieces, block_of, jackknife, pieces, raised_to
from fitting.estimate.factors import eliminate_rows, solve_spd
from fitting.estimate.normal_equations import Evaluation, Prior
from fitting.estimate.residuals import Residuals, Solution
from fitting.estimate.shooting import level_of
from fitting.estimate.simulator import Simulator, choose_stepper
from fitting.estimate.uncertainty import Uncertainty
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.names import free_option
from fitting.parameters.parameter import Parameter, given_effect, names_in_scene, resolve, with_effects
from fitting.parameters.targets import CAMERA, RECORDING

#: Probability of a candidate's t, over the whole family, below which the law counts as wrong.
LEVEL = 0.01
#: Change of a reported value by the candidate that matters: in its standard errors, and as a fraction of the value.
ERRORS = 2.0
SHARE = 0.05
#: Correlation of two candidates above which they are one.
ALIKE = 0.98
#: Fraction of a candidate's information, in separate windows, that must remain once the free parameters are accounted
#: for. Any force moves tightly joined windows of a chaotic motion along one direction: 1e-5 remains there, and decides.
REMAINS = 1e-4
#: Degrees of freedom below which nothing is tested.
FEWEST = 3
#: Coefficients that a law keeps constant, and what they are tested to change with.
DRAG = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
ALONG = ("time", "amplitude")


@dataclass(frozen=True)
class Suspect:
    """A force or a change that a scene may lack.

    Attributes:
        name: in words.
        free: paths that free it; empty if no number of a scene does.
        parameter: its size.
        grows: whether it can only grow from zero.
        of: for a change of a coefficient, the number of the coefficient among the free parameters.
        along: what it changes with, one of `ALONG`.
    """

    name: str
    free: tuple[str, ...]
    parameter: Parameter
    grows: bool = False
    of: int | None = None
    along: str = ""


QUADRATIC = "quadratic drag"
#: Names of the forces and the paths that free them.
FORCES = {
    "linear": ("linear drag", "effects.linear_damping.b_l"),
    "quadratic": (QUADRATIC, "effects.quadratic_damping.b_q"),
    "viscous": ("viscous friction in the joints", "effects.joint_friction.viscous"),
    "dry": ("dry friction in the joints", "effects.joint_friction.dry"),
    "springs": ("springs in the joints", "effects.bending.EI"),
    "added_mass": ("added mass, or another gravity or clock", "clock.rate"),
}


@dataclass(frozen=True)
class LawTest:
    """A candidate's test.

    Attributes:
        name: in words.
        free: paths that free it.
        change: its size to first order.
        error: standard error of that.
        t: their ratio.
        p: probability of such a t if the law is right, over all candidates.
        moves: by free parameter, its change to first order if the candidate is freed.
        gain: in log likelihood, in units of the noise.
        matters: whether a reported value changes by more than its errors and 5 %.
        alike: names of other significant forces that the traces cannot distinguish from it.
    """

    name: str
    free: tuple[str, ...]
    change: float
    error: float
    t: float
    p: float
    moves: dict[str, float]
    gain: float
    matters: bool
    alike: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


@dataclass(frozen=True)
class LawTests:
    """All tests of a fit, by decreasing gain; changes of a coefficient come after all forces.

    Attributes:
        tests: of candidates that the traces distinguish from the free parameters.
        included: by free parameter, candidates that have the same effect on the motion.
        blocks: number of blocks of windows.
    """

    tests: tuple[LawTest, ...] = ()
    included: dict[str, tuple[str, ...]] = field(default_factory=dict)
    blocks: int = 0

    @property
    def significant(self) -> list[LawTest]:
        """Candidates that the traces show, whether they matter or not."""
        return [test for test in self.tests if test.p < LEVEL]

    @property
    def wrong(self) -> LawTest | None:
        """The candidate that explains most, if the law is wrong."""
        return next((test for test in self.significant if test.matters), None)


def test_laws(prepared: Prepared, solution: Solution, u: Uncertainty) -> LawTests:
    """Test every candidate at the end of a fit with these errors."""
    problem = solution.problem
    free = solution.problem.parameters
    suspects = _suspects(prepared, problem)
    simulated = [s.parameter for s in suspects if s.of is None]
    if not problem.simulator.knows(simulated):
        return LawTests()
    view = problem.simulator.view_of([*free, *simulated])
    wide = replace(problem, simulator=view, parameters=(*free, *simulated), frozen=None)
    values = np.concatenate([solution.values, np.zeros(len(simulated))])
    evaluation = wide.evaluate(values, solution.starts)
    if not np.isfinite(evaluation.jacobian).all():
        return LawTests()
    evaluation = _with_changes(solution, evaluation, [s for s in suspects if s.of is not None])
    return _judge(solution, u, suspects, *_scores(solution, evaluation))


def _suspects(prepared: Prepared, problem: Residuals) -> list[Suspect]:
    """Candidates that are not free, and changes of the free coefficients of drag, in the order of the derivatives."""
    names = [p.name for p in compress(problem.parameters, ~problem.held_mask)]
    found = []
    for p in tested_parameters(prepared.simulator.model, problem.parameters):
        name, path = FORCES.get(p.where.field, ("a roll of the camera", CAMERA))
        if any(one.startswith(path) for one in names):
            continue
        lacks = path.startswith("effects.") and not np.any(given_effect(prepared.scene, path))
        found.append(Suspect(name, (path,), p, grows=lacks))
    for i, p in enumerate(problem.parameters):
        if p.name in DRAG and p.name in names:
            short = p.name.rsplit(".", 1)[1]
            found += [Suspect(f"a {short} that changes with {along}", (), p, of=i, along=along) for along in ALONG]
    return found


def _with_changes(solution: Solution, evaluation: Evaluation, changes: Sequence[Suspect]) -> Evaluation:
    """The evaluation with derivatives by changes of coefficients, in units of their spread over the windows."""
    windows = solution.windows
    m2 = solution.problem.freedoms
    series = dict(zip(ALONG, (0.5 * (windows.begin + windows.ends), _rates(solution)), strict=True))
    for suspect in changes:
        along = series[suspect.along]
        factor = (along - along.mean()) / max(float(np.std(along)), 1e-300)
        for name in ("jacobian", "start_jacobian", "end_jacobian"):
            old = getattr(evaluation, name)
            column = old[..., m2 + suspect.of] * factor.reshape(-1, *[1] * (old.ndim - 2))
            evaluation = evaluation._replace(**{name: np.concatenate([old, column[..., None]], axis=-1)})
    return evaluation


def _rates(solution: Solution) -> np.ndarray:
    """RMS rate of the links (K,) over every window [rad/s], from both its ends."""
    n = solution.evaluation.start.shape[1] // 2
    square = [np.mean(end[:, n:] ** 2, axis=1) for end in (solution.evaluation.start, solution.evaluation.end)]
    return np.sqrt(0.5 * (square[0] + square[1]))


def _scores(solution: Solution, evaluation: Evaluation) -> tuple[Pieces, np.ndarray, np.ndarray]:
    """Gradients and information of pieces of time by all parameters and candidates; the total information of the joined
    windows, and that of separate ones."""
    problem = solution.problem
    count = evaluation.jacobian.shape[-1] - problem.freedoms
    more = count - len(solution.values)
    own = problem.prior(solution.values)
    prior = Prior(own.cost, np.pad(own.gradient, (0, more)), np.pad(own.curvature, (0, more)))
    still = np.zeros(count)
    step, alone = (
        level.eliminate(level.system(evaluation, solution.values), 0.0, prior, still, still)
        for level in (level_of(problem, solution.gap_weight), level_of(problem, None))
    )
    at = replace(solution, evaluation=evaluation, eliminated=step.eliminated)
    return pieces(at, np.arange(count)), step.information, alone.information


def _judge(
    solution: Solution,
    u: Uncertainty,
    suspects: Sequence[Suspect],
    parts: Pieces,
    information: np.ndarray,
    separate: np.ndarray,
) -> LawTests:
    """The tests of all candidates, from the pieces' gradients and information (`_scores`)."""
    free = np.flatnonzero(~solution.problem.held_mask & ~u.at_bound)
    candidates = len(solution.values) + np.arange(len(suspects))
    alone = np.diag(eliminate_rows(separate, free, candidates)) / np.maximum(np.diag(separate)[candidates], 1e-300)
    rest = eliminate_rows(information, free, candidates)
    size = np.sqrt(np.maximum(np.diag(rest), 1e-300))
    like = np.abs(rest) / np.outer(size, size) > ALIKE
    names = [p.name for p in solution.problem.parameters]
    scale = u.noise**2 * solution.problem.memory
    tests: list[tuple[LawTest, int]] = []
    included: dict[str, tuple[str, ...]] = {}
    blocks = 0
    for i, suspect in enumerate(suspects):
        mine = candidates[i]
        if not alone[i] > REMAINS:
            twin = _nearest(separate, free, mine)
            if suspect.grows and twin is not None:
                included[names[twin]] = (*included.get(names[twin], ()), suspect.name)
            continue
        chosen = np.append(free, mine)
        moved, covariance, blocks = _one_step(parts, information[np.ix_(chosen, chosen)], chosen, scale)
        degrees = blocks - len(chosen)
        if degrees < FEWEST:
            continue
        error = float(np.sqrt(covariance[-1, -1]))
        t = float(moved[-1]) / error
        if suspect.grows:
            p = float(stdtr(degrees, -t))
        else:
            p = 2 * float(stdtr(degrees, -abs(t)))
        moves = dict(zip([names[j] for j in free], map(float, moved[:-1]), strict=True))
        matters = _matters(solution, u, suspect, free, moved)
        gain = 0.5 * float(moved[-1]) ** 2 * float(rest[i, i]) / scale
        row = LawTest(suspect.name, suspect.free, float(moved[-1]), error, t, p, moves, gain, matters)
        tests.append((row, i))
    tests.sort(key=lambda row: row[0].p)
    over_family = holm([test.p for test, _ in tests])
    tests = [(replace(test, p=p), i) for (test, i), p in zip(tests, over_family, strict=True)]
    shown = [(test, k) for test, k in tests if test.p < LEVEL and test.free]
    found = []
    for test, i in tests:
        alike = tuple(other.name for other, k in shown if k != i and like[i, k])
        found.append(replace(test, alike=alike))
    found.sort(key=lambda test: (not test.free, -test.gain))
    return LawTests(tuple(found), included, blocks)


def _one_step(
    parts: Pieces, information: np.ndarray, chosen: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Change of the chosen parameters by one step from the fit, its covariance, and the number of blocks."""
    mine = Pieces(parts.gradient[:, chosen], parts.information[:, chosen][:, :, chosen], parts.run)
    moved = -solve_spd(information, mine.gradient.sum(axis=0))
    # scores at the end of the step: its own effect is not scatter
    after = mine._replace(gradient=mine.gradient + mine.information @ moved)
    length = block_of(after, information)
    count = len(after.run)
    blocks = [np.arange(i, min(i + length, count)) for i in range(0, count, length)]
    least = scale * np.diag(solve_spd(information, np.eye(len(chosen))))
    return moved, raised_to(jackknife(after, blocks, information), least), len(blocks)


def _matters(solution: Solution, u: Uncertainty, suspect: Suspect, free: np.ndarray, moved: np.ndarray) -> bool:
    """Whether a reported value changes by more than its errors and a fraction of it; a changing coefficient is off by
    its own spread."""
    change = np.abs(moved[:-1])
    if suspect.of is not None:
        change = np.where(free == suspect.of, np.maximum(change, abs(moved[-1])), change)
    return bool(np.any(change > np.maximum(ERRORS * u.std_error[free], SHARE * np.abs(solution.values[free]))))


def _nearest(information: np.ndarray, free: np.ndarray, mine: int) -> int | None:
    """The free parameter whose effect is most like a candidate's; None without any effect."""
    if not information[mine, mine] > 0 or not len(free):
        return None
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return int(free[np.argmax(np.abs(information[free, mine]) / size[free])])


def freeing_option(test: LawTest, names: Sequence[str]) -> str:
    """A significant candidate in words, and what to do: free it beside the free parameters of these names."""
    words = f"{' or '.join([test.name, *test.alike])}, which the scene lacks (t = {test.t:.1f}, p = {test.p:.1g})"
    if not test.free:
        return f"{words}; no force of the list explains it. Fit parts of the trace (--until) to see the change"
    use = f"{words}. Use {free_option(names, test.free)}"
    if any(name.startswith(f"{RECORDING}.") for name in names):  # --auto-free needs separate runs
        return use
    return f"{use}, or --auto-free"


def law_warnings(laws: LawTests) -> list[str]:
    """One line on a significant candidate that changes no value by much, and on candidates in a coefficient."""
    found = [
        f"{name} includes {' and '.join(others)}: this motion does not distinguish them"
        for name, others in laws.included.items()
    ]
    if laws.significant and laws.wrong is None:
        small = laws.significant[0]
        found.append(
            f"the trace shows {small.name} (t = {small.t:.1f}, p = {small.p:.1g}), which changes no value by more than "
            f"its errors and {SHARE:.0%}"
        )
    return found


def with_law(prepared: Prepared, paths: Sequence[str], solution: Solution) -> Prepared:
    """The preparation with further parts of the law free, from the end of a fit without them."""
    scene = with_effects(prepared.scene, paths)
    model, _ = build(scene)
    old = {p.name: p for p in prepared.parameters}
    release = prepared.simulator.release
    resolved = {p.name: p for p in resolve(model, [*names_in_scene(prepared.parameters), *paths], release=release)}
    parameters = []
    for name, p in old.items():
        parameters.append(replace(p, where=resolved[name].where) if name in resolved else p)
    parameters += [p for name, p in resolved.items() if name not in old]
    stepper = choose_stepper(model, solver=scene.run.solver)
    simulator = Simulator(model, parameters, stepper, release, more=tested_parameters(model, parameters))
    windows = replace(prepared.windows, substeps=substeps_of(prepared, simulator))
    own = [p.value for p in parameters if p.name not in old]
    changed = replace(prepared, scene=scene, windows=windows, starts=solution.starts)
    return changed.with_parameters(parameters, np.append(solution.values, own), simulator)
